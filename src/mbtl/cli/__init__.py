"""The command line: one module per command.

Exit codes: 0 done, 1 failed, 2 wrong usage, 130 interrupted.
"""

from mbtl.cli.app import main, program

__all__ = ["main", "program"]
