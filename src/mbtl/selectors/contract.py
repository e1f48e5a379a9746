"""The selector contract: a problem (frozen data) and a history in, the next source out.

A selector never sees a study, a storage or a matrix. It keeps no state between calls: what it needs
is in the history, so a resumed study proposes what an undisturbed one would have. One method is
enough (`Proposes`). What else a selector may have: `traits`, `without` (`LearnedSelector`), and
`outlook(problem, history, candidates)`, which gives the `Outlook` of its model, for people.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np

from mbtl.errors import InvalidInput
from mbtl.history import History
from mbtl.plain import is_finite, short
from mbtl.selectors.base import Proposal, SelectionProblem


@dataclass(frozen=True)
class Traits:
    """What a selector is and can, beside proposing.

    Attributes:
        deterministic: it ignores its generator, so one run of it says all.
        one_axis: it needs contexts on one numeric axis (`SelectionProblem.line`).
        any_training: it is no selector but a strategy over trainings of every kind: it sees all
            rows, and its proposals name contexts, start and length.
    """

    deterministic: bool = False
    one_axis: bool = False
    any_training: bool = False


@runtime_checkable
class Proposes(Protocol):
    """All that a selector must have; `adopted` gives it the rest."""

    def propose(
        self, problem: SelectionProblem, history: History, rng: np.random.Generator
    ) -> Proposal:
        """Choose one source that is neither trained, pending nor failed.

        Raises:
            Exhausted: every context is taken.
        """
        ...


@runtime_checkable
class Selector(Proposes, Protocol):
    """Proposes the next source to train on."""

    @property
    def name(self) -> str:
        """The registered name, e.g. "mbtl-ei"."""
        ...


@runtime_checkable
class LearnedSelector(Selector, Protocol):
    """A selector that has learned from matrices, and can forget some of them."""

    def without(self, family: str) -> Selector:
        """The same, had it never seen a family of matrices; for honest benchmarks."""
        ...


def without_family(selector: Selector, family: str) -> Selector:
    """A selector or strategy had it never seen a family; one that has learned nothing, as it is."""
    return selector.without(family) if isinstance(selector, LearnedSelector) else selector


def traits_of(selector: Proposes) -> Traits:
    """What a selector says of itself; one that says nothing can only propose.

    Raises:
        InvalidInput: it says something else.
    """
    said = getattr(selector, "traits", Traits())
    if not isinstance(said, Traits):
        raise InvalidInput(
            f"traits of a selector are mbtl.selectors.Traits(...), got {short(said)} from "
            f"{name_of(selector)!r}"
        )
    return said


@dataclass(frozen=True)
class Unnamed:
    """A selector without a name, which goes by that of its class."""

    selector: Proposes

    @property
    def name(self) -> str:
        """Of the class."""
        return type(self.selector).__name__

    @property
    def traits(self) -> Traits:
        """What the selector says of itself."""
        return traits_of(self.selector)

    def propose(
        self, problem: SelectionProblem, history: History, rng: np.random.Generator
    ) -> Proposal:
        """As the selector does."""
        return self.selector.propose(problem, history, rng)


def adopted(given: Any) -> Selector:
    """A user's own object as a selector.

    Raises:
        InvalidInput: it has no method `propose`, or is a class that was not called.
    """
    if isinstance(given, type):
        raise InvalidInput(
            f"a selector is an object, got the class {given.__name__}; give {given.__name__}()"
        )
    if isinstance(given, Selector):
        if not isinstance(given.name, str):
            raise InvalidInput(f"a selector's name is a text, got {given.name!r}")
        return given
    if isinstance(given, Proposes):
        return Unnamed(given)
    raise InvalidInput(
        "a selector has a method propose(problem, history, rng), got "
        f"{type(given).__name__} {given!r:.60}; `mbtl.selectors.selector_names()` lists ours"
    )


def name_of(selector: Proposes) -> str:
    """Its own, or that of its class."""
    return str(getattr(selector, "name", type(selector).__name__))


def check_longer(done: float, length: float, by: str = "") -> None:
    """Refuse to go on with a training of `done` units for none more.

    Raises:
        InvalidInput: the `length` in all is no larger.
    """
    if length and length <= done:
        raise InvalidInput(
            f"a training goes on beyond the {done:g} units that it has, got length={length:g}{by}; "
            "it is the length in all"
        )


def _check_said(name: str, proposal: Proposal) -> None:
    """Refuse words and numbers beside a training that could not be kept."""
    notes = proposal.notes if isinstance(proposal.notes, (tuple, list)) else (None,)
    if not all(isinstance(words, str) for words in (proposal.reason, *notes)):
        raise InvalidInput(
            "a proposal has a text as its reason and texts as its notes, got "
            f"reason={short(proposal.reason)} and notes={short(proposal.notes)} from {name!r}"
        )
    for what in ("acquisition", "chance_left"):
        number = getattr(proposal, what)
        if number is not None and not is_finite(number, sys.float_info.max):
            raise InvalidInput(
                f"{what} of a proposal is a number, or None where there is none, got "
                f"{short(number)} from {name!r}"
            )


def check_proposal(
    selector: Proposes, proposal: Any, history: History, *, any_training: bool
) -> None:
    """What a user's own selector or strategy gives, which may be anything.

    Raises:
        InvalidInput: it breaks its contract.
    """
    name, n = name_of(selector), history.n_targets
    if not isinstance(proposal, Proposal):
        raise InvalidInput(
            "a strategy proposes a mbtl.selectors.Proposal(source, reason), got "
            f"{type(proposal).__name__} {proposal!r:.60} from {name!r}"
        )
    source, start, length = proposal.source, proposal.start, proposal.length
    some = proposal.given
    _check_said(name, proposal)
    proper = all(
        isinstance(one, (int, np.integer)) and not isinstance(one, bool) and 0 <= one < n
        for one in (*some, source)
    )
    if not (proper and len(some) == len(set(some)) and source in some):
        got = short(source)
        if some != (source,):
            got = f"source={got} and sources={short(some)}"
        raise InvalidInput(
            f"a strategy proposes a context index from 0 to {n - 1}, or different ones of several "
            f"with `source` among them, got {got} from {name!r}"
        )
    if not any_training:
        if len(some) > 1 or start is not None or length is not None:
            raise InvalidInput(
                f"a selector proposes one context, from scratch, got {proposal} from {name!r}; a "
                "strategy over other trainings says so by traits = Traits(any_training=True)"
            )
        if not history.open_mask(n)[source]:
            raise InvalidInput(
                "a selector proposes contexts that are neither trained, under way nor failed, got "
                f"{source} again from {name!r} at pick {len(history.asked) + 1}; "
                "`history.open_mask` says which are open"
            )
    rows = len(history)
    if start is not None and not (isinstance(start, (int, np.integer)) and 0 <= start < rows):
        there = f"0 to {rows - 1}" if rows else "of which there are none so far"
        raise InvalidInput(
            f"a training begins with the policy of a row, {there}, got start={start!r} from "
            f"{name!r}; None is from scratch"
        )
    if length is not None and not (is_finite(length) and length >= 0.0):
        raise InvalidInput(
            f"a training has a length >= 0 in units, got {short(length)} from {name!r}"
        )
    made = None if start is None else history.made(start)
    if made and length is not None and made.contexts == proposal.contexts:
        check_longer(made.length, length, f" from {name!r}")
