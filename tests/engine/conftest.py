"""Tests of the engine: jax starts with our settings before a test computes anything."""

from importlib.util import find_spec

if find_spec("jax") is None or find_spec("gymnasium") is None:
    collect_ignore_glob = ["*"]
else:
    import mbtl.engine.worlds  # noqa: F401
