"""The published rivals: closed answers for their picks and their judgement."""

import itertools

import numpy as np
import pytest

from mbtl.contexts import Categorical, ContextSpace, Linear
from mbtl.history import History
from mbtl.models import GPSettings
from mbtl.models.constant_mean_gp import fit_constant_mean
from mbtl.models.directional_gap import fit_directional_gap
from mbtl.selectors import GPMBTL, MMBTL, SDMBTL, KMeansSelector, SelectionProblem, get_selector
from mbtl.selectors.sd_mbtl import detect
from mbtl.zoo.benchmark import synthetic_world

RIVALS = ("gp-mbtl", "m-mbtl", "sd-mbtl", "kmeans")
WIDE = GPSettings(noise_std=1e-2, amplitude_bounds=(1e-9, 1e3))


def grid(*levels):
    return ContextSpace.grid({Linear(f"x{q}", 0, 1): n for q, n in enumerate(levels)})


def problem_of(*levels, budget=5):
    return SelectionProblem.of(grid(*levels), budget=budget)


def play(selector, world, budget, seed=0):
    """History of a selector on a synthetic world, and its reasons."""
    problem, history, reasons = world.problem(budget), History(world.n), []
    for _ in range(budget):
        proposal = get_selector(selector).propose(problem, history, np.random.default_rng(0))
        history = history.with_row(proposal.source, world.rows(seed, [proposal.source])[0])
        reasons.append(proposal.reason)
    return history, reasons


def piecewise(sources, targets, left, right):
    difference = sources[:, None] - targets
    return np.minimum(difference, 0) @ left + np.maximum(difference, 0) @ right


# ---- GP-MBTL ---------------------------------------------------------------------------------


def test_gp_mbtl_starts_in_the_middle_and_then_where_it_is_worst():
    world = synthetic_world("synthetic:3d-lin-none-l1-eta0")
    history, _ = play("gp-mbtl", world, 3)
    middle = world.space.steps[history.sources[0]]
    assert middle.tolist() == [4, 4, 4]  # 3.5 rounded half to even, as published
    first = world.rows(0, [history.sources[0]])[0]
    assert history.sources[1] == int(first.argmin())
    both = np.maximum(first, world.rows(0, [history.sources[1]])[0])
    both[list(history.sources[:2])] = np.inf
    assert history.sources[2] == int(both.argmin())


def test_gp_mbtl_picks_the_argmax_of_the_published_formula():
    world = synthetic_world("synthetic:3d-lin-lin-nd-eta5@1")
    history, _ = play("gp-mbtl", world, 7)
    problem, steps = world.problem(10), world.space.steps
    gp = fit_constant_mean(steps[list(history.sources)], history.training_performance, WIDE)
    gap = fit_directional_gap(steps[list(history.sources)], steps, history.rows)
    mean, std = gp.predict(steps)
    upper = mean + np.sqrt(np.log(8)) * np.sqrt(std**2 + gp.noise_variance)
    predicted = upper[:, None] + piecewise(steps, steps, gap.left, gap.right)
    gain = np.maximum(predicted - history.best, 0.0).mean(axis=1)
    gain[list(history.sources)] = -1.0
    proposal = GPMBTL().propose(problem, history, np.random.default_rng(0))
    assert proposal.source == gain.argmax()
    assert proposal.acquisition == pytest.approx(gain.max())


def test_pending_picks_are_believed_and_not_crowded():
    world = synthetic_world("synthetic:3d-lin-none-l1-eta0")
    problem, (history, _) = world.problem(20), play("gp-mbtl", world, 6)
    first = GPMBTL().propose(problem, history, np.random.default_rng(0))
    second = GPMBTL().propose(problem, history.with_pending(first.source), np.random.default_rng(0))
    assert second.source != first.source
    assert second.acquisition < first.acquisition


# ---- M-MBTL ----------------------------------------------------------------------------------


def lloyd(steps, centres, start):
    """One new centre from one start, the plain way: its final place and the mean distance."""
    old = np.abs(steps[:, None] - steps[centres]).sum(axis=2).min(axis=1)
    centre = steps[start]
    for _ in range(300):
        mine = np.abs(steps - centre).sum(axis=1) < old
        moved = steps[mine].mean(axis=0) if mine.any() else centre
        if np.abs(moved - centre).max() <= 1e-6:
            break
        centre = moved
    return centre, np.minimum(old, np.abs(steps - centre).sum(axis=1)).mean()


def test_m_mbtl_takes_the_centre_and_then_the_best_start_of_a_plain_search():
    problem, history = problem_of(5, 5), History(25)
    first = MMBTL().propose(problem, history, np.random.default_rng(0))
    assert problem.steps[first.source].tolist() == [2, 2]
    history = history.with_row(first.source, np.zeros(25))
    found = [lloyd(problem.steps, [first.source], start) for start in range(25)]
    costs = np.array([cost for _, cost in found])
    best = found[int(np.flatnonzero(costs <= costs.min() + 1e-9)[0])][0]
    second = MMBTL().propose(problem, history, np.random.default_rng(0))
    assert problem.steps[second.source].tolist() == np.round(best).tolist()
    before, after = (
        np.abs(problem.steps - problem.steps[p.source]).sum(1) for p in (first, second)
    )
    nearer = before - np.minimum(before, after)
    assert second.acquisition == pytest.approx(nearer.mean())  # by how much contexts come nearer


def test_m_mbtl_never_reads_a_return():
    first, _ = play("m-mbtl", synthetic_world("synthetic:3d-lin-none-nd-eta0"), 12)
    other, _ = play("m-mbtl", synthetic_world("synthetic:3d-const-none-l1-eta0"), 12)
    assert first.sources == other.sources


@pytest.mark.parametrize(("levels", "middle"), [(6, 2), (8, 4), (9, 4)])
def test_halves_round_to_even_however_the_mean_was_summed(levels, middle):
    problem = problem_of(levels, levels, levels)
    first = MMBTL().propose(problem, History(levels**3), np.random.default_rng(0))
    assert problem.steps[first.source].tolist() == [middle] * 3


def test_m_mbtl_covers_where_the_weight_is():
    weights = np.where(np.arange(21) < 7, 1.0, 0.0)
    space = ContextSpace.grid({Linear("x", 0, 1): 21}, weights=weights)
    problem = SelectionProblem.of(space, budget=5)
    history = History(21)
    for _ in range(3):
        source = MMBTL().propose(problem, history, np.random.default_rng(0)).source
        history = history.with_row(source, np.zeros(21))
    assert max(history.sources) < 7


# ---- SD-MBTL ---------------------------------------------------------------------------------


def covered(world, k=8, seed=0):
    """A history of M-MBTL's first k picks."""
    return play("m-mbtl", world, k, seed)[0]


@pytest.mark.parametrize(("f", "g", "h", "noise"), [
    (*parts, noise)
    for parts in itertools.product(("const", "lin"), ("none", "lin"), ("l1", "nd"))
    for noise in (0, 5)
])  # fmt: skip
def test_only_constant_quality_with_a_distance_is_a_mountain(f, g, h, noise):
    world = synthetic_world(f"synthetic:3d-{f}-{g}-{h}-eta{noise}@1")
    found = detect(world.problem(10), covered(world))
    assert found.is_mountain == (f == "const" and h == "l1")


def test_the_slopes_of_a_directional_world_are_found_exactly():
    world = synthetic_world("synthetic:3d-const-lin-nd-eta0")
    found = detect(world.problem(10), covered(world))
    span = world.bounds(0).high - world.bounds(0).low
    assert found.gap.left * span == pytest.approx([-1, -1, 3])
    assert found.gap.right * span == pytest.approx([-3, -3, -3])


def test_a_valley_is_no_mountain():
    problem = problem_of(5, 5)
    distance = np.abs(problem.steps[:, None] - problem.steps).sum(axis=2)
    sources = (12, 0, 4, 20, 24, 6)
    mountain = History(25, sources, 0.9 - 0.05 * distance[list(sources)])
    valley = History(25, sources, 0.1 + 0.05 * distance[list(sources)])
    assert detect(problem, mountain).is_mountain
    assert not detect(problem, valley).is_mountain
    minor = synthetic_world(
        "synthetic:3d-const-none-minor-eta0"
    )  # directional on one axis of three
    assert not detect(minor.problem(10), covered(minor, 10)).is_mountain


def test_sd_mbtl_covers_for_six_rounds_and_then_judges():
    mountain = synthetic_world("synthetic:3d-const-lin-l1-eta0")
    history, reasons = play("sd-mbtl", mountain, 9)
    assert history.sources == covered(mountain, 9).sources
    assert [why.split(":")[0] for why in reasons] == ["too early to judge"] * 6 + [
        "looks like a mountain"
    ] * 3
    slope = synthetic_world("synthetic:3d-lin-none-l1-eta0")
    history, reasons = play("sd-mbtl", slope, 8)
    assert history.sources[:6] == covered(slope, 6).sources
    assert all(why.startswith("no mountain") for why in reasons[6:])
    problem = slope.problem(8)
    before = History(slope.n, history.sources[:7], history.rows[:7])
    by_model = GPMBTL().propose(problem, before, np.random.default_rng(0))
    assert history.sources[7] == by_model.source


def test_too_little_evaluated_leaves_the_structure_open():
    sources = (12, 0, 4, 20, 24, 6)
    rows = np.full((6, 25), np.nan)
    rows[np.arange(6), sources] = 0.5  # each policy on its own source only
    history = History(25, sources, rows)
    assert detect(problem_of(5, 5), history) is None
    proposal = SDMBTL().propose(problem_of(5, 5, budget=10), history, np.random.default_rng(0))
    assert proposal.reason.startswith("too early")


# ---- k-means ---------------------------------------------------------------------------------


def clumps():
    """Five contexts around 0.1 and three around 0.9 of the only axis."""
    places = [0.86, 0.9, 0.94, 0.06, 0.08, 0.1, 0.12, 0.14]
    return ContextSpace.points([Linear("x", 0, 1)], [{"x": x} for x in places])


def test_k_means_takes_the_middle_of_each_clump_the_largest_first():
    problem, history = SelectionProblem.of(clumps(), budget=2), History(8)
    for expected in (5, 1):
        source = KMeansSelector().propose(problem, history, np.random.default_rng(0)).source
        assert source == expected
        history = history.with_row(source, np.zeros(8))


def test_k_means_counts_weights_and_uses_up_the_centre_of_a_failure():
    heavy = ContextSpace.points(
        [Linear("x", 0, 1)], clumps().contexts, weights=[3.0] * 3 + [1.0] * 5
    )
    problem = SelectionProblem.of(heavy, budget=2)
    first = KMeansSelector().propose(problem, History(8), np.random.default_rng(0)).source
    assert first == 1
    failed = History(8).with_failure(1)
    assert KMeansSelector().propose(problem, failed, np.random.default_rng(0)).source == 5


# ---- all -------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", RIVALS)
def test_nan_pending_and_failed_are_no_trouble(name):
    problem, rng = problem_of(4, 3, 2, budget=20), np.random.default_rng(3)
    history = History(24)
    for k in range(16):
        source = get_selector(name).propose(problem, history, np.random.default_rng(k)).source
        assert history.open_mask(24)[source]
        row = np.where(rng.random(24) < 0.4, np.nan, rng.random(24))
        if k % 5 == 3:
            history = history.with_failure(source)
        elif k % 5 == 4:
            history = history.with_pending(source)
        else:
            history = history.with_row(source, row)


@pytest.mark.parametrize("name", RIVALS)
def test_categories_are_axes_too(name):
    space = ContextSpace.grid({Categorical("road", ("dry", "wet", "ice")): 3, Linear("x", 0, 1): 3})
    problem, history = SelectionProblem.of(space, budget=9), History(9)
    for k in range(9):
        source = get_selector(name).propose(problem, history, np.random.default_rng(k)).source
        history = history.with_row(source, np.cos(source + np.arange(9.0)))
    assert sorted(history.sources) == list(range(9))
