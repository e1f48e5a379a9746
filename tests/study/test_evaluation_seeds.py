"""Every context has evaluation episodes of its own, the same for every policy."""

import numpy as np
import pytest
from line_problem import line, train

from flat import created
from mbtl.errors import InvalidInput, TrainingFailed
from mbtl.faults import reason_of
from mbtl.seeds import Purpose, evaluation_seeds
from mbtl.trainers import FunctionTrainer

SPACE = line(64)


@pytest.mark.parametrize(
    ("evaluate", "expected"),
    [
        (lambda policy, contexts: [policy] * 2, [1, 1]),
        (lambda policy, contexts, episodes=2: [[policy] * episodes] * 2, [[1, 1], [1, 1]]),
        (lambda policy, contexts, luck, /: [[policy + s] for s in luck], [[8], [9]]),
        (lambda policy, contexts, *, seeds: [[policy + s] for s in seeds], [[8], [9]]),
        (lambda policy, contexts, episodes=2, *, seed=0: [[policy + seed]], [[8], [9]]),
        (lambda *given: [[given[0] + s] for s in given[2]], [[8], [9]]),
    ],
)
def test_a_function_is_given_only_what_it_takes(evaluate, expected):
    found = FunctionTrainer(train, evaluate).evaluate(1.0, SPACE.contexts[:2], [7, 8])
    assert found.tolist() == expected


def test_contexts_with_other_numbers_of_episodes_are_refused():
    trainer = FunctionTrainer(train, lambda policy, contexts, seed: [[1.0] * seed])
    with pytest.raises(TrainingFailed, match="as many episodes as the others, got 2 to 3"):
        trainer.evaluate(0.5, SPACE.contexts[:2], [2, 3])


def test_a_fault_where_contexts_are_evaluated_one_by_one_says_in_which():
    trainer = FunctionTrainer(train, lambda policy, contexts, seed: [[1.0 / (seed - 8)]])
    with pytest.raises(ZeroDivisionError) as fault:
        trainer.evaluate(0.5, SPACE.contexts[:2], [7, 8])
    assert reason_of(fault.value).endswith(f"zero, in the context {SPACE.context(1)}")


class Heard(FunctionTrainer):
    """Keeps which seed each context was evaluated with."""

    def __init__(self):
        super().__init__(train, lambda policy, contexts, seeds: np.zeros(len(contexts)))
        object.__setattr__(self, "calls", [])

    def evaluate(self, policy, contexts, seeds):
        self.calls.append({SPACE.index(c): s for c, s in zip(contexts, seeds, strict=True)})
        return super().evaluate(policy, contexts, seeds)


@pytest.mark.parametrize("eval_targets", [None, 10])
def test_a_study_evaluates_each_target_with_the_seed_that_it_hands_out(eval_targets):
    trainer = Heard()
    study = created(SPACE, budget=2, seed=3, strategy="random", eval_targets=eval_targets)
    study.run(trainer=trainer, progress=False)
    seeds = study.evaluation_seeds()
    fresh = study.evaluation_seeds(purpose=Purpose.REPORT)
    assert len(set(seeds + fresh)) == 2 * SPACE.n
    assert seeds == evaluation_seeds(3, 0, range(SPACE.n))
    of_rows = [call for call in trainer.calls if min(call.values()) >> 28 == Purpose.EVALUATION]
    assert all(seeds[i] == seed for call in of_rows for i, seed in call.items())
    reported = [call for call in trainer.calls if call not in of_rows]
    assert reported
    assert all(fresh[i] == seed for call in reported for i, seed in call.items())
    assert study.evaluation_seeds([5, 9]) == [seeds[5], seeds[9]]
    with pytest.raises(InvalidInput, match="targets are one or more distinct"):
        study.evaluation_seeds([SPACE.n])
