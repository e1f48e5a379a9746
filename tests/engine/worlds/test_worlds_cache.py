"""Where compiled programs are kept, and that nobody's settings or files are in the way."""

import jax
import pytest

from mbtl.engine.worlds.flags import keep_programs


@pytest.fixture(autouse=True)
def nowhere():
    """No folder is set while a test runs."""
    before = jax.config.jax_compilation_cache_dir
    jax.config.update("jax_compilation_cache_dir", None)
    yield
    jax.config.update("jax_compilation_cache_dir", before)


def test_the_folder_is_the_users_cache_and_one_that_is_set_stays(tmp_path, monkeypatch):
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))
    keep_programs()
    assert jax.config.jax_compilation_cache_dir == str(tmp_path / ".cache" / "mbtl" / "jax")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "fast"))
    keep_programs()
    assert jax.config.jax_compilation_cache_dir == str(tmp_path / ".cache" / "mbtl" / "jax")
    assert not (tmp_path / "fast").exists()
    jax.config.update("jax_compilation_cache_dir", None)
    keep_programs()
    assert jax.config.jax_compilation_cache_dir == str(tmp_path / "fast" / "mbtl" / "jax")


def test_without_a_folder_that_can_be_written_nothing_is_kept(tmp_path, monkeypatch):
    file = tmp_path / "file"
    file.write_text("no folder")
    monkeypatch.setenv("XDG_CACHE_HOME", str(file / "inside"))
    keep_programs()
    assert jax.config.jax_compilation_cache_dir is None
    assert file.read_text() == "no folder"
