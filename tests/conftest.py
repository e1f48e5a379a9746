"""Settings of the whole test run, made before numpy and jax are imported."""

import os
from pathlib import Path

from hypothesis import HealthCheck, settings

# the matrices are tiny: more threads only get in each other's way, badly so on a busy machine
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

# compiling takes most of the time of jax's tests: what one process compiled, the others read (the
# key has versions, flags and the kind of processor, and XLA checks the processor again)
compiled = Path(__file__).parents[1] / "build" / "compiled"
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(compiled))
os.environ.setdefault("JAX_COMPILATION_CACHE_MAX_SIZE", str(200 << 20))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.3")

# a slow machine is no failure
settings.register_profile("patient", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("patient")
