"""Check: is this a contextual MDP that training, transfer and comparison can rely on?

Environments must be new and remember nothing, what they show must lie in its space, every axis must
act on the dynamics, contexts must not leak into each other, resets must be deterministic, numbers
finite. An axis acts when two of its values give different rollouts under the
same seed and actions, *not counting* observation numbers that are constant within a rollout: those
are labels (a visible context feature). So CartPole's cart mass under `physics="reference"` fails
whether it is hidden or visible; with it visible, its whole "generalisation gap" is an input shift.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from mbtl.contexts import Categorical, Context, ContextSpace, Value
from mbtl.errors import InvalidInput
from mbtl.problems.cmdp import CMDP
from mbtl.problems.findings import Check, CheckReport
from mbtl.problems.probe import Probe

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
        on_check: told of each check as it begins, and how long the rest will take.

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
        checks = list(_declared(problem))
        if problem.make_env is None:
            unseen = "given as functions, so its dynamics cannot be looked into"
            checks.append(Check("environment", "warning", unseen))
            return CheckReport(problem.id, tuple(checks))
        base = problem.nominal if nominal is None else nominal
        apart = [getattr(one, "apart", None) for one in (problem.make_env, problem.trainer)]
        probe = Probe(
            problem.make_env, problem.space, base, steps, seed, problem.horizon,
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


# ---- what the record says ----------------------------------------------------------------------


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
