import numpy as np
import pytest

from mbtl.errors import InvalidInput
from mbtl.seeds import (
    Purpose,
    derive_seed,
    episode_seeds,
    evaluation_seeds,
    selection_rng,
    training_seed,
)


def test_training_seed_depends_on_root_trial_and_source_only():
    assert training_seed(0, 1, 5) == training_seed(0, 1, 5)
    seeds = {training_seed(r, t, s) for r in range(3) for t in range(3) for s in range(100)}
    assert len(seeds) == 900


def test_purposes_never_share_a_seed():
    blocks = {p: {derive_seed(0, p, i) >> 28 for i in range(200)} for p in Purpose}
    assert all(blocks[p] == {int(p)} for p in Purpose)
    assert all(0 <= derive_seed(7, p, 3, 99) < 2**32 for p in Purpose)


def test_every_target_trial_and_purpose_has_evaluation_seeds_of_its_own():
    purposes = (Purpose.EVALUATION, Purpose.REPORT)
    groups = [evaluation_seeds(0, t, range(100), p) for t in range(3) for p in purposes]
    assert len({seed for group in groups for seed in group}) == 600
    assert evaluation_seeds(0, 0, [7, 3]) == [groups[0][7], groups[0][3]]  # whatever the company


def test_episodes_of_a_target_follow_from_its_seed_alone():
    several = episode_seeds([11, 12], 2, 5)
    assert episode_seeds([12], 1, 5) == several[1:]
    assert len({seed for own in several for seed in own}) == 10


def test_episodes_are_hashed_once_for_all_policies(monkeypatch):
    first = episode_seeds([101, 102], 2, 3)
    assert first == [[derive_seed(s, Purpose.EVALUATION, e) for e in range(3)] for s in (101, 102)]
    monkeypatch.setattr("mbtl.seeds.derive_seed", lambda *keys: 0)
    again = episode_seeds([101, 102], 2, 3)
    again[0].clear()
    assert episode_seeds([101, 102], 2, 3) == first


@pytest.mark.parametrize("seeds", [5.0, None, [5], range(3)])
def test_an_evaluation_takes_a_seed_per_context(seeds):
    with pytest.raises(InvalidInput, match="one seed per context, here 2, got"):
        episode_seeds(seeds, 2, 5)


def test_one_number_stands_for_a_seed_of_each_target():
    several = episode_seeds(5, 3, 4)
    assert several == episode_seeds(np.int64(5), 3, 4)
    assert len({seed for own in several for seed in own}) == 12
    assert episode_seeds(6, 3, 4) != several


def test_selection_is_reproducible_and_moves_with_the_pick():
    draw = [selection_rng(0, 0, k).random() for k in (0, 0, 1)]
    assert draw[0] == draw[1] != draw[2]


def test_negative_keys_are_refused():
    with pytest.raises(InvalidInput, match=">= 0"):
        training_seed(-1, 0, 0)
