"""Our CMDPs by id, in Gymnasium, in SUMO, and in jax.

Importing this registers the Gymnasium ids `mbtl/<cmdp>-v<version>` where Gymnasium is installed.
"""

from importlib.util import find_spec

from mbtl.zoo.cmdps.registry import cmdp_ids, get_cmdp, gym_id

__all__ = ["cmdp_ids", "get_cmdp", "gym_id"]

if find_spec("gymnasium") is not None:
    from mbtl.zoo.cmdps.registration import register_envs

    register_envs()
