"""Domain randomisation as a context space: the ranges in a config of Isaac Lab's or mjlab's.

Both describe what is randomised by event terms, which have a `mode` and `params`. Each range among
the `params` is an axis here, named by its term and its place there:

    foot_friction.ranges   base_com.com_range.x   reset_gravity.gravity_distribution_params[2]

    space = space_of(cfg, only=["foot_friction"])
    env = ManagerBasedRlEnv(pinned(cfg, space.context(0)), device="cuda:0")

Configs are read by their shape, so neither package is imported. A range is a pair of numbers below
a name with "range" or "distribution_params". `distribution="log_uniform"` makes a `Log` axis; of
"gaussian" the two numbers are mean and standard deviation, and the axis is the mean plus and minus
two of them. What is one value already is no axis.
"""

from __future__ import annotations

import copy
import dataclasses
import math
import numbers
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

from mbtl.contexts import MOST, Axis, ContextSpace, Linear, Log, Value
from mbtl.errors import InvalidInput, check_known, few, unknown_name

__all__ = ["axes_of", "pinned", "space_of"]

_Config = TypeVar("_Config")
_Place = tuple[str | int, ...]
"""Keys and indices that lead from the `params` of a term to something in them."""
_RANGE = re.compile("range|distribution_params")
_AXES: dict[str, type[Linear | Log]] = {"uniform": Linear, "gaussian": Linear, "log_uniform": Log}
_DEVIATIONS = 2.0
"""How far the axis of a normal distribution reaches to each side of its mean."""


def axes_of(cfg: object, only: Sequence[str] | None = None) -> list[Axis]:
    """One axis per range, for a space of your own (`ContextSpace.grid`, `ContextSpace.points`).

    Args:
        cfg: the config of an environment, or its `events`.
        only: terms, or ranges of them by name, e.g. "base_com" or "base_com.com_range.x"; None:
            all, those of pushes and of where an episode begins too.

    Raises:
        UnknownName: `only` names nothing that has a range.
        InvalidInput: a range is not two finite numbers.
    """
    ranges = _ranges(cfg)
    chosen = [*ranges] if only is None else [only] if isinstance(only, str) else only
    for name in chosen:
        if not any(one.is_of(name) for one in ranges.values()):
            known = {*ranges, *(one.term for one in ranges.values())}
            raise unknown_name("term or range of more than one value", name, known)
    return [one.axis for one in ranges.values() if any(map(one.is_of, chosen))]


def space_of(cfg: object, only: Sequence[str] | None = None, *, values: int = 5) -> ContextSpace:
    """The grid of so many values on each range; see `axes_of`.

    Raises:
        InvalidInput: there are no ranges, or too many for a grid.
    """
    axes = axes_of(cfg, only)
    if not axes:
        raise InvalidInput("a context space needs a range, and each one here is one value already")
    if values > 1 and len(axes) > math.log(MOST, values):
        raise InvalidInput(
            f"a grid has at most {MOST:,} contexts, got {len(axes)} ranges of {values} values "
            f"({few([axis.name for axis in axes])}); choose some by `only`"
        )
    return ContextSpace.grid(dict.fromkeys(axes, values))


def pinned(cfg: _Config, context: Mapping[str, Value]) -> _Config:
    """A copy of a config in which each range that a context names is the context's value alone.

    An environment of the copy has that value on each body or joint of the term, however often it is
    drawn. A term that changes a property at intervals (it has an `operation`) does so at each reset
    instead, so that the value holds from the first step. All else stays random.

    Args:
        cfg: as for `axes_of`. No environment may have been made from it: Isaac Lab's write into
            their config.
        context: a context of `space_of(cfg)`, or of some axes of it.

    Raises:
        UnknownName: an axis is no range of this config.
        ContextMismatch: a value lies outside of its range.
    """
    ranges = _ranges(cfg)
    made = copy.deepcopy(cfg, {id(dataclasses.MISSING): dataclasses.MISSING})  # known by identity
    terms = _terms(made)
    for name, value in context.items():
        check_known("range of this config", name, ranges)
        ranges[name].axis.encode([value])  # raises where it lies outside
        ranges[name].pin(terms[ranges[name].term], float(value))
    return made


@dataclass(frozen=True)
class _Range:
    """A range in a config: its term, its name there, where its two numbers are, and what they are.

    Two numbers are the low and the high one, or mean and standard deviation.
    """

    term: str
    name: str
    first: _Place
    second: _Place
    pair: Sequence[Any]
    distribution: str

    @property
    def least(self) -> float:
        """What the second number is of a range that is one value."""
        return 0.0 if self.distribution == "gaussian" else self.pair[0]

    @property
    def is_pair(self) -> bool:
        fine = (isinstance(one, numbers.Real) and math.isfinite(one) for one in self.pair)
        return len(self.pair) == 2 and all(fine) and self.pair[1] >= self.least

    @property
    def axis(self) -> Axis:
        if not self.is_pair:
            raise InvalidInput(
                f"the range {self.name} needs two finite numbers, low and high (of gaussian: mean "
                f"and deviation), got {self.pair!r}; mend it, or leave it out by `only`"
            )
        check_known(f"distribution of {self.name}", self.distribution, _AXES)
        low, high = map(float, self.pair)
        if self.distribution == "gaussian":
            low, high = low - _DEVIATIONS * high, low + _DEVIATIONS * high
        return _AXES[self.distribution](self.name, low, high)

    def is_of(self, chosen: str) -> bool:
        """Whether it is the chosen range, or within the chosen term or part of one."""
        rest = self.name.removeprefix(chosen)
        return self.name.startswith(chosen) and rest[:1] in ("", ".", "[")

    def pin(self, term: Any, value: float) -> None:
        """Let a term draw this value and nothing else."""
        params = _with(term.params, self.first, value)
        params = _with(params, self.second, 0.0 if self.distribution == "gaussian" else value)
        term.params = params
        if term.mode == "interval" and "operation" in params:
            term.mode = "reset"


def _terms(cfg: object) -> dict[str, Any]:
    """Event terms by name, of an object or a mapping of them, or of what has it as `events`."""
    events = getattr(cfg, "events", cfg)
    members = events if isinstance(events, Mapping) else getattr(events, "__dict__", {})
    found = {name: one for name, one in members.items() if {"mode", "params"} <= {*dir(one)}}
    if not found or isinstance(events, type):
        raise InvalidInput(
            "domain randomisation is read from an object or mapping of event terms, which have "
            f"`mode` and `params`, or from what has one as `events`, got {cfg!r:.80}"
        )
    return found


def _ranges(cfg: object) -> dict[str, _Range]:
    """By name, every range that is more than one value."""
    every = (one for term, it in _terms(cfg).items() for one in _within(term, it.params))
    return {one.name: one for one in every if not (one.is_pair and one.pair[1] == one.least)}


def _within(
    term: str, node: object, place: _Place = (), distribution: str = "uniform"
) -> Iterator[_Range]:
    """All ranges at a place or below it. Of a pair of vectors each component is one."""
    if isinstance(node, Mapping):
        said: Any = node.get("distribution", distribution)
        for key, below in node.items():  # mjlab has objects for distributions, too
            yield from _within(term, below, (*place, key), str(getattr(said, "name", said)))
    elif isinstance(node, list | tuple) and any(_RANGE.search(str(key)) for key in place):
        vectors = len(node) == 2 and all(isinstance(one, list | tuple) for one in node)
        vectors = vectors and len(node[0]) == len(node[1])
        for i, pair in enumerate(zip(*node, strict=True)) if vectors else [(None, node)]:
            at = () if i is None else (i,)
            name = "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in place + at)
            yield _Range(term, term + name, (*place, 0, *at), (*place, 1, *at), pair, distribution)


def _with(node: Any, place: _Place, value: float) -> Any:
    """A copy with a value at a place; what is on the way is copied, as other terms may share it."""
    if not place:
        return value
    made: Any = list(node) if isinstance(node, tuple) else copy.copy(node)
    made[place[0]] = _with(node[place[0]], place[1:], value)
    return tuple(made) if isinstance(node, tuple) else made
