"""Settings of the whole test run, made before numpy is imported."""

import os

# the matrices are tiny: more threads only get in each other's way, badly so on a busy machine
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")
