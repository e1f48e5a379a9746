"""Check: is this a contextual MDP that training, transfer and comparison can rely on?

Environments must be new and remember nothing, what they show must lie in its space, every axis must
act on the dynamics, contexts must not leak into each other, resets must be deterministic, numbers
finite. An axis acts when two of its values give different rollouts under the
same seed and actions, *not counting* observation numbers that are constant within a rollout: those
are labels (a visible context feature). So CartPole's cart mass under `physics="reference"` fails
whether it is hidden or visible; with it visible, its whole "generalisation gap" is an input shift.
"""

from __future__ import annotations

import contextlib
import itertools
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import KW_ONLY, asdict, dataclass
from functools import partial
from typing import Any, Literal

from mbtl.contexts import Categorical, Context, ContextSpace, Value
from mbtl.envs.recording import Rollout, difference, draw_actions, opened, roll, roll_together
from mbtl.errors import CheckFailed, InvalidInput, MissingExtra, Notice
from mbtl.faults import FAULTS, located, reason_of
from mbtl.problems.cmdp import CMDP
from mbtl.score import Score
from mbtl.seeds import action_seed

STEPS = 200
"""Environment steps per rollout. Raise it where a context acts late or rewards are sparse."""


def check_cmdp(
    problem: CMDP | Callable[[Context], Any],
    space: ContextSpace | None = None,
    *,
    nominal: Mapping[str, Value] | None = None,
    steps: int | None = None,
    seed: int = 0,
    on_check: Callable[[str], None] = lambda line: None,
) -> CheckReport:
    """Check a CMDP, or an environment factory with its contexts.

    Nothing is trained. Rollouts take random actions, so a context that acts only after long or
    clever behaviour needs more `steps` to be seen.

    Args:
        problem: a CMDP, or a function context -> `gymnasium.Env`.
        space: the contexts; needed with a function.
        nominal: context around which one axis is varied at a time; default: the CMDP's, else the
            middle of the space.
        steps: environment steps per rollout; None: the problem's own number, else `STEPS`.
        seed: of the resets and actions.
        on_check: told of each check as it begins.

    Returns:
        The report; it does not raise for a broken environment, see `CheckReport.raise_if_failed`.

    Raises:
        InvalidInput: a function without a space, or `steps` < 1.
        ContextMismatch: `nominal` is no context of these axes.
    """
    if steps is None:
        steps = getattr(problem, "check_steps", None) or STEPS
    if steps < 1:
        raise InvalidInput(f"a check needs steps >= 1, got {steps}")
    if isinstance(problem, CMDP):
        checks, make_env = list(_declared(problem)), problem.make_env
        alone = getattr(problem.trainer, "simulation", None) if make_env is None else None
        if alone is not None and alone(problem.space.context(0)) is not None:
            make_env = alone
        if make_env is None:
            unseen = (
                "it has none, so its dynamics cannot be looked into, and nothing is trained or "
                "evaluated here; a study tries its first policy on two contexts"
            )
            checks.append(Check("environment", "warning", unseen))
            return CheckReport(problem.id, tuple(checks))
        base = problem.nominal if nominal is None else nominal
        apart = [getattr(one, "apart", None) for one in (make_env, problem.trainer)]
        probe = Probe(
            make_env, problem.space, base, steps, seed, problem.horizon,
            score=problem.score, taken=problem.trainer.policy_format == "sb3",
            lives_well=False in apart, say=on_check,
        )  # fmt: skip
        return CheckReport(problem.id, (*checks, *probe.run()))
    if space is None:
        raise InvalidInput(
            "an environment factory is checked over its contexts; give a ContextSpace"
        )
    probe = Probe(problem, space, nominal, steps, seed, say=on_check)
    name = getattr(problem, "__name__", type(problem).__name__)
    return CheckReport(name, (_units(space), *probe.run()))


# ---- what the record says --------------------------------------------------------------------


def _declared(cmdp: CMDP) -> Iterator[Check]:
    """Finite bounds and a nominal context on the axes are enforced by `CMDP` itself."""
    yield _units(cmdp.space)
    if cmdp.bounds is None:
        yield Check("bounds", "warning", "none given; the scale will be that of the returns seen")
    else:
        yield Check("bounds", "passed", f"{cmdp.bounds[0]:g} to {cmdp.bounds[1]:g}, as given")
    if cmdp.nominal is None:
        unsaid = (
            "none given (nominal=, what one would train on unasked); the check starts mid-space"
        )
        yield Check("nominal context", "warning", unsaid)
    else:
        yield Check("nominal context", "passed", f"{dict(cmdp.nominal)} lies within the axes")


def _units(space: ContextSpace) -> Check:
    bare = [a.name for a in space.axes if not a.unit and not isinstance(a, Categorical)]
    if bare:
        return Check("units", "warning", f"axes without a unit: {', '.join(bare)}")
    return Check("units", "passed", "every numeric axis has one")


# ---- what a check finds --------------------------------------------------------------------------


Outcome = Literal["passed", "warning", "failed"]


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

    @property
    def said(self) -> str:
        """How many hold, failed, and could not be decided or may be meant."""
        outcomes = [check.outcome for check in self.checks]
        warnings = outcomes.count("warning")
        parts = [f"{outcomes.count('passed')} of {len(outcomes)} checks hold"]
        parts += [f"{len(self.failures)} failed"] if self.failures else []
        parts += [f"{warnings} warning{'s' * (warnings > 1)}"] if warnings else []
        return ", ".join(parts)

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
        return {"subject": self.subject, "ok": self.ok, "checks": list(map(asdict, self.checks))}


# ---- the dynamics --------------------------------------------------------------------------------


_MOST_CORNERS = 16
_UNDECIDED = "cannot be decided: a reset with the same seed does not repeat itself"
_ENDING = 2000
"""Steps within which an episode of unknown length is looked for an end."""


@dataclass
class Probe:
    """Runs one environment factory through all checks that need its dynamics.

    Attributes:
        make_env: context -> environment.
        space: of the contexts.
        nominal: where one axis is varied at a time; None: the middle of the space.
        steps: of each rollout.
        seed: of resets and actions.
        horizon: longest episode, where it is declared.
        score: what must be told at the end of an episode.
        taken: Stable-Baselines3 must take the spaces.
        lives_well: environments are known to run beside each other in one process.
        say: told of each check as it begins.
    """

    make_env: Callable[[Context], Any]
    space: ContextSpace
    nominal: Mapping[str, Value] | None
    steps: int
    seed: int
    horizon: int | None = None
    _: KW_ONLY
    score: Score | None = None
    taken: bool = False
    lives_well: bool = False
    say: Callable[[str], None] = lambda line: None

    def __post_init__(self) -> None:
        self._ends = {axis.name: _ends(self.space, axis.name) for axis in self.space.axes}
        self._base: Context = dict(self.space.middle if self.nominal is None else self.nominal)
        self.space.encode(self._base)
        self._actions: list[Any] = []
        self._first: Rollout | None = None  # of the base context, before any other was simulated
        self._sound = self._repeats = False

    def run(self) -> Iterator[Check]:
        """All checks; an environment that cannot be made or stepped fails the one that met it."""
        yield from self._guard("runs at the nominal context", self._first_rollout)
        if self._first is None:
            return
        yield from self._guard("environments are new and live side by side", self._new)
        if not self._sound:
            return
        yield from self._guard("observations and actions lie in their spaces", self._inside)
        yield from self._guard("same spaces in every context", self._spaces)
        yield from self._guard("runs and stays finite at the corners", self._corners)
        yield from self._guard("reset is deterministic", self._reset)
        for axis in self._ends:
            yield from self._guard(f"axis {axis!r} acts on the dynamics", partial(self._acts, axis))
        yield from self._guard("contexts do not leak", self._leaks)
        yield from self._guard("episodes end", self._episodes_end)

    def _guard(self, name: str, check: Callable[[], tuple[Outcome, str]]) -> Iterator[Check]:
        self.say(name)
        try:
            outcome, detail = check()
        except MissingExtra:  # the machine's fault, not the environment's
            raise
        except InvalidInput as error:
            outcome, detail = "failed", str(error)
        except FAULTS as error:  # a stranger's environment may raise anything
            outcome, detail = "failed", reason_of(error)
        yield Check(name, outcome, detail)

    def _roll(self, context: Context) -> Rollout:
        with self._opened(context) as (env,):
            return roll(env, self._actions, self.seed)

    @contextlib.contextmanager
    def _opened(self, context: Context, copies: int = 1) -> Iterator[list[Any]]:
        """Environments of one context, which their faults name."""
        with located(context), opened(*[partial(self._make, context)] * copies) as envs:
            yield envs

    def _make(self, context: Context) -> Any:
        with located(context):
            env = self.make_env(dict(context))  # a copy: an environment may change its argument
        from mbtl.envs.slots import as_one  # needs Gymnasium, which is there by now

        return as_one(env)

    # Each check returns its outcome and what was seen.

    def _new(self) -> tuple[Outcome, str]:
        """A new one at every call, without running statistics, in a process of its own if need be.

        It comes before any two are open: of some simulators two in one process never return.
        """
        from mbtl.envs.opening import TRIED, once_per_process
        from mbtl.envs.remote import remote

        found = None
        if not self.lives_well:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", Notice)  # it is in the report
                found = once_per_process(
                    self.make_env, self._extremes(), steps=min(self.steps, TRIED)
                )
        self._sound = True
        if found is None:
            return "passed", "two in one process do not disturb each other"
        apart = f"{found.name} lives once per process, so each gets a process of its own"
        if not found.silent:  # else it is a fault, which goes on to be found
            self.make_env = partial(remote, self.make_env)
        return "warning", apart + " in trainings" * found.silent

    def _first_rollout(self) -> tuple[Outcome, str]:
        with self._opened(self._base) as (env,):
            actions = draw_actions(env.action_space, self.steps, self.seed)
            rollout = roll(env, actions, self.seed)
        self._actions, self._first = actions, rollout
        bad = rollout.not_finite()
        return ("failed", bad) if bad else ("passed", f"{self.steps} steps at {self._base}")

    def _inside(self) -> tuple[Outcome, str]:
        from mbtl.envs.spaces import check_taken

        assert self._first is not None
        miss = self._first.outside
        if miss is not None and miss.far:
            return "failed", f"an observation is far outside its space: {miss.said}"
        with self._opened(self._base) as (env,):
            if self.taken:
                check_taken(env.observation_space, env.action_space)
        if miss is not None:
            return "warning", f"an observation is a little outside its space: {miss.said}"
        return "passed", f"in {self.steps} steps"

    def _spaces(self) -> tuple[Outcome, str]:
        from mbtl.envs.spaces import told_apart

        contexts = [self._base, *self._corner_contexts()]
        with opened(*(partial(self._make, context) for context in contexts)) as envs:
            for context, env in zip(contexts[1:], envs[1:], strict=True):
                for name in ("observation_space", "action_space"):
                    here, there = getattr(env, name), getattr(envs[0], name)
                    if here != there:
                        one, other = told_apart(here, there)
                        return "failed", f"{name} is {one} at {context}, {other} at {self._base}"
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
        if not self._repeats:
            return "warning", _UNDECIDED
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
        with self._opened(self._base, copies=2) as (env, other):
            first = roll(env, self._actions, self.seed)
            if seen := difference(first, roll(env, self._actions, self.seed)):
                return "failed", f"the same instance, reset with the same seed, differs: {seen}"
            if seen := difference(first, roll(other, self._actions, self.seed)):
                return "failed", f"another instance, reset with the same seed, differs: {seen}"
            self._repeats = True
            if not difference(first, roll(env, self._actions, self.seed + 1)):
                return "warning", "another seed gives the same rollout: is nothing random meant?"
        return "passed", "same seed, same rollout, in the same instance and in another"

    def _leaks(self) -> tuple[Outcome, str]:
        """A then B equals B alone; and both at once equal each alone."""
        if not self._repeats:
            return "warning", _UNDECIDED
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
        with self._opened(self._base) as (env,):
            limit = getattr(getattr(env, "spec", None), "max_episode_steps", None)
            steps = self.horizon or limit or max(self.steps, _ENDING)
            info = _last_info(env, steps, self.seed)
        if info is not None:
            told = "" if self.score is None else f", score {self.score.read(info):.4g}"
            return "passed", f"within {steps} steps of random actions{told}"
        if self.horizon is not None:
            return "failed", f"none within the declared horizon of {steps} steps"
        if limit is not None:
            return "failed", f"none within the {steps} steps of its own limit"
        return "warning", (
            f"none within {steps} steps; evaluation needs a time limit "
            "(gymnasium.wrappers.TimeLimit)"
        )

    # ---- which contexts ----------------------------------------------------------------------

    def _corner_contexts(self) -> list[Context]:
        """All combinations of extreme values of a small grid, else one axis at an extreme."""
        if self.space.shape is None:  # a list of points may not allow combinations of its values
            columns = self.space.unit.T
            rows = {int(i) for column in columns for i in (column.argmin(), column.argmax())}
            return [self.space.context(i) for i in sorted(rows)]
        product = itertools.product(*map(_outer, self._ends.values()))
        some = itertools.islice(product, _MOST_CORNERS + 1)
        corners: list[Context] = [dict(zip(self._ends, c, strict=True)) for c in some]
        if len(corners) <= _MOST_CORNERS:
            return corners
        return [{**self._base, axis: v} for axis, vs in self._ends.items() for v in _outer(vs)]

    def _extremes(self) -> tuple[Context, Context]:
        """Two contexts that differ in every axis, where the space has such."""
        corners = self._corner_contexts()
        return corners[0], corners[-1]


def _ends(space: ContextSpace, axis: str) -> list[Value]:
    """Values of one axis to compare: smallest and largest, or every level of a categorical one."""
    values = list(dict.fromkeys(space.values(axis)))
    if any(isinstance(a, Categorical) for a in space.axes if a.name == axis):
        return values
    return _outer(sorted(values))


def _last_info(env: Any, steps: int, seed: int) -> Mapping[str, Any] | None:
    """The info of the last step of an episode of random actions; None: it is longer than that."""
    env.action_space.seed(action_seed(seed))
    env.reset(seed=seed)
    for _ in range(steps):
        *_, terminated, truncated, info = env.step(env.action_space.sample())
        if terminated or truncated:
            found: Mapping[str, Any] = info
            return found
    return None


def _outer(values: Sequence[Value]) -> list[Value]:
    return list(dict.fromkeys((values[0], values[-1])))
