"""A file is whole or absent; a folder goes on only with equal settings."""

import pytest

from mbtl.errors import InvalidInput, StorageError
from mbtl.files import claimed_folder, whole_file


def test_a_file_is_replaced_only_when_the_new_one_is_complete(tmp_path):
    path = tmp_path / "numbers.txt"
    with whole_file(path) as file:
        file.write(b"one")
        assert not path.exists()
    with pytest.raises(TypeError), whole_file(path) as file:
        file.write("no bytes")
    assert path.read_bytes() == b"one"
    assert [found.name for found in path.parent.iterdir()] == ["numbers.txt"]
    with pytest.raises(StorageError, match="cannot"), whole_file(path / "numbers"):
        pass


def test_a_claimed_folder_names_what_differs(tmp_path):
    with claimed_folder(tmp_path / "a", {"seed": 1, "keep": ("best",)}, "a matrix"):
        pass
    with claimed_folder(tmp_path / "a", {"seed": 1, "keep": ["best"]}, "a matrix"):
        pass
    other = {"seed": 2, "keep": ["best"], "lanes": 1}
    with (
        pytest.raises(InvalidInput, match="holds a matrix of other settings: seed was 1, got 2"),
        claimed_folder(tmp_path / "a", other, "a matrix"),
    ):
        pass


def test_one_works_in_a_folder_at_a_time(tmp_path):
    with (
        claimed_folder(tmp_path, {"seed": 1}, "a matrix"),
        pytest.raises(StorageError, match="another process works in"),
        claimed_folder(tmp_path, {"seed": 1}, "a matrix"),
    ):
        pass
    with pytest.raises(KeyError), claimed_folder(tmp_path, {"seed": 1}, "a matrix"):
        raise KeyError
    with claimed_folder(tmp_path, {"seed": 1}, "a matrix"):
        pass


@pytest.mark.parametrize("text", ["", "[" * 9999, "[1]", "\udcff"])
def test_a_damaged_claim_gets_a_sentence(tmp_path, text):
    (tmp_path / "settings.json").write_bytes(text.encode(errors="surrogateescape"))
    with (
        pytest.raises(StorageError, match=r"settings\.json must say with which settings"),
        claimed_folder(tmp_path, {"seed": 1}, "a matrix"),
    ):
        pass
