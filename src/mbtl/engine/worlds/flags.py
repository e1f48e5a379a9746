"""Importing this starts jax, with settings that it reads when it makes its first client.

jax 0.10 on few cores can hang for ever in compiled programs with many small parallel operations,
which its concurrency-optimised scheduler hands to a pool of few threads. Our programs are of that
kind (a hundred tiny networks), so that scheduler is switched off. It has no say on a GPU.
Networks of this size are computed faster by one thread than by several that wait for each other
(`NPROC` is where jax's CPU client reads the number); more cores are used by more processes.
Another hang, that of batched QR factorisations, is avoided in `networks.init_weights`.

The settings travel in the environment of the process. They are there while jax starts and no
longer: what a user's program starts later must not inherit them.

Compiled programs are kept on disk, so that the next process need not compile them again.
A training starts with seconds to a minute of compiling; jax can keep the results in a folder and
knows by a key of program, versions, flags and processor what fits. The folder is the user's own,
`$XDG_CACHE_HOME/mbtl/jax` or `~/.cache/mbtl/jax`; jax's own `JAX_COMPILATION_CACHE_DIR` names
another one, and `JAX_ENABLE_COMPILATION_CACHE=false` none. Many processes may share it: an entry is
written once, and what cannot be read is compiled.

The setting is one of jax in this process, not of the environment: child processes do not inherit
it. A program that started jax before us, or gave it a folder of its own, keeps its settings.
"""

from __future__ import annotations

import contextlib
import os
import tempfile
import warnings
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path

from mbtl.errors import missing_extra
from mbtl.processes import usable_cores

_SCHEDULER = "--xla_cpu_enable_concurrency_optimized_scheduler"
_SAFE = f"{_SCHEDULER}=false"
_FLAGS, _THREADS = "XLA_FLAGS", "NPROC"
_FEW = 8
"""Cores on which the scheduler is warned of; hangs were seen on two."""


def settings(environ: Mapping[str, str]) -> dict[str, str]:
    """What the environment lacks; a flag, or a number of threads, of the user's own stays."""
    given = environ.get(_FLAGS, "")
    lacking = {} if _SCHEDULER in given else {_FLAGS: f"{given} {_SAFE}".strip()}
    return lacking if _THREADS in environ else {**lacking, _THREADS: "1"}


def start_jax() -> None:
    """Start jax with our settings, unless it runs already; then warn where it could hang."""
    import jax
    from jax._src import xla_bridge  # there is no public question of this kind

    if xla_bridge.backends_are_initialized():
        _warn(jax.default_backend())
        return
    lent = settings(os.environ)
    before = {name: os.environ[name] for name in lent if name in os.environ}
    os.environ.update(lent)
    try:
        jax.devices()
    finally:
        for name in lent:
            del os.environ[name]
        os.environ.update(before)
    keep_programs()


def _warn(backend: str) -> None:
    if backend == "cpu" and usable_cores() <= _FEW and _FLAGS in settings(os.environ):
        warnings.warn(
            f"jax was started before mbtl.engine.worlds and without {_SAFE}: on few cores its "
            f"programs can hang; import mbtl.engine.worlds before jax computes, or set "
            f"{_FLAGS}={_SAFE} in the environment",
            RuntimeWarning,
            stacklevel=2,
        )


# ---- compiled programs ---------------------------------------------------------------------------


def keep_programs() -> None:
    """Let jax keep compiled programs, if there is a place and nobody has chosen one."""
    import jax

    if jax.config.jax_compilation_cache_dir is None:
        with contextlib.suppress(OSError, RuntimeError):  # no home, or one that cannot be written
            place = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache", "mbtl", "jax")
            place.mkdir(parents=True, exist_ok=True)
            tempfile.TemporaryFile(dir=place).close()
            jax.config.update("jax_compilation_cache_dir", str(place))


for _package in ("jax", "optax"):
    if find_spec(_package) is None:
        raise missing_extra(_package, "jax")
start_jax()
