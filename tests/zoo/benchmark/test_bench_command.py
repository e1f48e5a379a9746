"""`mbtl bench`: one JSON document on standard output, tables for people, files for programs."""

import json

import numpy as np
import pytest


@pytest.fixture
def matrix_file(tmp_path):
    path = tmp_path / "mine.npz"
    np.savez(path, returns=np.random.default_rng(0).normal(size=(2, 10, 10)))
    return path


def test_json_is_one_document_on_standard_output(mbtl_command, matrix_file):
    document = mbtl_command.document(
        "bench", "--matrix", matrix_file, "--matrix", "synthetic:linear-gap",
        "--selectors", "random, greedy,oracle", "--budget", 5, "--seeds", 2,
    )  # fmt: skip
    assert [entry["matrix"] for entry in document["results"]].count(str(matrix_file)) == 2 * 4
    assert list(document["results"][0]) == [
        "matrix", "matrix_seed", "selector", "seed", "theta", "sources", "performance",
        "select_seconds",
    ]  # fmt: skip
    assert set(document["summary"]["matrices"]) == {str(matrix_file), "synthetic:linear-gap"}
    assert set(document["summary"]["pooled"]) == {"random", "greedy", "oracle"}


def test_tables_name_every_selector_and_out_keeps_the_document(mbtl_command, matrix_file, tmp_path):
    few = ("--budget", 4, "--seeds", 1, "--out", "result.json")
    said = mbtl_command.done("bench", "--matrix", matrix_file, *few)
    for name in ("mbtl", "mbtl-release", "worst-first", "oracle", "Oracle Transfer"):
        assert name in said
    assert "[" in said.split("mbtl-release")[1]  # the interval is printed, not eaten
    assert "mbtl" in json.loads((tmp_path / "result.json").read_text())["summary"]["pooled"]


def test_other_bounds_are_another_scale_of_the_same_returns(mbtl_command, matrix_file):
    def performance(*more):
        few = ("bench", "--matrix", matrix_file, "--selectors", "greedy", "--budget", 3)
        document = mbtl_command.document(*few, *more)
        return np.array([entry["performance"] for entry in document["results"]])

    returns = np.load(matrix_file)["returns"]
    low, high = returns.min(), returns.max()
    np.testing.assert_allclose(performance("--bounds", "seen"), performance())  # as it has none
    other = performance("--bounds", f"{low - 1},{high}") * (high - low + 1) + low - 1
    np.testing.assert_allclose(other, performance() * (high - low) + low)


@pytest.mark.parametrize("bounds", ["1", "a,b", "2,1", "0,nan"])
def test_bounds_that_are_none_are_refused(mbtl_command, matrix_file, bounds):
    asked = ("bench", "--matrix", matrix_file, "--budget", 3, "--bounds", bounds)
    assert "bounds" in mbtl_command.refusal(*asked)


@pytest.mark.parametrize("place", ["no/x", "."])  # a folder is no file
def test_where_nothing_can_be_written_is_said_before_the_work(mbtl_command, matrix_file, place):
    few = ("bench", "--matrix", matrix_file, "--selectors", "greedy", "--budget", 3)
    assert "--out" in mbtl_command.refusal(*few, "--out", place)
