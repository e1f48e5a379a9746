"""`mbtl reproduce` as a user calls it."""

import numpy as np
import pytest

from mbtl.zoo.benchmark import TransferMatrix, save_shipped

ID = "cartpole-length"


def test_every_item_of_a_tiny_world_by_the_command(mbtl_command, tmp_path):
    save_shipped(TransferMatrix.of(np.eye(5)[None], bounds=(0, 1)), "matrices", ID)
    items = [part for n in (1, 2, 3, 5, 8, 9, 10, 11) for part in ("--item", n)]
    ask = ("reproduce", ID, "--folder", "matrices", "--budget", 3, "--out", "out", *items)
    found = mbtl_command.document(*ask)
    assert [item["status"] for item in found["items"]] == ["done"] * 8
    assert found["rows"][0]["ours"]["mbtl"]["mean"] == pytest.approx(3 / 5)
    verdicts = {claim["title"]: claim["verdict"] for claim in found["claims"]}
    assert verdicts["Sample efficiency in traffic"] == "not testable"
    assert any("dqn" in line for item in found["items"] for line in item["missing"])
    for name in ("figures/03-curves.pdf", "tables/02-sample-complexity.csv", "README.md"):
        assert (tmp_path / "out" / name).is_file()
    out = mbtl_command(*ask)[1]  # all is kept
    for number in ("0.6000", "0.9717", "1.0000"):  # ours, the paper's MBTL, Independent
        assert number in out
    said = mbtl_command.refusal(*ask[:4], "--budget", 2, "--out", "out")
    assert "other settings: budget was 3, got 2" in said


@pytest.mark.parametrize(
    ("options", "complaint"),
    [(("--item", "curvs"), "curves"), (("--page", "p.md", "--item", "1"), "needs all items")],
)
def test_wrong_usage_says_what_to_do(mbtl_command, options, complaint):
    assert complaint in mbtl_command.refusal("reproduce", *options)
