"""Compiled programs are kept on disk, so that the next process need not compile them again.

A training starts with seconds to a minute of compiling; jax can keep the results in a folder and
knows by a key of program, versions, flags and processor what fits. The folder is the user's own,
`$XDG_CACHE_HOME/mbtl/jax` or `~/.cache/mbtl/jax`; `MBTL_COMPILATION_CACHE` names another one, or is
`off`. Many processes may share it: an entry is written once, and what cannot be read is compiled.

The setting is one of jax in this process, not of the environment: child processes do not inherit
it. A program that started jax before us, or gave it a folder of its own, keeps its settings.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping
from pathlib import Path

VARIABLE = "MBTL_COMPILATION_CACHE"
_OFF = ("", "0", "off", "no", "none", "false")


def folder(environ: Mapping[str, str]) -> Path | None:
    """Where compiled programs are kept; None: nowhere."""
    own = environ.get(VARIABLE)
    if own is not None:
        return None if own.strip().lower() in _OFF else Path(own).expanduser()
    base = environ.get("XDG_CACHE_HOME", "")
    if not os.path.isabs(base):  # the standard says to ignore such a value
        home = environ.get("HOME") or os.path.expanduser("~")
        base = os.path.join(home, ".cache")
    return Path(base, "mbtl", "jax") if os.path.isabs(base) else None


def writable(place: Path) -> bool:
    """Whether files can be written there, after making the folder if need be."""
    try:
        place.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=place):
            return True
    except OSError:
        return False


def keep_programs(environ: Mapping[str, str]) -> None:
    """Let jax keep compiled programs, if there is a place and nobody has chosen one."""
    import jax

    place = folder(environ)
    if jax.config.jax_compilation_cache_dir is None and place is not None and writable(place):
        jax.config.update("jax_compilation_cache_dir", str(place))
