"""What stands beside the score of a study."""

import json

import numpy as np
import pytest

from mbtl.report import beside


class Trainer:
    """Measures that say by whom and where: 10 per policy, 1 per context."""

    def __init__(self):
        self.asked = []

    def beside(self, policies, contexts, seeds, names):
        assert set(names) == {"throughput", "co2"} or names == ("throughput",)
        self.asked.append((policies, contexts, seeds))
        rows = [
            [10.0 * k + context["x"]] * 2 for k, some in enumerate(contexts) for context in some
        ]
        return {
            "policies": {"score": np.array(rows), "throughput": 100.0 + np.array(rows)},
            "unguided": {"score": np.zeros((3, 2)), "throughput": np.full((3, 2), 90.0)},
        }


class Policies:
    policies_missing = False

    def policy(self, k):
        return f"policy {k}"


class Study:
    """Three contexts of unequal weight, of which the second policy serves two."""

    class state:
        rows = ("a", "b")

    class spec:
        seed, trial = 0, 0

    class routing:
        route = np.array([1, 0, 1])

    class space:
        weights = np.array([0.5, 0.25, 0.25])

        @staticmethod
        def context(i):
            return {"x": float(i)}

    def evaluation_seeds(self, targets, purpose):
        return [100 + int(target) for target in targets]

    def portfolio(self, trainer):
        return Policies()


def test_measures_are_means_by_weight_where_each_policy_serves(tmp_path):
    trainer, units = Trainer(), {"throughput": "cars/h", "co2": "g"}
    said = beside.measure(Study(), trainer, units, tmp_path)
    # 0.25 * 1 of the first policy, 0.5 * 10 and 0.25 * 12 of the second
    assert said == [
        "policies, mean over the contexts: score 8.25, 108.2 cars/h",
        "unguided, mean over the contexts: score 0, 90 cars/h",
    ]
    served = [[{"x": 1.0}], [{"x": 0.0}, {"x": 2.0}]]
    assert trainer.asked == [(["policy 0", "policy 1"], served, [101, 100, 102])]
    assert beside.sentences(tmp_path) == said


def test_nothing_is_played_twice_or_where_nothing_is_measured(tmp_path):
    trainer = Trainer()
    for _ in range(2):
        beside.measure(Study(), trainer, {"throughput": "cars/h"}, tmp_path)
    assert len(trainer.asked) == 1
    assert beside.measure(Study(), object(), {"throughput": "cars/h"}, tmp_path / "none") == []
    assert beside.measure(Study(), trainer, {}, tmp_path / "none") == []
    assert beside.sentences(None) == []


@pytest.mark.parametrize("text", ["[", "[1]", json.dumps({"trainings": 1})])
def test_a_damaged_note_is_no_note(tmp_path, text):
    (tmp_path / beside.FILE).write_text(text)
    assert beside.sentences(tmp_path) == []
