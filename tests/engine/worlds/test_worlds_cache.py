"""Where compiled programs are kept, and that nobody's settings or files are in the way."""

from pathlib import Path

import jax
import pytest

from mbtl.engine.worlds.flags import VARIABLE, folder, keep_programs


@pytest.mark.parametrize(
    ("environ", "place"),
    [
        ({"HOME": "/home/me"}, "/home/me/.cache/mbtl/jax"),
        ({"HOME": "/home/me", "XDG_CACHE_HOME": "/fast"}, "/fast/mbtl/jax"),
        ({"HOME": "/home/me", "XDG_CACHE_HOME": "relative"}, "/home/me/.cache/mbtl/jax"),
        ({"HOME": "/home/me", "XDG_CACHE_HOME": "/fast", VARIABLE: "/here"}, "/here"),
        ({"HOME": "/home/me", VARIABLE: "off"}, None),
        ({"HOME": "/home/me", VARIABLE: ""}, None),
    ],
)
def test_the_folder_is_the_users_cache_unless_told_otherwise(environ, place):
    assert folder(environ) == (None if place is None else Path(place))


@pytest.fixture
def nowhere():
    """No folder is set while a test runs."""
    before = jax.config.jax_compilation_cache_dir
    jax.config.update("jax_compilation_cache_dir", None)
    yield
    jax.config.update("jax_compilation_cache_dir", before)


@pytest.mark.usefixtures("nowhere")
def test_jax_is_told_the_folder_and_a_folder_of_the_users_stays(tmp_path):
    keep_programs({VARIABLE: str(tmp_path / "a")})
    keep_programs({VARIABLE: str(tmp_path / "b")})
    assert jax.config.jax_compilation_cache_dir == str(tmp_path / "a")
    assert not (tmp_path / "b").exists()


@pytest.mark.usefixtures("nowhere")
@pytest.mark.parametrize("environ", [{VARIABLE: "off"}, {VARIABLE: "{file}/inside"}])
def test_without_a_folder_that_can_be_written_nothing_is_kept(environ, tmp_path):
    file = tmp_path / "file"
    file.write_text("no folder")
    keep_programs({name: value.format(file=file) for name, value in environ.items()})
    assert jax.config.jax_compilation_cache_dir is None
    assert file.read_text() == "no folder"
