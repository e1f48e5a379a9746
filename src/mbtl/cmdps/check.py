"""Check: is this a contextual MDP that training, transfer and comparison can rely on?

Every axis must act on the dynamics, contexts must not leak into each other, resets must be
deterministic, numbers finite. An axis acts when two of its values give different rollouts under the
same seed and actions, *not counting* observation numbers that are constant within a rollout: those
are labels (a visible context feature). So CartPole's cart mass under `physics="reference"` fails
whether it is hidden or visible; with it visible, its whole "generalisation gap" is an input shift.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

from mbtl.cmdps.cmdp import CMDP
from mbtl.cmdps.rollouts import Rollout, difference, draw_actions, opened, roll, roll_together
from mbtl.contexts import Categorical, Context, ContextSpace, Value
from mbtl.errors import CheckFailed, InvalidInput

Outcome = Literal["passed", "warning", "failed"]

STEPS = 200
"""Environment steps per rollout. Raise it where a context acts late or rewards are sparse."""

_MOST_CORNERS = 16


@dataclass(frozen=True)
class Check:
    """One claim and what came of it.

    Attributes:
        name: the claim, e.g. "axis 'length' acts on the dynamics".
        outcome: "warning" means that it could not be decided, or may be meant.
        detail: what was seen.
    """

    name: str
    outcome: Outcome
    detail: str = ""

    @property
    def ok(self) -> bool:
        """True unless it failed."""
        return self.outcome != "failed"


@dataclass(frozen=True)
class CheckReport:
    """All checks of one CMDP.

    Attributes:
        subject: what was checked.
        checks: in the order in which they ran.
    """

    subject: str
    checks: tuple[Check, ...]

    @property
    def ok(self) -> bool:
        """True when nothing failed; warnings are allowed."""
        return all(check.ok for check in self.checks)

    @property
    def failures(self) -> list[Check]:
        """The checks that failed."""
        return [check for check in self.checks if not check.ok]

    def raise_if_failed(self) -> None:
        """Do nothing when all is well.

        Raises:
            CheckFailed: naming what failed.
        """
        if self.failures:
            listed = "; ".join(f"{check.name}: {check.detail}" for check in self.failures)
            raise CheckFailed(
                f"{self.subject} failed {len(self.failures)} of {len(self.checks)} checks: {listed}"
            )

    def to_json(self) -> dict[str, Any]:
        """JSON-able record."""
        checks = [{"name": c.name, "outcome": c.outcome, "detail": c.detail} for c in self.checks]
        return {"subject": self.subject, "ok": self.ok, "checks": checks}


def check_cmdp(
    problem: CMDP | Callable[[Context], Any],
    space: ContextSpace | None = None,
    *,
    nominal: Mapping[str, Value] | None = None,
    steps: int = STEPS,
    seed: int = 0,
) -> CheckReport:
    """Check a CMDP, or an environment factory with its contexts.

    Nothing is trained. Rollouts take random actions, so a context that acts only after long or
    clever behaviour needs more `steps` to be seen.

    Args:
        problem: a CMDP, or a function context -> `gymnasium.Env`.
        space: the contexts; needed with a function.
        nominal: context around which one axis is varied at a time; default: the CMDP's, else the
            middle of the space.
        steps: environment steps per rollout.
        seed: of the resets and actions.

    Returns:
        The report; it does not raise for a broken environment, see `CheckReport.raise_if_failed`.

    Raises:
        InvalidInput: a function without a space, or `steps` < 1.
        ContextMismatch: `nominal` is no context of these axes.
    """
    if steps < 1:
        raise InvalidInput(f"a check needs steps >= 1, got {steps}")
    if isinstance(problem, CMDP):
        checks = list(_declared(problem))
        if problem.make_env is None:
            unseen = "given as functions, so its dynamics cannot be looked into"
            checks.append(Check("environment", "warning", unseen))
            return CheckReport(problem.id, tuple(checks))
        probe = _Probe(problem.make_env, problem.space, nominal or problem.nominal, steps, seed)
        probe.horizon = problem.horizon
        return CheckReport(problem.id, (*checks, *probe.run()))
    if space is None:
        raise InvalidInput(
            "an environment factory is checked over its contexts; give a ContextSpace"
        )
    name = getattr(problem, "__name__", type(problem).__name__)
    units = _units(space)
    return CheckReport(name, (units, *_Probe(problem, space, nominal, steps, seed).run()))


# ---- what the record says ----------------------------------------------------------------------


def _declared(cmdp: CMDP) -> Iterator[Check]:
    """Finite bounds and a nominal context on the axes are enforced by `CMDP` itself."""
    yield _units(cmdp.space)
    if cmdp.bounds is None:
        yield Check("bounds", "warning", "none given; performance will be relative to returns seen")
    else:
        yield Check("bounds", "passed", f"finite, {cmdp.bounds[0]:g} to {cmdp.bounds[1]:g}")
    if cmdp.nominal is None:
        yield Check("nominal context", "warning", "none given; the middle of the space is used")
    else:
        yield Check("nominal context", "passed", f"{dict(cmdp.nominal)} lies within the axes")


def _units(space: ContextSpace) -> Check:
    bare = [a.name for a in space.axes if not a.unit and not isinstance(a, Categorical)]
    if bare:
        return Check("units", "warning", f"axes without a unit: {', '.join(bare)}")
    return Check("units", "passed", "every numeric axis has one")


# ---- what the environment does -----------------------------------------------------------------


class _Probe:
    """Runs one environment factory through all checks that need its dynamics."""

    def __init__(
        self,
        make_env: Callable[[Context], Any],
        space: ContextSpace,
        nominal: Mapping[str, Value] | None,
        steps: int,
        seed: int,
    ) -> None:
        self.space, self.steps, self.seed = space, steps, seed
        self.horizon: int | None = None
        self._make_env = make_env
        self._ends = {axis.name: _ends(space, axis.name) for axis in space.axes}
        if nominal is None:
            nominal = space.context(_central(space))
        space.encode(nominal)
        self._base: Context = dict(nominal)
        self._actions: list[Any] = []

    def run(self) -> Iterator[Check]:
        """All checks; an environment that cannot be made or stepped fails the one that met it."""
        yield from self._guard("runs at the nominal context", self._first_rollout)
        if not self._actions:
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
        except (
            Exception
        ) as error:  # the environment is a stranger's; whatever it raises is a finding
            outcome, detail = "failed", f"{type(error).__name__}: {error}"
        yield Check(name, outcome, detail)

    def _roll(self, context: Context) -> Rollout:
        with opened(partial(self._make, context)) as (env,):
            return roll(env, self._actions, self.seed)

    def _make(self, context: Context) -> Any:
        return self._make_env(
            dict(context)
        )  # a copy: an environment may keep or change its argument

    # Each check returns its outcome and what was seen.

    def _first_rollout(self) -> tuple[Outcome, str]:
        with opened(partial(self._make, self._base)) as (env,):
            actions = draw_actions(env.action_space, self.steps, self.seed)
            rollout = roll(env, actions, self.seed)
        self._actions = actions
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
        product = itertools.product(*(_outer(values) for values in self._ends.values()))
        corners = [
            dict(zip(self._ends, corner, strict=True))
            for corner in itertools.islice(product, _MOST_CORNERS + 1)
        ]
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
    kinds = {a.name: a for a in space.axes}
    return values if isinstance(kinds[axis], Categorical) else sorted({min(values), max(values)})  # type: ignore[type-var]


def _outer(values: Sequence[Value]) -> list[Value]:
    return list(dict.fromkeys((values[0], values[-1])))


def _central(space: ContextSpace) -> int:
    """Index of the context nearest to the middle of the space."""
    middle = (space.unit.min(axis=0) + space.unit.max(axis=0)) / 2.0
    return int(((space.unit - middle) ** 2).sum(axis=1).argmin())
