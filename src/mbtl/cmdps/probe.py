"""Probe: runs an environment factory through everything that a CMDP promises about its dynamics."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

from mbtl.cmdps.findings import Check, Outcome
from mbtl.cmdps.rollouts import Rollout, difference, draw_actions, opened, roll, roll_together
from mbtl.contexts import Categorical, Context, ContextSpace, Value
from mbtl.errors import MissingExtra

_MOST_CORNERS = 16


class Probe:
    """Runs one environment factory through all checks that need its dynamics."""

    def __init__(
        self,
        make_env: Callable[[Context], Any],
        space: ContextSpace,
        nominal: Mapping[str, Value] | None,
        steps: int,
        seed: int,
        horizon: int | None = None,
    ) -> None:
        self.space, self.steps, self.seed, self.horizon = space, steps, seed, horizon
        self._make_env = make_env
        self._ends = {axis.name: _ends(space, axis.name) for axis in space.axes}
        if nominal is None:
            nominal = space.context(_central(space))
        space.encode(nominal)
        self._base: Context = dict(nominal)
        self._actions: list[Any] = []
        self._first: Rollout | None = None  # of the base context, before any other was simulated

    def run(self) -> Iterator[Check]:
        """All checks; an environment that cannot be made or stepped fails the one that met it."""
        yield from self._guard("runs at the nominal context", self._first_rollout)
        if self._first is None:
            return
        yield from self._guard("same spaces in every context", self._spaces)
        yield from self._guard("runs and stays finite at the corners", self._corners)
        for axis in self._ends:
            yield from self._guard(f"axis {axis!r} acts on the dynamics", partial(self._acts, axis))
        yield from self._guard("reset is deterministic", self._reset)
        yield from self._guard("contexts do not leak", self._leaks)
        yield from self._guard("episodes end", self._episodes_end)

    def _guard(self, name: str, check: Callable[[], tuple[Outcome, str]]) -> Iterator[Check]:
        try:
            outcome, detail = check()
        except MissingExtra:  # the machine's fault, not the environment's
            raise
        except Exception as error:  # a stranger's environment may raise anything
            outcome, detail = "failed", f"{type(error).__name__}: {error}"
        yield Check(name, outcome, detail)

    def _roll(self, context: Context) -> Rollout:
        with opened(partial(self._make, context)) as (env,):
            return roll(env, self._actions, self.seed)

    def _make(self, context: Context) -> Any:
        env = self._make_env(dict(context))  # a copy: an environment may change its argument
        from mbtl.envs.slots import as_one  # needs Gymnasium, which is there by now

        return as_one(env)

    # Each check returns its outcome and what was seen.

    def _first_rollout(self) -> tuple[Outcome, str]:
        with opened(partial(self._make, self._base)) as (env,):
            actions = draw_actions(env.action_space, self.steps, self.seed)
            rollout = roll(env, actions, self.seed)
        self._actions, self._first = actions, rollout
        bad = rollout.not_finite()
        return ("failed", bad) if bad else ("passed", f"{self.steps} steps at {self._base}")

    def _spaces(self) -> tuple[Outcome, str]:
        contexts = [self._base, *self._corner_contexts()]
        with opened(*(partial(self._make, context) for context in contexts)) as envs:
            for context, env in zip(contexts[1:], envs[1:], strict=True):
                for name in ("observation_space", "action_space"):
                    here, there = getattr(env, name), getattr(envs[0], name)
                    if here != there:
                        return "failed", f"{name} is {here} at {context}, {there} at {self._base}"
        return "passed", f"{len(contexts)} contexts"

    def _corners(self) -> tuple[Outcome, str]:
        corners = self._corner_contexts()
        for context in corners:
            bad = self._roll(context).not_finite()
            if bad:
                return "failed", f"{bad} at {context}"
        return "passed", f"{len(corners)} contexts"

    def _acts(self, axis: str) -> tuple[Outcome, str]:
        values = self._ends[axis]
        if len(values) < 2:
            return "warning", "it has a single value"
        rollouts = [self._roll({**self._base, axis: value}) for value in values]
        for value, rollout in zip(values[1:], rollouts[1:], strict=True):
            seen = difference(rollouts[0], rollout, dynamics_only=True)
            if seen:
                return "passed", f"{values[0]!r} and {value!r} differ: {seen}"
        label = any(difference(rollouts[0], rollout) for rollout in rollouts[1:])
        same = f"{', '.join(map(repr, values))} give the same {self.steps} steps"
        if label:
            same += "; only a constant part of the observation, which shows the context, differs"
        return "failed", same

    def _reset(self) -> tuple[Outcome, str]:
        make = partial(self._make, self._base)
        with opened(make, make) as (env, other):
            first = roll(env, self._actions, self.seed)
            if seen := difference(first, roll(env, self._actions, self.seed)):
                return "failed", f"the same instance, reset with the same seed, differs: {seen}"
            if seen := difference(first, roll(other, self._actions, self.seed)):
                return "failed", f"another instance, reset with the same seed, differs: {seen}"
        return "passed", "same seed, same rollout, in the same instance and in another"

    def _leaks(self) -> tuple[Outcome, str]:
        """A then B equals B alone; and both at once equal each alone."""
        one, two = self._extremes()
        alone = [self._roll(one), self._roll(two)]
        again = [self._roll(one), self._roll(two)]
        with opened(partial(self._make, one), partial(self._make, two)) as envs:
            together = roll_together(envs, self._actions, self.seed)
        assert self._first is not None
        if seen := difference(self._first, self._roll(self._base)):
            return "failed", f"{self._base} differs after other contexts were simulated: {seen}"
        for context, own, after, beside in zip((one, two), alone, again, together, strict=True):
            if seen := difference(own, after):
                return "failed", f"{context} differs after another context was simulated: {seen}"
            if seen := difference(own, beside):
                return "failed", f"{context} differs while another context is simulated: {seen}"
        return "passed", f"{one} and {two}, in turn and at once"

    def _episodes_end(self) -> tuple[Outcome, str]:
        steps = self.steps if self.horizon is None else self.horizon
        with opened(partial(self._make, self._base)) as (env,):
            actions = draw_actions(env.action_space, steps, self.seed)
            if roll(env, actions, self.seed).ended:
                return "passed", f"within {steps} steps of random actions"
        if self.horizon is not None:
            return "failed", f"none within the declared horizon of {steps} steps"
        return "warning", f"none within {steps} steps; evaluation needs a time limit"

    # ---- which contexts ----------------------------------------------------------------------

    def _corner_contexts(self) -> list[Context]:
        """All combinations of extreme values of a small grid, else one axis at an extreme."""
        if self.space.shape is None:  # a list of points may not allow combinations of its values
            return self._listed_extremes()
        product = itertools.product(*map(_outer, self._ends.values()))
        some = itertools.islice(product, _MOST_CORNERS + 1)
        corners: list[Context] = [dict(zip(self._ends, c, strict=True)) for c in some]
        if len(corners) <= _MOST_CORNERS:
            return corners
        return [{**self._base, axis: v} for axis, vs in self._ends.items() for v in _outer(vs)]

    def _listed_extremes(self) -> list[Context]:
        rows = {int(i) for column in self.space.unit.T for i in (column.argmin(), column.argmax())}
        return [self.space.context(i) for i in sorted(rows)]

    def _extremes(self) -> tuple[Context, Context]:
        """Two contexts that differ in every axis, where the space has such."""
        corners = self._corner_contexts()
        return corners[0], corners[-1]


def _ends(space: ContextSpace, axis: str) -> list[Value]:
    """Values of one axis to compare: smallest and largest, or every level of a categorical one."""
    values = list(dict.fromkeys(space.values(axis)))
    if any(isinstance(a, Categorical) for a in space.axes if a.name == axis):
        return values
    numbers: list[float] = sorted(values)  # type: ignore[arg-type]
    return [*dict.fromkeys((numbers[0], numbers[-1]))]


def _outer(values: Sequence[Value]) -> list[Value]:
    return list(dict.fromkeys((values[0], values[-1])))


def _central(space: ContextSpace) -> int:
    """Index of the context nearest to the middle of the space."""
    middle = (space.unit.min(axis=0) + space.unit.max(axis=0)) / 2.0
    return int(((space.unit - middle) ** 2).sum(axis=1).argmin())
