"""What a study answers when it is asked: hand out again, propose, or end."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np

from mbtl.errors import InvalidInput
from mbtl.history import History
from mbtl.seeds import selection_rng
from mbtl.selectors.base import Exhausted, Proposal, open_candidates
from mbtl.selectors.contract import Selector
from mbtl.selectors.targets import spread_targets
from mbtl.study.events import Event
from mbtl.study.leases import PROPOSING, Watch, asker, new_token
from mbtl.study.pick import StudyFinished
from mbtl.study.spec import StudySpec
from mbtl.study.state import StudyState
from mbtl.threads import threads_for

_LONGEST = 5.0
"""Seconds after which no more is proposed ahead: others wait for what is."""
LEAST_ROWS = 3
"""Rows before a prediction may end the study: one or two say too little of how rows differ."""


def claim(
    state: StudyState,
    watch: Watch,
    seconds: float | None,
    worker: str,
    *,
    proposed: bool = True,
) -> Event | None:
    """The event that gives a worker a pick: one that nobody works on, or the next one.

    Where nothing more is trained it is the release of a pick whose worker is silent.

    The source of the next one may have been proposed ahead. Else it is proposed after that
    (`propose`), so that nobody else looks for it meanwhile. None: somebody else does; ask again in
    a moment.

    Args:
        state: of the study.
        watch: knows whose lease is stale.
        seconds: that the lease is to last; None: for ever.
        worker: who asks.
        proposed: take what was proposed ahead.

    Raises:
        StudyFinished: nothing can be asked.
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
        waiting = f"; {held} picks are still under way" if held else ""
        raise StudyFinished(f"the study is finished: {reason}{waiting}")
    if proposed and state.ahead and _is_affordable(state, state.ahead[0]["source"]):
        facts = {"pick": len(state.picks), **state.ahead[0]}
        return Event("asked", {**facts, "seconds": seconds, **holder})
    if state.proposing is not None and not watch.is_stale(state.proposing):
        return None
    return Event("claimed", {"pick": len(state.picks), "seconds": PROPOSING, **holder})


def stop_reason(state: StudyState) -> str | None:
    """Why nothing more can be asked; None while something can."""
    assert state.spec is not None
    reason = _early_stop(state) or state.stopped
    if reason is not None:
        return reason
    if len(state.picks) >= state.spec.budget:
        return f"the budget of {state.spec.budget} trainings is spent"
    try:
        open_candidates(state.spec.selection_problem(), state.history(), repeats=state.spec.repeats)
    except Exhausted as error:
        return str(error)
    return None


def is_finished(state: StudyState) -> bool:
    """True when nothing can be asked and nobody works on a pick."""
    held = len(state.open_picks) - len(given_back(state))
    open_picks = held if _early_stop(state) else len(state.open_picks)
    return stop_reason(state) is not None and not open_picks


def given_back(state: StudyState) -> list[int]:
    """Numbers of open picks that were given back."""
    return sorted(n for n, pick in state.open_picks.items() if pick.worker is None)


def is_open(state: StudyState, source: int) -> bool:
    """True where one more training on this source is allowed."""
    assert state.spec is not None
    return bool(state.history().open_mask(state.spec.space.n, state.spec.repeats)[source])


def _is_affordable(state: StudyState, source: int) -> bool:
    """True where a source may be proposed at this moment."""
    assert state.spec is not None
    problem, repeats = state.spec.selection_problem(), state.spec.repeats
    return bool(open_candidates(problem, state.history(), repeats=repeats)[source])


def ahead(state: StudyState, watch: Watch, worker: str) -> int:
    """How many picks to propose beside the next one: one for each other worker that waits for it.

    They know then what they would have known at best. Where a prediction may end the study there
    is none, since that looks at the newest rows.
    """
    spec = state.spec
    assert spec is not None
    if spec.stop_gain is not None or spec.stop_left is not None:
        return 0
    busy = [pick.worker for pick in state.open_picks.values() if pick.worker is not None]
    waiting = watch.askers() - {asker(one) for one in (worker, *busy)}
    return min(len(waiting), spec.budget - len(state.picks) - 1)


def left_alone(state: StudyState, watch: Watch) -> list[int]:
    """Numbers of open picks that nobody works on: given back, or their lease is stale."""
    return [n for n, pick in sorted(state.open_picks.items()) if watch.is_stale(pick.lease)]


def others(state: StudyState, watch: Watch, worker: str, *, for_ever: bool = True) -> list[str]:
    """Names of other workers that hold picks; on request only those who would be missed in time."""
    leases = [pick.lease for pick in state.open_picks.values()]
    held = {
        lease.worker
        for lease in leases
        if lease is not None
        and not watch.is_stale(lease)
        and (for_ever or lease.seconds is not None)
    }
    return sorted(held - {worker})


def _early_stop(state: StudyState) -> str | None:
    """The level or the cost budget that was reached; picks given back are not trained then."""
    spec = state.spec
    assert spec is not None
    if spec.stop_value is not None and state.rows:
        now = state.routing().value
        least = now.at_least(spec.stop_confidence)
        if least >= spec.stop_value:
            sure = f" ({least:.4f} or more, surely)" if now.error else ""
            return f"V = {now.value:.4f}{sure} reaches the level {spec.stop_value:g}"
    if (reached := _nothing_left(state, spec)) is not None:
        return reached
    if spec.cost_budget is not None and state.cost >= spec.cost_budget:
        return f"the cost {state.cost:g} reaches the budget of {spec.cost_budget:g}"
    most = np.inf if spec.cost_budget is None else spec.cost_budget * (1.0 + 1e-9)
    if spec.costs is not None and given_back(state) and state.committed > most:
        return f"the picks given back cost more than is left of {spec.cost_budget:g}"
    return None


def _nothing_left(state: StudyState, spec: StudySpec) -> str | None:
    """That V is as large as it can be, where the study knows how large that is."""
    if spec.stop_left is None or spec.best_return is None or not state.rows:
        return None
    now = state.routing().value
    most = float(state.bounds().normalise(spec.best_return))
    if most - now.at_least(spec.stop_confidence) >= spec.stop_left:
        return None
    return f"V = {now.value:.4f} is within {spec.stop_left:g} of the largest there can be, {most:g}"


def propose(
    spec: StudySpec, number: int, history: History, selector: Selector, more: int = 0
) -> dict[str, Any] | str:
    """The facts of the next pick, or why one more training is not worth it.

    Args:
        spec: of the study.
        number: of the pick.
        history: what is known so far.
        selector: proposes.
        more: picks to propose ahead, each as if those before it were under way.

    Raises:
        StudyFinished: nothing is left to propose.
        InvalidInput: the selector breaks its contract.
    """
    try:
        data = _proposed(spec, history, selector, number)
    except Exhausted as error:
        raise StudyFinished(f"the study is finished: {error}") from error
    if isinstance(data, str):
        return data
    facts, following, began = data, [], time.monotonic()
    for later in range(number + 1, number + 1 + more):
        if time.monotonic() - began > _LONGEST:
            break
        cost = 0.0 if spec.costs is None else spec.costs[facts["source"]]
        history = replace(history.with_pending(facts["source"]), spent=history.spent + cost)
        try:
            found = _proposed(spec, history, selector, later)
        except Exhausted:
            break
        if isinstance(found, str):
            break
        facts = found
        following.append(facts)
    return {"pick": number, **data, **({"ahead": following} if following else {})}


def _proposed(
    spec: StudySpec, history: History, selector: Selector, number: int
) -> dict[str, Any] | str:
    """Facts of one pick, or why it is not worth a training."""
    problem = spec.selection_problem()
    rng = selection_rng(spec.seed, spec.trial, number)
    with threads_for(problem.n):
        proposal = selector.propose(problem, history, rng)
    _check_proposal(spec, history, selector, proposal)
    enough = _enough(spec, proposal)
    if enough is not None and len(history) >= LEAST_ROWS:
        return enough
    source = int(proposal.source)
    data: dict[str, Any] = {
        "source": source,
        "reason": proposal.reason,
        "acquisition": proposal.acquisition,
        "notes": list(proposal.notes),
    }
    if spec.eval_targets is not None:
        data["targets"] = list(spread_targets(problem, source, spec.eval_targets))
    return data


def _check_proposal(spec: StudySpec, history: History, selector: Selector, proposal: Any) -> None:
    """A user's own selector may give anything."""
    if not isinstance(proposal, Proposal):
        raise InvalidInput(
            f"a selector proposes a mbtl.selectors.Proposal(source, reason), got "
            f"{type(proposal).__name__} {proposal!r:.60} from {selector.name!r}"
        )
    source = proposal.source
    if not isinstance(source, (int, np.integer)) or not 0 <= source < history.n_targets:
        raise InvalidInput(
            f"a selector proposes a context index from 0 to {history.n_targets - 1}, got "
            f"{source!r} from {selector.name!r}"
        )
    if not history.open_mask(spec.space.n, spec.repeats)[source]:
        raise InvalidInput(
            f"a selector proposes contexts that are neither trained, under way nor failed, got "
            f"{source} from {selector.name!r}; `history.open_mask` says which are open"
        )


def _enough(spec: StudySpec, proposal: Proposal) -> str | None:
    """Why one more training is not worth it; None where it is, or where nobody asked."""
    asked = (
        (spec.stop_gain, proposal.chance, "one more training gains"),
        (spec.stop_left, proposal.chance_left, "all trainings that are left together gain"),
    )
    for least, chance, who in asked:
        if least is not None and chance is not None and 1.0 - chance >= spec.stop_confidence:
            return (
                f"{who} less than {least:g} in V with probability {1.0 - chance:.3f}, the selector "
                "predicts"
            )
    return None
