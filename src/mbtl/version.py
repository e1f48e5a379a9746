"""The version of the package, in one place that imports nothing heavy."""

from importlib.metadata import PackageNotFoundError, version

try:
    __version__ = version("mbtl")
except PackageNotFoundError:  # a source tree that was never installed
    __version__ = "0+unknown"
