import io
import json
import random
import tracemalloc
import zipfile

import numpy as np
import pytest

from damage import damaged, damaged_bytes, refusals
from mbtl import Integer, Linear
from mbtl.contexts import ContextSpace
from mbtl.errors import InvalidInput
from mbtl.zoo.benchmark import TransferMatrix
from mbtl.zoo.benchmark.npz import LONGEST_TEXT, read_text, text_array

ODD = [
    *(np.zeros(0), np.array(3), np.array("text"), np.array(["a", "b"]), np.ones((1, 4, 4)) * 1j),
    *(np.full((4, 2), np.nan), np.full((1, 4, 4), np.inf), np.zeros((4, 2)), np.array(-1.0)),
    *(np.array([2.0, 1.0]), np.zeros(3, dtype=[("a", "f8")]), np.array(True), np.zeros((1, 4, 3))),
    *(np.array(b"min"), np.zeros(2, dtype="M8[s]"), np.array("[]"), np.array("[" * 9999)),
]


@pytest.fixture
def matrix():
    space = ContextSpace.grid({Linear("a", 0.0, 1.0): 2, Integer("n", 1, 2): 2})
    return TransferMatrix.of(np.arange(16.0).reshape(1, 4, 4), space=space, provenance={"by": "me"})


def test_any_damage_to_a_matrix_file_gets_a_sentence(matrix, tmp_path):
    whole, path = matrix.arrays(), tmp_path / "m.npz"
    matrix.save(path)
    content = path.read_bytes()

    def attempt(seed):
        rng, arrays = random.Random(seed), dict(whole)
        if seed % 3 == 0:
            path.write_bytes(damaged_bytes(content, seed))
        else:
            key = rng.choice([*whole, "space", "space"])
            if key == "space" and seed % 3 == 1:
                record = damaged(json.loads(str(whole["space"])), seed)
                arrays["space"] = np.array(json.dumps(record))
            else:
                arrays[key] = rng.choice(ODD)
            np.savez(path, **arrays)
        read = TransferMatrix.load(path)
        read.problem(1), read.oracle_transfer, read.arrays()

    assert refusals(attempt, 300) > 150


def test_a_record_is_a_json_object_of_sane_length(monkeypatch):
    assert read_text(text_array({"a": 1}), "provenance") == {"a": 1}
    monkeypatch.setattr("mbtl.zoo.benchmark.npz.LONGEST_TEXT", 20)
    long = text_array({"a": "x" * 20})
    for wrong in (long, np.array("[1]"), np.array(3), np.array(["{}"]), np.array("[" * 19)):
        with pytest.raises(InvalidInput, match="JSON object"):
            read_text(wrong, "provenance")
    assert LONGEST_TEXT > 1_000_000


def huge(shape, dtype="<f8"):
    """The header of an array as a file has it, without its numbers."""
    file = io.BytesIO()
    header = {"descr": dtype, "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(file, header)
    return file.getvalue()


def test_a_small_file_that_unfolds_to_more_than_is_read_is_refused(matrix, tmp_path, monkeypatch):
    monkeypatch.setattr("mbtl.files.MOST_BYTES", 1_000_000)
    path = tmp_path / "m.npz"
    matrix.save(path)
    with zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("std.npy", huge((1, 1000, 1000)) + bytes(8_000_000))
    assert path.stat().st_size < 100_000
    tracemalloc.start()
    with pytest.raises(InvalidInput, match="are read at most"):
        TransferMatrix.load(path)
    assert tracemalloc.get_traced_memory()[1] < 1_000_000
    tracemalloc.stop()


@pytest.mark.parametrize("shape", [(1 << 62,), (-1,), (1, 100)])
def test_an_array_that_is_not_as_its_header_says_is_refused(matrix, tmp_path, shape):
    path = tmp_path / "m.npz"
    matrix.save(path)
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("std.npy", huge(shape))
    with pytest.raises(InvalidInput, match="damaged"):
        TransferMatrix.load(path)


def test_what_a_matrix_has_no_name_for_stays_packed(matrix, tmp_path):
    path = tmp_path / "m.npz"
    matrix.save(path)
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("mine.npy", huge((1 << 40,)))
        archive.writestr("objects.npy", huge((1,), "|O"))
        archive.writestr("readme.txt", "no array")
    assert np.array_equal(TransferMatrix.load(path).returns, matrix.returns)
