"""Algorithms of Stable-Baselines3 and sb3-contrib by name, and their keyword arguments."""

from __future__ import annotations

import copy
import importlib
import inspect
import math
import pkgutil
from collections.abc import Mapping
from functools import partial
from typing import Any

from mbtl.errors import InvalidInput, missing_extra, unknown_name

# Known without importing anything, so that describing a trainer costs nothing; a name that is not
# here is looked up in the installed packages.
_KNOWN = {
    "stable_baselines3": ("A2C", "DDPG", "DQN", "PPO", "SAC", "TD3"),
    "sb3_contrib": ("ARS", "CrossQ", "MaskablePPO", "QRDQN", "RecurrentPPO", "TQC", "TRPO"),
}
_FALLING = "lin_"
"""Of a hyperparameter that falls linearly over the training, as in rl-baselines3-zoo."""
_RESERVED = ("policy", "env", "seed", "device", "verbose", "tensorboard_log", "_init_setup_model")


def check_name(algorithm: str | type) -> None:
    """Refuse an unknown algorithm; imports nothing for those that are known.

    Raises:
        UnknownName: neither package has it.
    """
    if not any(algorithm in names for names in _KNOWN.values()):
        algorithm_class(algorithm)


def algorithm_class(algorithm: str | type) -> Any:
    """The class behind a name; a class is returned as it is.

    Raises:
        UnknownName: neither package has it.
        InvalidInput: the class is no Stable-Baselines3 algorithm.
        MissingExtra: the package that has it is not installed.
    """
    base = _package("stable_baselines3").common.base_class.BaseAlgorithm
    if not isinstance(algorithm, str):
        if isinstance(algorithm, type) and issubclass(algorithm, base):
            return algorithm
        raise InvalidInput(
            f"algorithm must be a name or a subclass of Stable-Baselines3's BaseAlgorithm, got "
            f"{algorithm!r}"
        )
    found: dict[str, Any] = {}
    for package, names in _KNOWN.items():
        try:
            module = _package(package)
        except ImportError:
            if algorithm in names:
                raise
            continue
        members = vars(module).items()
        found |= {n: c for n, c in members if isinstance(c, type) and issubclass(c, base)}
        if algorithm in found:
            return found[algorithm]
    raise unknown_name("algorithm", algorithm, found)


def checked_hyperparameters(algorithm: Any, given: Mapping[str, Any] | None) -> dict[str, Any]:
    """A deep copy of the keyword arguments (the library changes `policy_kwargs` in place).

    Where records and presets need plain values: `policy_kwargs["activation_fn"]` may be the name
    of a class of `torch.nn`; an argument that is a class, "module:name"; and a number that falls
    linearly to 0, which it reaches at the last update, "lin_" and its first value.

    Raises:
        UnknownName: the algorithm has no such argument.
        InvalidInput: an argument that the trainer sets itself, or a name of nothing.
    """
    known = inspect.signature(algorithm.__init__).parameters
    open_ended = any(p.kind is inspect.Parameter.VAR_KEYWORD for p in known.values())
    for name in given or {}:
        if name in _RESERVED:
            raise InvalidInput(
                f"hyperparameters are what the trainer does not set itself, got {name!r}; use the "
                "trainer's own argument"
            )
        if name not in known and not open_ended:
            names = [n for n in known if n != "self" and n not in _RESERVED]
            raise unknown_name(f"hyperparameter of {algorithm.__name__}", name, names)
    settings = {name: _resolved(name, value) for name, value in (given or {}).items()}
    activation = settings.get("policy_kwargs", {}).get("activation_fn")
    if isinstance(activation, str):
        from torch import nn

        if not hasattr(nn, activation):
            raise unknown_name("activation of torch.nn", activation, dir(nn))
        settings["policy_kwargs"]["activation_fn"] = getattr(nn, activation)
    return settings


def _resolved(name: str, value: Any) -> Any:
    """What a hyperparameter given by name stands for; any other is copied."""
    if isinstance(value, str) and name.endswith("_class"):
        try:
            found = pkgutil.resolve_name(value)
        except (ValueError, ImportError, AttributeError):
            found = None
        if not isinstance(found, type):
            raise InvalidInput(f"{name} names a class, 'module:name', got {value!r}")
        return found
    if isinstance(value, str) and value.startswith(_FALLING):
        try:
            first = float(value.removeprefix(_FALLING))
        except ValueError:
            first = math.nan
        if not (math.isfinite(first) and first > 0):
            raise InvalidInput(
                f"{name} that falls is '{_FALLING}' and its first value, as in '{_FALLING}1e-3', "
                f"got {value!r}"
            )
        return partial(_falling, first)
    return copy.deepcopy(value)


def _falling(first: float, left: float) -> float:
    """A schedule of the library; `left` is the share of the training that is still to come."""
    return first * left


def _package(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name != name:
            raise
        raise missing_extra(name.replace("_", "-"), "train") from error
