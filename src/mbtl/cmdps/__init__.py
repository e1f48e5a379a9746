"""CMDPs: ours by id, a user's own as the same record, and the check for both.

Importing this registers the Gymnasium ids `mbtl/<cmdp>-v<version>` where Gymnasium is installed.
"""

from importlib.util import find_spec

from mbtl.cmdps.check import check_cmdp
from mbtl.cmdps.cmdp import CMDP, Preset
from mbtl.cmdps.findings import Check, CheckReport
from mbtl.cmdps.loading import resolve_cmdp
from mbtl.cmdps.registry import cmdp_ids, get_cmdp, gym_id
from mbtl.loading import load_object

__all__ = [
    "CMDP",
    "Check",
    "CheckReport",
    "Preset",
    "check_cmdp",
    "cmdp_ids",
    "get_cmdp",
    "gym_id",
    "load_object",
    "resolve_cmdp",
]

if find_spec("gymnasium") is not None:
    from mbtl.cmdps.registration import register_envs

    register_envs()
