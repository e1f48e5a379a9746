"""Settings that must be in the environment before jax starts; importing this module sets them.

jax 0.10 on few cores can hang for ever in compiled programs with many small parallel operations,
which its concurrency-optimised scheduler hands to a pool of few threads. Our programs are of that
kind (a hundred tiny networks), so that scheduler is switched off. It has no say on a GPU.
Networks of this size are computed faster by one thread than by several that wait for each other
(`NPROC` is where jax's CPU client reads the number); more cores are used by more processes.
Another hang, that of batched QR factorisations, is avoided in `networks.init_weights`.
"""

from __future__ import annotations

import os
from collections.abc import MutableMapping
from importlib.util import find_spec

from mbtl.errors import missing_extra

SAFE_FLAGS = {"--xla_cpu_enable_concurrency_optimized_scheduler": "false"}


def set_flags(environ: MutableMapping[str, str]) -> None:
    """Add our flags to `XLA_FLAGS`; a flag the user has set keeps the user's value."""
    given = environ.get("XLA_FLAGS", "").split()
    names = {flag.partition("=")[0] for flag in given}
    ours = [f"{name}={value}" for name, value in SAFE_FLAGS.items() if name not in names]
    environ["XLA_FLAGS"] = " ".join([*given, *ours])
    environ.setdefault("NPROC", "1")


for _package in ("jax", "optax"):
    if find_spec(_package) is None:
        raise missing_extra(_package, "jax")
set_flags(os.environ)
