"""`mbtl bench`: one JSON document on standard output, tables for people, files for programs."""

import json

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from mbtl.errors import InvalidInput
from mbtl.zoo.cli.bench import bench

app = typer.Typer()
app.command()(bench)


def run(*args):
    return CliRunner().invoke(app, [str(arg) for arg in args])


@pytest.fixture
def matrix_file(tmp_path):
    path = tmp_path / "mine.npz"
    np.savez(path, returns=np.random.default_rng(0).normal(size=(2, 10, 10)))
    return path


def test_json_is_one_document_on_standard_output(matrix_file):
    result = run(
        "--matrix", matrix_file, "--matrix", "synthetic:linear-gap",
        "--selectors", "random, greedy,oracle", "--budget", 5, "--seeds", 2, "--json",
    )  # fmt: skip
    assert result.exit_code == 0
    document = json.loads(result.stdout)
    assert [entry["matrix"] for entry in document["results"]].count(str(matrix_file)) == 2 * 4
    assert list(document["results"][0]) == [
        "matrix", "matrix_seed", "selector", "seed", "theta", "sources", "performance",
        "select_seconds",
    ]  # fmt: skip
    assert set(document["summary"]["matrices"]) == {str(matrix_file), "synthetic:linear-gap"}
    assert set(document["summary"]["pooled"]) == {"random", "greedy", "oracle"}


def test_tables_name_every_selector_and_out_keeps_the_document(matrix_file, tmp_path):
    out = tmp_path / "result.json"
    result = run("--matrix", matrix_file, "--budget", 4, "--seeds", 1, "--out", out)
    assert result.exit_code == 0
    for name in ("mbtl", "mbtl-release", "worst-first", "oracle"):
        assert name in result.stdout
    assert "Oracle Transfer" in result.stdout
    assert "[" in result.stdout.split("mbtl-release")[1]  # the interval is printed, not eaten
    assert "mbtl" in json.loads(out.read_text())["summary"]["pooled"]


def test_other_bounds_are_another_scale_of_the_same_returns(matrix_file):
    def performance(*more):
        few = ("--matrix", matrix_file, "--selectors", "greedy", "--budget", 3, "--json")
        document = json.loads(run(*few, *more).stdout)
        return np.array([entry["performance"] for entry in document["results"]])

    returns = np.load(matrix_file)["returns"]
    low, high = returns.min(), returns.max()
    np.testing.assert_allclose(performance("--bounds", "seen"), performance())  # as it has none
    other = performance("--bounds", f"{low - 1},{high}") * (high - low + 1) + low - 1
    np.testing.assert_allclose(other, performance() * (high - low) + low)


@pytest.mark.parametrize("bounds", ["1", "a,b", "2,1", "0,nan"])
def test_bounds_that_are_none_are_refused(matrix_file, bounds):
    result = run("--matrix", matrix_file, "--budget", 3, "--bounds", bounds)
    assert isinstance(result.exception, InvalidInput)


def test_errors_are_the_librarys_own(matrix_file, tmp_path):
    result = run("--matrix", "absent.npz")
    assert isinstance(result.exception, InvalidInput)
    few = ("--matrix", matrix_file, "--selectors", "greedy", "--budget", 3)
    result = run(*few, "--out", tmp_path / "no" / "x")
    assert isinstance(result.exception, InvalidInput)  # said before the work, not after
    result = run(*few, "--out", tmp_path)
    assert isinstance(result.exception, InvalidInput)  # a folder is no file
