"""Building matrices: the same rows as a study's, in pieces, resumed, in one process or several."""

import json

import numpy as np
import pytest

from mbtl.contexts import ContextSpace, Linear
from mbtl.errors import InvalidInput, StorageError, TrainingFailed
from mbtl.seeds import evaluation_seeds, training_seed
from mbtl.trainers import FunctionTrainer
from mbtl.zoo.benchmark.build import ONLY, Build
from mbtl.zoo.benchmark.provenance import here

SPACE = ContextSpace.grid({Linear("x", 0.0, 4.0): [0.0, 1.0, 2.0, 3.0, 4.0]})
SETTINGS = {"problem": "line"}
PLAY = evaluation_seeds(3, 0, range(5))


def train(context, seed):
    return context["x"], seed


def evaluate(policy, contexts, seeds):
    """Two episodes that differ by 2; the seeds are in the numbers, so that they can be checked."""
    x, trained = policy
    pairs = zip(contexts, seeds, strict=True)
    middle = np.array([-abs(x - c["x"]) + trained % 7 + seed % 5 for c, seed in pairs])
    return np.stack([middle - 1.0, middle + 1.0], axis=1)


class Several:
    """A trainer of many policies with two checkpoints; counts what it is asked."""

    lanes = 2
    policy_format = "custom"

    def __init__(self):
        self.calls = []

    def train_many(self, contexts, seeds, *, keep=(), state=None, on_progress=None):
        self.calls.append(len(contexts))
        state.write_bytes(b"half of the training")
        shift = {"best": 0.0, "final": -10.0}
        return {
            k: [(c["x"] + shift[k], s) for c, s in zip(contexts, seeds, strict=True)] for k in keep
        }

    def evaluate_many(self, policies, contexts, seeds):
        return np.stack([evaluate(policy, contexts, seeds) for policy in policies])


def expected(shift=0.0):
    x = np.arange(5.0)
    trained = np.array([training_seed(3, 0, source) % 7 for source in range(5)])
    return -abs(x[:, None] + shift - x) + trained[:, None] + np.array(PLAY) % 5


def building(tmp_path, trainer, **options):
    return Build(trainer, SPACE, 3, tmp_path / "work", SETTINGS, **options)


@pytest.mark.parametrize("workers", [1, 2])
def test_rows_of_a_plain_trainer(tmp_path, workers):
    one = building(tmp_path, FunctionTrainer(train, evaluate))
    seen = []
    one.run(workers, lambda done, total: seen.append((done, total)))
    episodes = one.returns(ONLY)
    np.testing.assert_allclose(episodes.mean(axis=2), expected())
    np.testing.assert_allclose(episodes.std(axis=2), 1.0)
    assert one.origins() == [{**here(), "sources": 5}]
    assert seen == [(k, 5) for k in range(6)]
    assert one.seconds() > 0


def test_both_checkpoints_come_from_one_training(tmp_path):
    trainer = Several()
    one = building(tmp_path, trainer, keep=("best", "final"), lanes=2)
    one.run()
    assert trainer.calls == [2, 2, 1]
    np.testing.assert_allclose(one.returns("best").mean(axis=2), expected())
    np.testing.assert_allclose(one.returns("final").mean(axis=2), expected(-10.0))
    assert not list((tmp_path / "work").glob("*partial*"))  # the rows are there


def save(policy, folder):
    (folder / "policy.json").write_text(json.dumps(policy))


def load(folder):
    return tuple(json.loads((folder / "policy.json").read_text()))


def must_not(context, seed):
    raise AssertionError("trained again")


def test_policies_are_kept_so_that_evaluating_again_trains_nothing(tmp_path, monkeypatch):
    first = building(tmp_path, FunctionTrainer(train, evaluate, save, load))
    first.run()
    origins = first.origins()
    monkeypatch.setattr("mbtl.zoo.benchmark.build.here", lambda: {"commit": "another"})
    for piece in (tmp_path / "work").glob("sources-*.npz"):
        piece.unlink()
    again = building(tmp_path, FunctionTrainer(must_not, evaluate, save, load))
    again.run()
    np.testing.assert_allclose(again.returns(ONLY).mean(axis=2), expected())
    assert again.origins() == origins
    assert again.origins("evaluated") == [{"commit": "another", "sources": 5}]


def test_what_the_system_gives_without_a_policy_is_played_once(tmp_path):
    asked = []

    class Compared(FunctionTrainer):
        def ways(self, contexts):
            return ("unguided",)

        def measure(self, policy, contexts, seeds, names):
            asked.append(seeds)
            return {"score": np.tile([1.0, 2.0], (len(contexts), 1))}

    for _ in range(2):
        one = building(tmp_path, Compared(train, evaluate))
        one.run()
    assert asked == [PLAY]
    np.testing.assert_array_equal(one.references()["unguided"], [[1.0, 2.0]] * 5)


def fails_at_two(context, seed):
    if context["x"] == 2.0:
        raise TrainingFailed("diverged")
    return train(context, seed)


def test_a_training_that_fails_leaves_the_others_alone(tmp_path):
    build = building(tmp_path, FunctionTrainer(fails_at_two, evaluate))
    with pytest.raises(TrainingFailed, match=r"got none of source 2 \(diverged\)"):
        build.run(1)
    assert len(list((tmp_path / "work").glob("sources-*.npz"))) == 4
    with pytest.raises(StorageError, match="1 are missing"):
        build.returns(ONLY)


class Unequal(Several):
    def groups(self, contexts, lanes):
        return [1, 2, len(contexts) - 3]


def test_a_trainer_may_say_which_sources_go_together(tmp_path):
    build = building(tmp_path, Unequal(), keep=("best",), lanes=4)
    assert [len(piece.sources) for piece in build.pieces()] == [1, 2, SPACE.n - 3]
    assert build.claim["groups"] == [1, 2, SPACE.n - 3]
    assert "groups" not in building(tmp_path, Several(), keep=("best",), lanes=4).claim
    build.run()
    alone = building(tmp_path / "alone", Several(), keep=("best",), lanes=1)
    alone.run()
    np.testing.assert_array_equal(build.returns("best"), alone.returns("best"))


def test_a_trainer_that_cannot_be_sent_to_processes_is_refused_before_it_trains(tmp_path):
    alone = FunctionTrainer(lambda context, seed: train(context, seed), evaluate)
    build = Build(alone, SPACE, 0, tmp_path / "line", SETTINGS)
    with pytest.raises(InvalidInput, match=r"in 2 processes, got FunctionTrainer.*--workers 1"):
        build.run(workers=2)
    build.run()
    assert build.returns(ONLY).shape == (5, 5, 2)
