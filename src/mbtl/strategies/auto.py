"""Auto: all contexts first, then each unit where it is expected to add most to V.

Two kinds of trainings compete at every pick, by the gain in V per unit that each is expected to
bring:

    all contexts, longer    what the last two doublings gained in the mean
    x alone, from scratch   what a chooser of contexts expects of specialists so far, and what the
                            last ones brought

The chooser knows what the other policies are worth (`History.others`). Before the first specialist
a share of the headroom stands for what it brings. What the trainer cannot do is left out, and so is
what was tried and gave nothing. (Copies of the policy for all, tuned on one context, were a third
kind: on no set of problems did they pay, docs/decisions.md.)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import ClassVar, NamedTuple

import numpy as np

from mbtl.arrays import Array
from mbtl.history import History, Training
from mbtl.objective import generalisation_performance, worst_share_mean
from mbtl.selectors import Specialists
from mbtl.selectors.base import Exhausted, Proposal, SelectionProblem, believed_rows
from mbtl.selectors.contract import Selector, Traits, without_family
from mbtl.strategies.all_first import on_all

_LEAST = 1e-3
"""Units that are worth training for."""
_LAST = 3
"""Trainings of a kind that say how much its next one adds at most."""
_LITTLE = 0.05
"""Headroom that there always is: performance may exceed 1."""
_ONE_AT_A_TIME = (
    "this trainer takes one context at a time, so no policy for several is tried; "
    "train(contexts, seed, *, start=None, length=None) can do all"
)
_UNKNOWN = (
    "no trainer is known so far, so each pick is one context from scratch; study.equip(trainer) "
    "says what else can be trained"
)
_FROM_SCRATCH = (
    "this trainer takes no start, so no policy is tuned or trained longer; "
    "train(contexts, seed, *, start=None, length=None) can do both"
)


class Option(NamedTuple):
    """A training that could be next: expected gain in V, and price in units of mean cost."""

    proposal: Proposal
    gain: float
    price: float


@dataclass(frozen=True)
class Auto:
    """The better of two kinds of trainings, beginning with all contexts.

    Attributes:
        chooser: of contexts, for specialists.
        first: units after which the policy for all is looked at for the first time.
        double_share: gain that is usual of a doubling, as a share of the headroom.
        fresh_share: gain of the first specialist, as a share of the headroom.
        doubt: trainings that what is usual counts as much as.
        name: what results call it.
    """

    chooser: Selector = field(default_factory=Specialists)
    first: float = 0.5
    double_share: float = 0.2
    fresh_share: float = 0.1
    doubt: float = 0.5
    name: str = "auto"
    traits: ClassVar[Traits] = Traits(deterministic=True, any_training=True)

    def without(self, family: str) -> Auto:
        """The same, had it never seen a family of problems; for honest benchmarks."""
        return replace(self, chooser=without_family(self.chooser, family))

    def propose(
        self, problem: SelectionProblem, history: History, rng: np.random.Generator
    ) -> Proposal:
        """All contexts, if that was not tried; else what is expected to pay most.

        Raises:
            Exhausted: nothing can be trained, or the policy for all is still in training.
        """
        if problem.assumed:  # whoever trains by hand reads one context off a pick
            problem = replace(problem, abilities=frozenset())
        standing = Standing(problem, history)
        if (first := on_all(problem, history, again=True)) is not None:
            # a look on the way says how fast it learns
            early = standing.can_go_on and standing.left > 1.0 and not first.notes
            length = min(self.first, 1.0) if early else first.length
            return replace(first, length=length, notes=(*first.notes, *standing.missing))
        if standing.begins and any(standing.is_for_all(one) for one in history.under_way):
            raise Exhausted("what is best next depends on the policy for all, in training now")
        if standing.everybody is None:
            if problem.costs is None and standing.left < 1.0 - _LEAST:  # else some may be cheap
                raise Exhausted("of the budget there is less left than a whole training")
            chosen = self.chooser.propose(problem.alone, history.specialists(), rng)
            return replace(chosen, notes=(*chosen.notes, *standing.missing))
        options = self._options(standing, rng)
        if not options:
            raise Exhausted("of the budget there is nothing left that a training could be had for")
        best = max(options, key=lambda one: one.gain / one.price).proposal
        return replace(best, chance_left=_likeliest([one.proposal.chance_left for one in options]))

    def _options(self, standing: Standing, rng: np.random.Generator) -> list[Option]:
        """The best of each kind; the chooser, which takes time, is asked where it could win."""
        options = [] if (longer := self._longer(standing)) is None else [longer]
        problem, known = standing.problem, standing.history.specialists()
        usual, brought, most = self._expected(standing, known)
        rate = max((one.gain / one.price for one in options), default=-np.inf)
        if standing.left < 1.0 - _LEAST or (most < rate and problem.least_left is None):
            return options
        try:
            chosen = self.chooser.propose(problem.alone, known, rng)
        except Exhausted:
            return options
        done, gain = len(known), usual
        if chosen.acquisition is not None:
            expected = (chosen.acquisition + brought) / 2.0
            gain = (self.doubt * gain + done * expected) / (self.doubt + done)
        gain = min(gain, most) * (done + 1.0) / (done + len(known.failed) + 1.0)
        alone = replace(chosen, reason=f"from scratch: {chosen.reason}", acquisition=gain)
        return [*options, Option(alone, gain, standing.cost(chosen.source))]

    def _longer(self, standing: Standing) -> Option | None:
        """Twice as long, or as far as the budget goes."""
        row, history, problem = standing.everybody, standing.history, standing.problem
        assert row is not None
        made = history.made(row)
        more = min(made.length, standing.left)
        if standing.begins:
            more = min(1.0 - made.length, more)
        if any(one.start == row and one.goes_on for one in history.under_way):
            return None
        vain = [one.length for one in history.given_up if one.start == row and one.goes_on]
        if vain:  # a crash may be a passing one; no training is asked for twice
            more = min(more, min(vain) - made.length) / 2.0
        if not standing.can_go_on or more < _LEAST or len(vain) > 1:
            return None
        reason, length = "all contexts, longer", made.length + more
        gain, scatter, in_all = 1.0, np.inf, np.inf
        if not standing.begins:
            rise, seen = self.double_share * standing.headroom, len(standing.doublings)
            if seen:
                last, error, said = standing.doublings[-1]
                reason += f": the last {said}"
                # one alone says little: a large gain may follow a small one
                recent = float(np.mean([gain for gain, *_ in standing.doublings[-2:]]))
                # a policy that stayed as it was, the best of its evaluations, is no luck
                doubt = 0.0 if standing.stayed else self.doubt
                rise = (doubt * rise + seen * recent) / (doubt + seen)
                scatter = max(abs(recent) / 2.0, abs(recent - last), error)
            gain = standing.gained(standing.rows[row] + rise * np.log2(length / made.length))
            gain /= 1.0 + len(vain)
            in_all = rise * np.log2((made.length + standing.left) / made.length)
        promised = None if standing.begins else gain
        notes = ("going on with the policy for all gave nothing: half as much once more",)
        proposal = Proposal(
            history.sources[row], reason, promised, start=row, length=length, sources=made.contexts,
            chance_left=_chance(problem.least_left, in_all, scatter), notes=notes * len(vain),
        )  # fmt: skip
        return Option(proposal, gain, more)

    def _expected(self, standing: Standing, known: History) -> tuple[float, float, float]:
        """Gain that is usual of the next specialist, that of the last ones, and the most.

        The most is what the last ones added to V, for the best comes first. While the first one is
        under way, which will show what specialists are worth, another one is worth less.
        """
        assert standing.everybody is not None
        made = standing.history.made
        longest = max(made(standing.everybody).length, 1.0)  # less is left, the longer that was
        usual = self.fresh_share * (standing.headroom / longest)
        if not len(known):
            usual /= 1.0 + len(known.pending)
        rows = [row for row in range(len(standing.history)) if made(row).is_specialist]
        last = standing.added[rows][-_LAST:]
        most = (self.doubt * usual + last.sum()) / (self.doubt + len(last))
        return usual, float(last.mean()) if len(last) else 0.0, float(most)


@dataclass(frozen=True)
class Standing:
    """How things stand at a pick."""

    problem: SelectionProblem
    history: History

    @cached_property
    def abilities(self) -> frozenset[str]:
        """Of the trainer."""
        return self.problem.abilities or frozenset()

    @property
    def can_go_on(self) -> bool:
        """Whether a training can be made longer."""
        return {"start", "length"} <= self.abilities

    @property
    def missing(self) -> tuple[str, ...]:
        """What this trainer cannot try, in a sentence, beside the first pick."""
        if self.history.asked or len(self.problem.sources) < 2:
            return ()
        if "sets" not in self.abilities:
            return (_UNKNOWN if self.problem.assumed else _ONE_AT_A_TIME,)
        return () if "start" in self.abilities else (_FROM_SCRATCH,)

    @property
    def left(self) -> float:
        """Units of mean cost."""
        return self.problem.budget - self.history.paid

    def is_for_all(self, training: Training) -> bool:
        """On all that one may train on."""
        return training.contexts == tuple(self.problem.sources.tolist())

    @cached_property
    def for_all(self) -> list[int]:
        """Rows of policies for all contexts, the shortest training first."""
        made = self.history.made
        found = [row for row in range(len(self.history)) if self.is_for_all(made(row))]
        return sorted(found, key=lambda row: (made(row).length, row))

    @property
    def everybody(self) -> int | None:
        """Row of the policy for all that was trained longest."""
        return self.for_all[-1] if self.for_all else None

    @property
    def begins(self) -> bool:
        """Whether the policy for all has had less than a unit."""
        return self.everybody is None or self.history.made(self.everybody).length < 1.0

    @cached_property
    def rows(self) -> Array:
        """(k, N) performance, what was not evaluated as the transfer model believes it."""
        return believed_rows(self.problem, self.history)

    @cached_property
    def best(self) -> Array:
        """(N,) of all policies."""
        return generalisation_performance(self.rows)

    def value(self, best: Array) -> float:
        """V."""
        return float(worst_share_mean(best, self.problem.weights, self.problem.risk))

    def gained(self, row: Array) -> float:
        """V that a policy with this row would add."""
        return self.value(np.maximum(row, self.best)) - self.value(self.best)

    @cached_property
    def headroom(self) -> float:
        """How far V is from performance 1, and no less than a little."""
        return max(1.0 - self.value(self.best), _LITTLE)

    @cached_property
    def doublings(self) -> list[tuple[float, float, str]]:
        """Gains in mean performance when the policy for all was trained twice as long; errors.

        And what was added, in words: not each step is a whole doubling.
        """
        weights, errors, found = self.problem.weights, self.history.errors, []
        for before, now in pairwise(self.for_all):
            since, until = (self.history.made(row).length for row in (before, now))
            if until > since:
                gain = (self.rows[now] - self.rows[before]) @ weights
                noise = 0.0 if errors is None else np.linalg.norm(errors[[before, now]] * weights)
                twice = float(np.log2(until / since))
                units = f"{until - since:g} unit" + "s" * (until - since != 1.0)
                said = f"{'doubling' if twice == 1.0 else units} added {gain:.3f}"
                found.append((float(gain) / twice, float(noise) / twice, said))
        return found

    @property
    def stayed(self) -> bool:
        """Whether the policy for all returned the same everywhere when it was trained longer."""
        last = self.rows[self.for_all[-2:]]
        return len(last) == 2 and bool((last[0] == last[1]).all())

    @cached_property
    def added(self) -> Array:
        """(k,) V that each training added when it was told."""
        best = np.maximum.accumulate(self.rows, axis=0)
        values = worst_share_mean(best, self.problem.weights, self.problem.risk)
        return np.diff(values, prepend=values[0] if len(values) else 0.0)

    def cost(self, source: int) -> float:
        """Of a unit on a context, relative to the mean."""
        costs = self.problem.costs
        return 1.0 if costs is None else float(costs[source] / costs.mean())


def _chance(least: float | None, gain: float, scatter: float) -> float | None:
    """That a gain is `least` or more, where somebody asks."""
    if least is None:
        return None
    from scipy.special import ndtr  # kept out of `import mbtl`

    return float(ndtr((gain - least) / max(scatter, 1e-12))) if np.isfinite(gain) else 1.0


def _likeliest(chances: Sequence[float | None]) -> float | None:
    """The largest chance; None: of some training nothing is known, so it may be worth it."""
    known = [chance for chance in chances if chance is not None]
    return max(known) if known and len(known) == len(chances) else None
