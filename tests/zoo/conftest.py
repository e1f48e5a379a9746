"""Folders and files that need an extra which is not installed are left out."""

from importlib.util import find_spec

NEEDED = {
    "traffic": ("gymnasium", "jax", "libsumo", "pettingzoo", "stable_baselines3", "traci"),
    "worlds": ("gymnasium", "jax", "pettingzoo"),
    "benchmark/test_kinds.py": ("gymnasium", "jax"),
    "benchmark/test_multitask_run.py": ("Box2D", "jax", "mujoco"),
    "cli/test_jax_commands.py": ("gymnasium", "jax"),
    "cli/test_locomotion_commands.py": ("Box2D", "jax", "mujoco"),
    "cli/test_play_own.py": ("PIL", "stable_baselines3"),
    "cli/test_traffic_commands.py": ("jax", "libsumo", "stable_baselines3"),
    "cmdps/test_walker.py": ("Box2D", "gymnasium"),
}
collect_ignore = [place for place, names in NEEDED.items() if not all(map(find_spec, names))]

if find_spec("jax"):
    import mbtl.engine.learners  # noqa: F401  # before jax: it sets jax's flags
