"""`mbtl run --steps`, and what the other commands say of such a study."""

import json
from pathlib import Path

import pytest

from mbtl.cli.run_steps import steps_of
from mbtl.errors import InvalidInput

PROBLEM = """
import sys
sys.path.insert(0, {folder!r})
import mbtl
from step_problem import HORIZON, SPACE, Slow
problem = mbtl.CMDP("slow", SPACE, Slow(), bounds=(0.0, 1.0), horizon=HORIZON)
"""


@pytest.fixture
def own(tmp_path):
    folder = Path(__file__).parents[1] / "study"
    (tmp_path / "own.py").write_text(PROBLEM.format(folder=str(folder)))
    return "own.py:problem"


def test_a_run_shows_its_price_list_and_goes_on_with_more_steps(mbtl_command, own, tmp_path):
    code, out, err = mbtl_command("run", own, "--steps", "100K")
    assert code == 0, err
    assert "slow: pilot, 100K steps, N = 11" in out
    assert "steps were paid, all in:" in out
    assert "evaluation on targets" in out
    assert "on fresh episodes" in out
    assert "training 1 (x = 0.5)" in err
    folder = tmp_path / "runs" / "slow-default-steps-seed0"
    assert (folder / "policy-map.png").stat().st_size > 0
    assert (folder / "portfolio" / "portfolio.json").is_file()

    first = json.loads(mbtl_command("run", own, "--steps", "100K", "--json")[1])
    assert first["finished"] == "the budget of 100,000 steps is spent"
    assert sum(first["prices"].values()) == first["spent"] <= 100_000
    code, out, err = mbtl_command("run", own, "--steps", "0.2M", "--json")
    more = json.loads(out)
    assert "going on after" in err
    assert first["spent"] < more["spent"] <= 200_000
    assert len(more["trainings"]) > len(first["trainings"])

    shown = json.loads(mbtl_command("study", "show", folder, "--json")[1])
    assert shown["prices"] == more["prices"]
    assert "trained on" in mbtl_command("study", "show", folder)[1]
    (line,) = json.loads(mbtl_command("study", "list", "runs", "--json")[1])
    assert (line["selector"], line["budget"], line["finished"]) == ("pilot", "200K", True)


def test_a_folder_that_was_renamed_holds_the_same_study(mbtl_command, own, tmp_path):
    command = ("run", own, "--steps", "100K", "--strategy", "fixed", "--json", "--study")
    before = json.loads(mbtl_command(*command, "here")[1])
    (tmp_path / "here").rename(tmp_path / "there")
    code, out, err = mbtl_command(*command, "there")
    assert code == 0, err
    assert json.loads(out)["prices"] == before["prices"]
    (line,) = json.loads(mbtl_command("study", "list", "there", "--json")[1])
    assert line["name"] == "here"


def test_a_study_that_counts_steps_is_listed_and_deleted(mbtl_command, own, tmp_path):
    import mbtl

    mbtl_command("run", own, "--steps", "100K", "--strategy", "fixed", "--study", "here")
    (entry,) = mbtl.list_studies("here")
    assert (entry.selector, entry.budget, entry.open) == ("fixed", 100_000, 0)
    assert entry.value > 0.5
    mbtl.delete_study("here")
    assert mbtl.list_studies("here") == []
    assert not list((tmp_path / "here" / "policies").iterdir())


def test_a_committee_is_shown_with_its_policy_for_all_and_what_it_found_out(mbtl_command, own):
    code, out, err = mbtl_command("run", own, "--steps", "600K", "--strategy", "committee")
    assert code == 0, err
    assert "all contexts" in out
    assert "finished: one policy for all is enough here: it is ahead of the specialists by" in out
    assert "(all contexts)" in err
    folder = "runs/slow-default-steps-seed0"
    portfolio = json.loads(Path(folder, "portfolio", "portfolio.json").read_text())
    assert next(iter(portfolio["sets"].values()))[:3] == [0, 1, 2]
    code, seen, err = mbtl_command("watch", folder)
    assert code == 0, err
    assert "all contexts" in seen
    assert "steps were paid, all in" in seen
    code, _, err = mbtl_command("report", folder)
    assert code == 0, err
    assert "one policy for all is enough here" in Path("report.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--strategy", "pilot"), "say how many with --steps"),
        (("--steps", "20X"), "such as 300K, 20M or 1500000, got '20X'"),
        (("--steps", "20M", "--budget", "3", "--selector", "mbtl"), "--budget and --selector mean"),
        (("--steps", "20M", "--strategy", "best"), "no strategy is called 'best'"),
        (("--steps", "9K"), "up to 9,000 steps here, got 8,999"),
    ],
)
def test_options_that_mean_nothing_cost_a_line(mbtl_command, own, options, words):
    if words.endswith("8,999"):
        options = ("--steps", "8999")
    code, _, err = mbtl_command("run", own, *options)
    assert code == 2
    assert words in err


def test_steps_are_written_as_people_write_them():
    assert [steps_of(text) for text in ("20M", "300k", "1.5e6", "2_000", "1g", "0.5 M")] == [
        20_000_000, 300_000, 1_500_000, 2_000, 1_000_000_000, 500_000,
    ]  # fmt: skip
    with pytest.raises(InvalidInput, match="number of environment steps"):
        steps_of("0")
