"""Folders that need an extra which is not installed are left out."""

from importlib.util import find_spec

NEEDED = {
    "traffic": ("gymnasium", "jax", "libsumo", "pettingzoo", "stable_baselines3", "traci"),
    "worlds": ("gymnasium", "jax", "pettingzoo"),
}
collect_ignore = [folder for folder, names in NEEDED.items() if not all(map(find_spec, names))]

if find_spec("jax"):
    import mbtl.engine.learners  # noqa: F401  # before jax: it sets jax's flags
