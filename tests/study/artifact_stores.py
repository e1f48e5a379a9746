"""What every artifact store owes: subclass `ArtifactStoreContract` and give a `store` fixture."""

import pickle
from pathlib import Path

import pytest

from mbtl.errors import StorageError
from mbtl.study.artifacts import Artifact, ArtifactStore

PLACE = "policies/uid/source-0001-token"


def fill(folder: Path) -> bool:
    """A policy of two files, one of them in a folder."""
    (folder / "weights").mkdir()
    (folder / "weights" / "a.bin").write_bytes(b"\x00\x01")
    (folder / "about.txt").write_text("1.5")
    return True


class ArtifactStoreContract:
    """Tests that hold for any store; the `store` fixture is empty and new for each test."""

    def test_what_is_read_is_what_was_written(self, store: ArtifactStore) -> None:
        """With its receipt, and also by another process."""
        made = store.write(PLACE, fill, {"seed": 3})
        assert made is not None
        other = pickle.loads(pickle.dumps(store))
        receipt = other.receipt(PLACE)
        assert (receipt["seed"], receipt["sha256"]) == (3, made.sha256)
        folder = other.read(PLACE, made.sha256)
        assert (folder / "weights" / "a.bin").read_bytes() == b"\x00\x01"
        assert (folder / "about.txt").read_text() == "1.5"

    def test_a_place_that_can_be_written_says_so_and_stays_usable(
        self, store: ArtifactStore
    ) -> None:
        """It is asked before every run."""
        store.check()
        store.check()
        assert store.write(PLACE, fill, {}) is not None

    def test_what_is_not_there_is_not_there(self, store: ArtifactStore) -> None:
        """No error: a row may have no policy."""
        assert store.receipt(PLACE) is None
        assert not store.read(PLACE).exists()

    def test_what_cannot_be_saved_leaves_nothing(self, store: ArtifactStore) -> None:
        """Neither where it says so, nor where it breaks."""

        def broken(folder: Path) -> bool:
            fill(folder)
            raise RuntimeError("half way")

        assert store.write(PLACE, lambda folder: False, {}) is None
        with pytest.raises(RuntimeError, match="half way"):
            store.write(PLACE, broken, {})
        assert store.receipt(PLACE) is None

    def test_another_hash_is_refused(self, store: ArtifactStore) -> None:
        """The row that was told means the files that were there then."""
        assert isinstance(store.write(PLACE, fill, {}), Artifact)
        with pytest.raises(StorageError, match="not the one that was told"):
            store.read(PLACE, "0" * 64)
