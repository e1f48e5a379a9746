"""Problems: a contextual MDP as one record, a user's own or one by id, and the check for both."""

from mbtl.faults import load_object
from mbtl.problems.adapting import Adapted, adapt, with_adapted
from mbtl.problems.check import Check, CheckReport, check_cmdp
from mbtl.problems.cmdp import CMDP, Preset
from mbtl.problems.loading import cmdp_ids, get_cmdp, resolve_cmdp

__all__ = [
    "CMDP",
    "Adapted",
    "Check",
    "CheckReport",
    "Preset",
    "adapt",
    "check_cmdp",
    "cmdp_ids",
    "get_cmdp",
    "load_object",
    "resolve_cmdp",
    "with_adapted",
]
