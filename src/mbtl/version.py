"""Versions of the package and of others, in one place that imports nothing heavy."""

from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version


def installed(*names: str) -> dict[str, str]:
    """Versions of those packages that are installed, by name."""
    found = {}
    for name in names:
        with suppress(PackageNotFoundError):
            found[name] = version(name)
    return found


__version__ = installed("mbtl").get("mbtl", "0+unknown")  # a source tree that was never installed
