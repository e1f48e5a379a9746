"""Two halves of the episodes: one chooses, every number shown is of the other."""

import itertools

import numpy as np
import pytest
from test_compare import Recorder

from mbtl.contexts import ContextSpace, Linear
from mbtl.routing import last_route, routes
from mbtl.zoo.benchmark import TransferMatrix, compare, levels, random_curve, sequential_oracle

SEEN = np.array([[0.9, 0.1, 0.3], [0.2, 0.8, 0.3], [0.2, 0.8, 0.3]])
FRESH = np.array([[0.5, 0.6, 0.0], [0.7, 0.4, 0.1], [0.0, 0.3, 0.2]])
"""Target 1 ties between sources 1 and 2, target 2 between all: the nearest serves."""


def halved(seen=SEEN, fresh=FRESH, **entries):
    entries = {"bounds": (0, 1), **entries}
    return TransferMatrix.of(seen[None], fresh_returns=fresh[None], **entries)


def noisy(n=7, weights=None):
    """Rounded so that ties are many."""
    rng = np.random.default_rng(5)
    seen, fresh = rng.integers(0, 4, size=(2, n, n)) / 4.0
    space = ContextSpace.grid({Linear("x", 0, 1): n}, weights=weights)
    return halved(seen, fresh, space=space)


@pytest.mark.parametrize("weights", [None, [1, 2, 3, 4, 5, 6, 7]])
def test_random_curve_equals_enumeration_of_what_would_serve(weights):
    matrix = noisy(weights=weights)
    seen, fresh = matrix.rows(0, range(7)), matrix.fresh_rows(0, range(7))
    for k, value in enumerate(random_curve(matrix, 0, 7), start=1):
        served = []
        for some in map(list, itertools.combinations(range(7), k)):
            route = last_route(seen[some], some, matrix.space.steps)
            row = fresh[some][route, np.arange(7)]
            served.append(np.average(row, weights=weights))
        assert value == pytest.approx(np.mean(served), abs=1e-12)
    assert value == pytest.approx(levels(matrix, 0).oracle_transfer)


def test_the_oracle_chooses_by_one_half_and_its_curve_is_of_the_other():
    matrix, n = noisy(), 7
    run = sequential_oracle(matrix, 0, n)
    blind = sequential_oracle(TransferMatrix.of(matrix.returns, bounds=(0, 1)), 0, n)
    assert run.sources == blind.sources
    picks = list(run.sources)
    route = routes(matrix.rows(0, picks), picks, matrix.space.steps)
    served = np.take_along_axis(matrix.fresh_rows(0, picks), route, axis=0)
    assert run.curve == pytest.approx(served.mean(axis=1))


def test_a_selector_sees_one_half_and_its_curve_is_of_the_other():
    recorder = Recorder()
    (run,) = compare([recorder], [halved()], budget=3).results
    assert np.array_equal(recorder.seen[-1][1].rows, SEEN[:2])
    # 0 alone; then 1 takes targets 1 and 2 (a tie: it is nearer); then 2 takes target 2
    assert run.performance == pytest.approx([1.1 / 3, (0.5 + 0.4 + 0.1) / 3, (0.5 + 0.4 + 0.2) / 3])


def test_episodes_become_two_halves_of_equal_rank():
    episodes = np.random.default_rng(0).normal(size=(2, 3, 3, 5)).astype(np.float32)
    alone = episodes[:, 0]
    matrix = TransferMatrix.of_episodes(episodes, references={"unguided": alone}, bounds=(-1, 1))
    assert matrix.episodes == (2, 3)
    assert matrix.returns == pytest.approx(episodes[..., :2].mean(axis=3))
    assert matrix.fresh_returns == pytest.approx(episodes[..., 2:].mean(axis=3))
    assert matrix.std == pytest.approx(episodes.std(axis=3, ddof=1))
    assert matrix.references["unguided"][:, 1] == pytest.approx(alone[..., 2:].mean(axis=2))
    assert matrix.caveat is None
