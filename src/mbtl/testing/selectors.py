"""What every selector owes: subclass `SelectorContract` and give a `selector` fixture."""

from __future__ import annotations

import numpy as np
import pytest

from mbtl.contexts import ContextSpace, Linear
from mbtl.history import History
from mbtl.selectors import Exhausted, SelectionProblem, Selector


class SelectorContract:
    """Tests that hold for any selector on one numeric axis.

    Example:
        >>> class TestMine(SelectorContract):
        ...     @pytest.fixture
        ...     def selector(self):
        ...         return MySelector()
    """

    n = 12

    def _problem(self) -> SelectionProblem:
        return SelectionProblem.of(
            ContextSpace.grid({Linear("x", 0.0, 1.0): self.n}), budget=self.n
        )

    def _row(self, source: int) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
        far = np.abs(source - np.arange(self.n))
        return np.asarray(0.8 - 0.03 * far - 0.1 * np.sin(far + source))

    def test_has_a_name(self, selector: Selector) -> None:
        """The name is how people find it."""
        assert isinstance(selector, Selector)
        assert selector.name

    def test_trains_every_context_once_then_says_exhausted(self, selector: Selector) -> None:
        """K = N gives a permutation."""
        problem, history = self._problem(), History(self.n)
        for k in range(self.n):
            source = selector.propose(problem, history, np.random.default_rng(k)).source
            history = history.with_row(source, self._row(source))
        assert sorted(history.sources) == list(range(self.n))
        with pytest.raises(Exhausted):
            selector.propose(problem, history, np.random.default_rng(0))

    def test_never_proposes_pending_or_failed(self, selector: Selector) -> None:
        """Parallel workers get different picks, and a failure is not tried again."""
        problem, history = self._problem(), History(self.n)
        seen = []
        for k in range(self.n):
            source = selector.propose(problem, history, np.random.default_rng(k)).source
            seen.append(source)
            history = history.with_failure(source) if k % 2 else history.with_pending(source)
        assert sorted(seen) == list(range(self.n))

    def test_same_history_same_proposal(self, selector: Selector) -> None:
        """No state between calls: a resumed study goes on like an undisturbed one."""
        problem, history = self._problem(), History(self.n)
        for k in range(6):
            first = selector.propose(problem, history, np.random.default_rng(k))
            again = selector.propose(problem, history, np.random.default_rng(k))
            assert first == again
            history = history.with_row(first.source, self._row(first.source))

    def test_does_not_change_what_it_is_given(self, selector: Selector) -> None:
        """Problem and history belong to the study."""
        problem, history = self._problem(), History(self.n).with_row(3, self._row(3))
        before = (problem.steps.copy(), problem.weights.copy(), history.rows.copy())
        selector.propose(problem, history, np.random.default_rng(0))
        after = (problem.steps, problem.weights, history.rows)
        assert all(np.array_equal(a, b) for a, b in zip(before, after, strict=True))

    def test_survives_constant_and_terrible_rows(self, selector: Selector) -> None:
        """Flat or hugely negative performance gives a proposal, not a crash."""
        for row in (np.zeros(self.n), np.full(self.n, -1e6), np.full(self.n, 0.7)):
            problem, history = self._problem(), History(self.n)
            for k in range(7):
                source = selector.propose(problem, history, np.random.default_rng(k)).source
                history = history.with_row(source, row)
            assert len(set(history.sources)) == 7
