import pytest

from mbtl.errors import InvalidInput
from mbtl.seeds import Purpose, derive_seed, evaluation_seed, selection_rng, training_seed


def test_training_seed_depends_on_root_trial_and_source_only():
    assert training_seed(0, 1, 5) == training_seed(0, 1, 5)
    seeds = {training_seed(r, t, s) for r in range(3) for t in range(3) for s in range(100)}
    assert len(seeds) == 900


def test_purposes_never_share_a_seed():
    blocks = {p: {derive_seed(0, p, i) >> 28 for i in range(200)} for p in Purpose}
    assert all(blocks[p] == {int(p)} for p in Purpose)


def test_seeds_fit_32_bits():
    assert all(0 <= derive_seed(7, p, 3, 99) < 2**32 for p in Purpose)


def test_fresh_evaluation_is_another_seed():
    assert evaluation_seed(0, 0) != evaluation_seed(0, 0, Purpose.REPORT)


def test_selection_is_reproducible_and_moves_with_the_pick():
    draw = [selection_rng(0, 0, k).random() for k in (0, 0, 1)]
    assert draw[0] == draw[1] != draw[2]


def test_negative_keys_are_refused():
    with pytest.raises(InvalidInput, match=">= 0"):
        training_seed(-1, 0, 0)
