"""What a study answers when it is asked: hand out again, propose, or end."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from mbtl.contexts import middle_of
from mbtl.errors import InvalidInput
from mbtl.processes import threads_for
from mbtl.seeds import selection_rng
from mbtl.selectors.base import Exhausted, Proposal, open_candidates
from mbtl.selectors.contract import Selector, check_proposal, name_of
from mbtl.selectors.targets import spread_targets
from mbtl.study.events import Event
from mbtl.study.leases import PROPOSING, Watch, new_token
from mbtl.study.records import StudyFinished, StudyWaiting
from mbtl.study.spec import LEAST_TARGETS, StudySpec
from mbtl.study.state import StudyState
from mbtl.trainers.contract import DEEDS, Ability, checked_targets

LEAST_ROWS = 3
"""Rows before a prediction may end the study: one or two say too little of how rows differ."""
LEAST_UNIT = 1e-6
"""Units that are no training any more."""


def claim(state: StudyState, watch: Watch, seconds: float | None, worker: str) -> Event | None:
    """The event that gives a worker a pick: one that nobody works on, or the next one.

    Where nothing more is trained it is the release of a pick whose worker is silent.

    The next one is proposed after that (`propose`), so that nobody else looks for it meanwhile.
    None: somebody else does; ask again in a moment.

    Args:
        state: of the study.
        watch: knows whose lease is stale.
        seconds: that the lease is to last; None: for ever.
        worker: who asks.

    Raises:
        StudyFinished: nothing can be asked; `StudyWaiting`: for the moment.
    """
    early, left = _early_stop(state), left_alone(state, watch)
    if early is not None:
        if silent := [number for number in left if state.open_picks[number].lease is not None]:
            return Event("released", {"pick": silent[0]})
        raise StudyFinished(f"the study is finished: {early}")
    holder = {"worker": worker, "token": new_token()}
    if left:
        return Event("claimed", {"pick": left[0], "seconds": seconds, **holder})
    reason = stop_reason(state)
    if reason is not None:
        held = len(state.open_picks)
        if held and reason == state.stopped:
            raise StudyWaiting(
                f"nothing can be asked until one of the {held} picks under way is told: {reason}"
            )
        waiting = f"; {held} picks are still under way" if held else ""
        raise StudyFinished(f"the study is finished: {reason}{waiting}")
    if state.proposing is not None and not watch.is_stale(state.proposing):
        return None
    return Event("claimed", {"pick": len(state.picks), "seconds": PROPOSING, **holder})


def stop_reason(state: StudyState) -> str | None:
    """Why nothing more can be asked; None while something can."""
    reason = _early_stop(state) or state.stopped or spent(state)
    if reason is not None or state.spec.any_training:  # where something may always go on
        return reason
    try:
        open_candidates(state.problem(), state.history().specialists())
    except Exhausted as error:
        return str(error)
    return None


def spent(state: StudyState) -> str | None:
    """That no training can be paid any more; None: one can be."""
    spec = state.spec
    if spec.steps is None:
        over = state.paid > spec.budget - LEAST_UNIT
        what = ("unit" if spec.any_training else "training") + "s" * (spec.budget > 1)
        return f"the budget of {spec.budget} {what} is spent" if over else None
    left = _steps_left(state)
    least = 0.0 if spec.any_training else state.unit_steps
    if left >= least + state.target_steps * min(LEAST_TARGETS, spec.space.n):
        return None
    return (
        f"of the budget of {spec.steps:,} steps {max(left, 0.0):,.0f} are left, and a training "
        "with its evaluation takes more"
    )


def is_finished(state: StudyState) -> bool:
    """True when nothing can be asked and nobody works on a pick."""
    held = len(state.open_picks) - len(given_back(state))
    open_picks = held if _early_stop(state) else len(state.open_picks)
    return stop_reason(state) is not None and not open_picks


def given_back(state: StudyState) -> list[int]:
    """Numbers of open picks that were given back."""
    return sorted(n for n, pick in state.open_picks.items() if pick.worker is None)


def is_open(state: StudyState, facts: Mapping[str, Any]) -> bool:
    """True where what these facts of a pick ask for is neither done, under way nor failed.

    Others may have come to the same meanwhile.
    """
    start = facts.get("start")
    if start is not None and state.place_of(start) < 0:
        return False
    pick = state.planned(facts)
    if pick.length:
        return state.training_of(pick) not in state.history().asked
    others = (*state.open_picks.values(), *(state.picks[one.pick] for one in state.failures))
    asked = {(one.start, one.targets) for one in others if not one.length}
    return (pick.start, pick.targets) not in asked


def _steps_left(state: StudyState) -> float:
    """Environment steps that are left of the budget; infinite where they are not counted."""
    return np.inf if state.spec.steps is None else state.spec.steps - state.bill().total


def left_alone(state: StudyState, watch: Watch) -> list[int]:
    """Numbers of open picks that nobody works on: given back, or their lease is stale."""
    return [n for n, pick in sorted(state.open_picks.items()) if watch.is_stale(pick.lease)]


def others(state: StudyState, watch: Watch, worker: str, *, for_ever: bool = True) -> list[str]:
    """Names of other workers that hold picks; on request only those who would be missed in time."""
    leases = [pick.lease for pick in state.open_picks.values() if pick.lease is not None]
    ending = [lease for lease in leases if for_ever or lease.seconds is not None]
    return sorted({lease.worker for lease in ending if not watch.is_stale(lease)} - {worker})


def _early_stop(state: StudyState) -> str | None:
    """The level or the cost budget that was reached; picks given back are not trained then."""
    spec = state.spec
    at_most = None if spec.stop_left is None else spec.best_return
    if state.rows and (spec.stop_value, at_most) != (None, None):  # else V is not worth a fit
        now = state.routing().value
        least = now.at_least(spec.stop_confidence)
        if spec.stop_value is not None and least >= spec.stop_value:
            sure = f" ({least:.4f} or more, surely)" if now.error else ""
            return f"V = {now.value:.4f}{sure} reaches the level {spec.stop_value:g}"
        if spec.stop_left is not None and spec.best_return is not None:
            most = float(state.bounds().normalise(spec.best_return))
            if abs(most - least) < spec.stop_left:  # surely above: there is more, after all
                within = f"V = {now.value:.4f} is within {spec.stop_left:g} of the largest"
                return f"{within} there can be, {most:g}"
    if spec.cost_budget is not None and state.cost >= spec.cost_budget:
        return f"the cost {state.cost:g} reaches the budget of {spec.cost_budget:g}"
    if spec.costs is not None and state.cost_left < 0.0:
        untried = [n for n in given_back(state) if not state.picks[n].retries]
        if untried:  # what failed is begun again all the same
            return f"the picks given back cost more than is left of {spec.cost_budget:g}"
    return None


def propose(state: StudyState, strategy: Selector) -> dict[str, Any] | str:
    """The facts of the next pick, or why there is none until something is told.

    Args:
        state: of the study, a copy: others may tell meanwhile.
        strategy: proposes.

    Raises:
        StudyFinished: no context is left.
        InvalidInput: the strategy breaks its contract.
    """
    spec, problem, known = state.spec, state.problem(), state.history()
    trained = sum(pick.price > 0.0 for pick in state.picks)
    rng = selection_rng(spec.seed, spec.trial, trained)
    seen = known if spec.any_training else known.specialists()
    try:
        with threads_for(problem.n):
            proposal = strategy.propose(problem, seen, rng)
    except Exhausted as error:
        if spec.any_training:  # for the moment: what is under way may be gone on with
            return str(error)
        raise StudyFinished(f"the study is finished: {error}") from error
    check_proposal(strategy, proposal, seen, any_training=spec.any_training)
    if proposal.targets is not None:
        checked_targets(proposal.targets, problem.n)
    facts = _facts(state, proposal)
    if spec.any_training:
        _check_training(state, name_of(strategy), proposal, facts)
    enough = _enough(spec, proposal)
    if enough is not None and len(known) >= LEAST_ROWS:
        return enough
    left = state.cost_left
    if spec.costs is not None and state.usual_cost(state.planned(facts)) > left:
        return (
            f"of the cost budget of {spec.cost_budget:g} {max(left, 0.0):g} are left, and what is "
            "wanted next costs more"
        )
    return facts if spec.steps is None else _within(state, facts)


def _facts(state: StudyState, proposal: Proposal) -> dict[str, Any]:
    """As they are logged."""
    sources = proposal.contexts
    facts: dict[str, Any] = {
        "pick": len(state.picks),
        "sources": list(sources),
        "start": None if proposal.start is None else state.rows[proposal.start].event,
        "length": None if proposal.length is None else float(proposal.length),
        "reason": proposal.reason,
        "acquisition": proposal.acquisition,
        "notes": list(proposal.notes),
    }
    targets = usual_targets(state, sources) if proposal.targets is None else proposal.targets
    if targets is not None:
        facts["targets"] = sorted(int(target) for target in targets)
    return facts


def usual_targets(state: StudyState, sources: Sequence[int]) -> tuple[int, ...] | None:
    """Contexts that a policy trained on `sources` is evaluated on, if nobody says; None: all."""
    if state.spec.eval_targets is None:
        return None
    middle = middle_of(sources, state.spec.space.steps)
    return spread_targets(state.problem(), middle, state.spec.eval_targets)


def settled(
    now: StudyState, moment: StudyState, found: dict[str, Any] | str, holder: Mapping[str, Any]
) -> Event | None:
    """The event that records what was proposed; None: somebody else does it, or it is outdated.

    Args:
        now: the newest state.
        moment: for which it was found, see `propose`.
        found: the facts of the next pick, or why there is none.
        holder: who found it, and is to have the pick.
    """
    if not now.is_proposed_with(holder["token"]):
        return None
    news = (len(moment.rows), len(moment.failures)) != (len(now.rows), len(now.failures))
    if isinstance(found, str):  # with news, the prediction did not know of them
        return None if news else Event("stopped", {"reason": found})
    if news and not is_open(now, found):
        return None
    return Event("asked", {**found, **holder})


def _within(state: StudyState, facts: dict[str, Any]) -> dict[str, Any] | str:
    """The facts of a pick, on as few targets as there are steps for; or that these are too few."""
    pick, left = state.planned(facts), _steps_left(state)
    n, training = state.spec.space.n, state.expected_steps(replace(pick, targets=()))
    count = n if pick.targets is None else len(pick.targets)
    each = state.target_steps
    affordable = count if each == 0.0 else int((left - training) // each)
    if left >= training and affordable >= count:
        return facts
    if left < training or affordable < min(LEAST_TARGETS, n):
        return (
            f"of the budget of {state.spec.steps:,} steps {max(left, 0.0):,.0f} are left, and what "
            "is wanted next costs more"
        )
    targets = spread_targets(state.problem(), pick.source, affordable)
    if pick.targets is not None:
        targets = tuple(sorted(pick.targets)[:affordable])
    return {**facts, "targets": sorted(targets)}


def _check_training(
    state: StudyState, name: str, proposal: Proposal, facts: Mapping[str, Any]
) -> None:
    """Whether the trainer can do what is asked, and it is new and can be paid."""
    spec, seen, start, length = state.spec, state.history(), proposal.start, proposal.length
    pick = state.planned(facts)
    asked: dict[Ability, bool] = {
        "sets": len(proposal.contexts) > 1 and length != 0.0,
        "start": start is not None and length != 0.0,
        "length": length not in (None, 0.0),
    }
    for ability, wanted in asked.items():
        if wanted and ability not in state.abilities:
            raise InvalidInput(
                f"the trainer of this study cannot {DEEDS[ability]}, which {name!r} asks for; give "
                "another trainer, or a strategy that goes by `problem.abilities`"
            )
    if length == 0.0 and start is not None:
        on = list(range(seen.n_targets) if pick.targets is None else pick.targets)
        if np.isfinite(seen.rows[start][on]).all() or not is_open(state, facts):
            raise InvalidInput(
                "a policy is evaluated once on a target, got targets where row "
                f"{start} is known, under way or failed from {name!r}; its entries that are NaN "
                "are open"
            )
    elif not is_open(state, facts):
        raise InvalidInput(
            f"a training is asked for once, got one that is done, under way or failed from "
            f"{name!r}: {proposal}; `history.asked` has them"
        )
    if spec.steps is None and state.paid + pick.price > spec.budget + LEAST_UNIT:
        raise InvalidInput(
            f"a training costs no more than is left of the budget of {spec.budget}, got "
            f"{pick.price:g} units where {state.paid:g} are spent, from {name!r}"
        )


def _enough(spec: StudySpec, proposal: Proposal) -> str | None:
    """Why one more training is not worth it; None where it is, or where nobody asked."""
    least, chance = spec.stop_left, proposal.chance_left
    if least is not None and chance is not None and 1.0 - chance >= spec.stop_confidence:
        return (
            f"all trainings that are left together gain less than {least:g} in V with probability "
            f"{1.0 - chance:.3f}, the selector predicts"
        )
    return None
