"""What every strategy owes: subclass `StrategyContract` and give a `strategy` fixture."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest

from mbtl.arrays import Array
from mbtl.contexts import Context, ContextSpace, Linear
from mbtl.errors import TrainingFailed
from mbtl.history import History, Training
from mbtl.selectors import Exhausted, Selector
from mbtl.study import Evaluation, Failures, Study, create_study


class StrategyContract:
    """Tests that hold for any strategy; studies of a small world refuse what breaks the contract.

    Example:
        >>> class TestMine(StrategyContract):
        ...     @pytest.fixture
        ...     def strategy(self):
        ...         return MyStrategy()
    """

    n, budget = 12, 5

    def test_spends_its_units_in_trainings_that_can_be(self, strategy: Selector) -> None:
        """Each is new, from a policy that there is, and costs no more than is left."""
        study = self._run(strategy)
        assert 0.0 < study.state.paid <= self.budget + 1e-6

    def test_same_history_same_trainings(self, strategy: Selector) -> None:
        """No state between calls: a study that is taken up again goes on like another one."""
        one, other = (_made(self._run(strategy)) for _ in range(2))
        assert one == other

    def test_asks_for_what_the_trainer_can_do(self, strategy: Selector) -> None:
        """Specialists, or nothing, of a trainer of one context; no start where it takes none."""
        alone = self._run(strategy, lambda context, seed: _train([context], seed))
        assert all(one.is_specialist for one in _made(alone))
        fresh = self._run(strategy, lambda contexts, seed: _train(contexts, seed))
        assert all(one.start is None for one in _made(fresh))

    def test_lives_with_failures(self, strategy: Selector) -> None:
        """Of every second training there is no policy; the same is not asked for again."""
        calls = []

        def train(
            contexts: Sequence[Context], seed: int, *, start: Any = None, length: Any = None
        ) -> Any:
            calls.append(seed)
            if len(calls) % 2 == 0:
                raise TrainingFailed("it diverged")
            return _train(contexts, seed, start=start, length=length)

        study = self._run(strategy, train)
        assert len(calls) > 1
        assert study.state.failures

    def test_lives_with_a_few_targets_and_terrible_returns(self, strategy: Selector) -> None:
        """Rows with gaps, and a performance of -1e6, give further trainings, and no crash."""
        for factor in (1.0, -1e6):
            study = self._run(strategy, factor=factor, evaluation=Evaluation(3))
            assert len(study.trainings) > 0

    def test_does_not_change_what_it_is_given(self, strategy: Selector) -> None:
        """Problem and history belong to the study."""
        study = self._run(strategy)
        problem, history = study.problem, History(self.n).with_row(3, np.linspace(0.0, 1.0, self.n))
        given = (problem.steps, problem.weights, history.rows)
        before = [array.copy() for array in given]
        try:
            strategy.propose(problem, history, np.random.default_rng(0))
        except Exhausted as error:
            pytest.skip(f"it asks for nothing here: {error}")
        assert all(np.array_equal(a, b) for a, b in zip(before, given, strict=True))

    def _run(
        self,
        strategy: Selector,
        train: Callable[..., Any] | None = None,
        factor: float = 1.0,
        **how: Any,
    ) -> Study:
        def evaluate(policy: dict[str, Array], contexts: Sequence[Context]) -> Array:
            x = [float(context["x"]) for context in contexts]
            return np.asarray(factor * np.interp(x, policy["x"], policy["row"]))

        space = ContextSpace.grid({Linear("x", 0.0, 1.0): self.n})
        study = create_study(space, budget=self.budget, strategy=strategy, **how)
        failures = Failures(most_in_a_row=self.budget, rehearse=False)
        study.run(train or _train, evaluate, failures=failures, progress=False)
        return study


def _made(study: Study) -> list[Training]:
    history = study.state.history()
    return [history.made(row) for row in range(len(history))]


def _train(
    contexts: Sequence[Context], seed: int, *, start: Any = None, length: float | None = None
) -> dict[str, Array]:
    """A policy is its row on a fine grid: better where it was trained, by less each time."""
    x = np.linspace(0.0, 1.0, 45)
    near = np.min([np.abs(x - float(context["x"])) for context in contexts], axis=0)
    row = np.zeros_like(x) if start is None else start["row"]
    gain = (1.0 if length is None else length) / (1.0 + 0.2 * len(contexts))
    return {"x": x, "row": row + (1.0 - row) * (1.0 - np.exp(-gain)) * np.exp(-3.0 * near)}
