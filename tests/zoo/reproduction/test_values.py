"""Numbers of the paper's tables: closed-form matrices in, known values out."""

import numpy as np
import pytest

from mbtl.errors import UnknownName
from mbtl.zoo.benchmark import TransferMatrix, save_shipped
from mbtl.zoo.benchmark.multitask import save_multitask
from mbtl.zoo.reproduction import Bench, Setting, claims, items_named, paper, published
from mbtl.zoo.reproduction.items.elimination import rates
from mbtl.zoo.reproduction.page import row_verdict
from mbtl.zoo.reproduction.paper import METHODS, Value

N = 6
ID = "cartpole-length"


@pytest.fixture
def folder(tmp_path):
    """Every policy returns 50 at home and 10 elsewhere, of bounds 0..100; two seeds."""
    returns = np.full((2, N, N), 10.0) + 40.0 * np.eye(N)
    matrix = TransferMatrix.of(
        returns, contexts=np.arange(1.0, N + 1)[:, None], axes=["length"], bounds=(0, 100)
    )
    save_shipped(matrix, tmp_path, ID)
    for seed in range(2):
        row = np.full(N, 30.0 + 2 * seed)
        save_multitask(row, row / 10, {"s": seed}, tmp_path / "multitask", ID, "ppo", seed)
    return tmp_path


def bench(folder, *ids, budget=3, variant="default"):
    return Bench(Setting(ids or None, budget, variant, folder))


def computed(name, *args, **kwargs):
    (item,) = items_named([name])
    return item.compute(bench(*args, **kwargs))


def test_published_numbers_of_all_22():
    table = published()
    assert len(table) == 22
    line = table[ID]
    assert set(line.values) == set(METHODS) - {"oracle_transfer", "one_policy"}
    assert (line.values["mbtl"], line.mean_k_star) == (Value(0.9717, 0.0148), 11.67)
    assert round(table["cheetah-gravity"].efficiency, 6) == 50  # the text says 43
    assert (table["ring-acc"].n, table["ring-acc"].marked) == (40, {"multitask", "random", "mbtl"})


def test_values_of_a_known_matrix(folder):
    case = bench(folder).case(ID)
    after_three = (3 * 0.5 + 3 * 0.1) / 6
    for method in ("random", "greedy", "mbtl", "sequential_oracle"):
        assert case.values[method].mean == pytest.approx(after_three)
        assert case.values[method].std == pytest.approx(0.0)
    for level in ("independent", "oracle_transfer"):
        assert case.values[level].mean == pytest.approx(0.5)
    assert case.values["multitask"].mean == pytest.approx(0.31)
    assert case.values["multitask"].std == pytest.approx(0.02 / np.sqrt(2))  # n - 1
    assert (case.k_star, case.far.shape) == ((N, N), (2, N))  # beyond K = 3
    assert case.references["random_policy"].mean() == pytest.approx((50 + 5 * 10) / 600)
    assert "same evaluation episodes" in case.caveat
    half = case.levels["grand_mean"] / 2 + case.levels["oracle_transfer"] / 2
    assert case.share(half) == pytest.approx(0.5)


def test_k_star_is_about_the_level_of_the_same_seed(tmp_path):
    rows = np.stack([np.eye(N), 0.5 * np.eye(N)]) * 100
    save_shipped(TransferMatrix.of(rows, bounds=(0, 100)), tmp_path, ID)
    numbers = computed("sample-complexity", tmp_path, ID)
    (row,) = numbers["rows"]
    assert row["ours"]["k_star"] == [N, N]  # not the mean, which the second could never reach
    assert (row["ours"]["efficiency"], row["ours"]["level"]) == (1.0, pytest.approx(0.75))
    assert row["published"]["efficiency"] == pytest.approx(100 / (35 / 3))
    assert numbers["best"]["traffic_ours"] is None


def test_fewer_sources_than_targets_are_enough_for_every_item(tmp_path):
    returns = np.stack([100 - 10.0 * np.abs(np.arange(8) - s) for s in (0, 2, 4, 6)])[None]
    matrix = TransferMatrix.of(returns.repeat(2, 0), sources=[0, 2, 4, 6], bounds=(0, 100))
    for id in (ID, "pendulum-timestep"):
        save_shipped(matrix, tmp_path, id)
    for name in ("main-table", "heatmaps", "gap-correlation", "elimination"):
        (item,) = items_named([name])
        numbers = item.compute(bench(tmp_path, ID, "pendulum-timestep", budget=5))
        assert item.figures(numbers)
    correlation = computed("gap-correlation", tmp_path, ID)["cmdps"][ID]
    assert correlation["mean"] == pytest.approx(1.0)  # the gap is the distance
    heat = computed("heatmaps", tmp_path, ID)["cmdps"][ID]
    assert np.shape(heat["table"]) == (4, 8)


SEES = {"visibility": "multiplier"}
RING = {"visibility": "hidden", "engine": "jax", "obs": "fresh"}
TOLD = {**RING, "visibility": "multiplier"}


@pytest.mark.parametrize(
    ("id", "variant", "matrix", "baseline", "peers"),
    [
        # it saw something else ...
        (ID, "default", {"switches": SEES}, {"switches": SEES}, True),
        (ID, "hidden", {"switches": {"visibility": "hidden"}}, {"switches": SEES}, False),
        # ... but where policies see no context by default, one for all must be told
        ("ring-acc", "default", {"switches": RING}, {"switches": TOLD}, True),
        ("ring-acc", "default", {"switches": RING}, {"switches": {**TOLD, "obs": "stale"}}, False),
        ("ring-acc", "default", {"switches": RING}, {"switches": {**TOLD, "engine": "x"}}, False),
        # of another version of the simulator; files of before versions were told have none
        (ID, "default", {"version": 2, "switches": {}}, {"version": 2, "switches": {}}, True),
        (ID, "default", {"version": 2, "switches": {}}, {"version": 1, "switches": {}}, False),
        (ID, "default", {"version": 2, "switches": {}}, {"switches": {}}, True),
    ],
)
def test_a_baseline_is_a_peer_of_policies_under_the_same_conditions(
    tmp_path, id, variant, matrix, baseline, peers
):
    shipped = TransferMatrix.of(np.full((1, N, N), 10.0), bounds=(0, 100), provenance=matrix)
    save_shipped(shipped, tmp_path, id, variant)
    save_multitask(np.ones(N), np.ones(N), baseline, tmp_path / "multitask", id, "ppo", 0)
    case = bench(tmp_path, id, budget=2, variant=variant).case(id)
    assert (set(case.multitask), "multitask" in case.values) == ({"ppo"} if peers else set(), peers)
    said = " ".join(computed("main-table", tmp_path, id, variant=variant)["missing"])
    assert (f"{id}: no policy for all contexts" in said) != peers


def test_what_has_no_matrix_is_said_and_unknown_ids_are_refused(folder):
    some = bench(folder)
    assert some.available() == [ID]
    numbers = computed("main-table", folder)
    assert len(numbers["rows"]) == 22
    fix = "walker-gravity: no matrix yet; build it with: mbtl matrix build walker-gravity"
    assert fix in numbers["missing"]
    with pytest.raises(UnknownName, match="cartpole-length"):
        bench(folder, "cartpole-lenght")


def test_the_best_within_significance():
    agree = [paper.marked(line.values, 3) == line.marked for line in published().values()]
    assert sum(agree) == 20  # of 22 lines of the paper, whose own rule is not known
    best = {"mbtl": Value(1.0, 0.01), "random": Value(0.99, 0.01), "greedy": Value(0.5, 0.01)}
    assert paper.marked(best, 3) == {"mbtl", "random"}
    alone = {"mbtl": Value(1.0, None), "random": Value(0.99, None), "greedy": Value(1.0, None)}
    assert paper.marked(alone, 1) == {"mbtl", "greedy"}
    assert paper.marked({"sequential_oracle": Value(1.0, 0.0)}, 3) == frozenset()


def test_ours_are_compared_seed_by_seed():
    luck = np.array([0.1, 0.0, -0.1])  # moves both, and says nothing about which is better
    found = {"mbtl": 0.90 + luck, "random": 0.89 + luck, "greedy": 0.899 - luck}
    assert paper.marked_in_pairs(found) == {"mbtl", "greedy"}
    assert paper.marked({m: Value.of(v) for m, v in found.items()}, 3) == {*found}
    single = {"mbtl": found["mbtl"], "multitask": np.array([0.9])}
    assert paper.marked_in_pairs(single) == {*single}
    assert paper.probability_of_improvement([found["mbtl"]], [found["random"]]) == 1.0
    assert paper.probability_of_improvement([found["mbtl"]], [np.array([0.85, 0.95])]) == 0.5


def test_a_claim_that_holds_for_its_control_is_no_evidence(tmp_path):
    def judged(returns, references):
        matrix = TransferMatrix.of(returns[None], bounds=(0, 100), references=references)
        save_shipped(matrix, tmp_path, "eco-green")
        found = claims.of_heatmaps(computed("heatmaps", tmp_path, "eco-green"))
        (green,) = [claim for claim in found if claim.title == "Heatmaps: green phase"]
        eco = claims.of_correlation(computed("gap-correlation", tmp_path, "eco-green"))[0]
        return green.verdict, eco.verdict

    targets = np.arange(12.0)
    easier = np.tile(20.0 + 3.0 * targets, (12, 1))  # whatever the policy
    alone = {"unguided": (10.0 + targets)[None, None]}
    assert judged(easier, alone) == (claims.NO_EVIDENCE, claims.NO_EVIDENCE)
    apart = 60.0 + targets - 4.0 * np.abs(targets[:, None] - targets)
    level = {"unguided": np.full((1, 1, 12), 10.0)}
    assert judged(apart, level) == (claims.REPRODUCED, claims.REPRODUCED)


def test_the_interquartile_mean_is_not_moved_by_what_is_odd():
    assert paper.interquartile_mean(np.array([-100.0, 1.0, 2.0, 100.0])) == pytest.approx(1.5)
    found = paper.pooled([np.array([1.0, 1.0]), np.array([3.0, 3.0])])
    assert (found.value, found.low, found.high) == (2.0, 2.0, 2.0)  # seeds do not differ
    spread = paper.pooled_mean([np.array([0.0, 2.0]), np.array([1.0, 1.0])])
    assert (spread.value, spread.low, spread.high) == (1.0, 0.5, 1.5)
    assert paper.pooled([np.array([1.0])]).low is None


def row(values, marks, published, published_marks):
    def mean(v):
        return {m: {"mean": x, "std": 0.01} for m, x in v.items()}

    return {"cmdp": "x", "ours": mean(values), "published": mean(published), "marked": marks,
            "published_marked": published_marks, "references": {}}  # fmt: skip


def test_the_verdict_on_a_line_follows_its_three_checks():
    stated = dict(zip(METHODS, (0.5, 0.4, 0.7, 0.7, 0.8, 0.9), strict=False))
    same = row_verdict(row(stated, ["mbtl"], stated, ["mbtl"]))
    assert (same.verdict, same.reasons) == (claims.REPRODUCED, ())
    higher = {**stated, "independent": 0.95}
    some = row_verdict(row(higher, ["mbtl"], stated, ["mbtl"]))
    assert some.verdict == claims.PARTLY
    assert some.checks == {"level": False, "order": False, "best": True}
    assert some.reasons[0].startswith("Policies are better on their own context")
    assert row_verdict(row(higher, [], stated, ["mbtl"])).verdict == claims.NOT
    assert row_verdict({"cmdp": "x", "ours": None, "published": {}}).verdict == claims.OPEN


def test_elimination_in_a_linear_gap_world_by_hand():
    # N = 11, slope 0.1, constant training performance: after the middle (5), the policy of 0 is
    # at least as good where |x' - 0| <= |x' - 5|, that is on 0, 1, 2.
    i = np.arange(11.0)
    world = 1.0 - 0.1 * np.abs(i[:, None] - i)
    matrix = TransferMatrix.of(world[None], bounds=(0, 1), theta=0.1)
    assert rates(matrix, 0, [5, 0]) == pytest.approx([1.0, 3 / 11])
    printed = rates(matrix, 0, [5, 0], gaps=2)
    assert printed == pytest.approx([1.0, 2 / 11])  # 0.5 <= 1, 0.6 <= 0.8, not 0.7 <= 0.6
