"""What a release may hold: all that is committed, no path of a machine, and at most 20 MB."""

import importlib.util
import io
import tomllib
import zipfile
from pathlib import Path

import numpy as np
import pytest

import mbtl

TOOL = Path(__file__).parents[1] / "tools" / "release_check.py"


@pytest.fixture(scope="module")
def release():
    spec = importlib.util.spec_from_file_location("release_check", TOOL)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_tests_of_the_core_are_there(release):
    tests = Path(__file__).parent
    assert [name for name in release.CORE_TESTS if not (tests / name).exists()] == []


@pytest.fixture
def wheel(release, tmp_path):
    def write(**files):
        path = tmp_path / "mbtl.whl"
        with zipfile.ZipFile(path, "w") as content:
            for name in {*release.NEEDED} - {*files}:
                content.writestr(name, b"")
            for name, data in files.items():
                if data is not None:
                    content.writestr(name, data)
        return path

    return write


def arrays(**values):
    file = io.BytesIO()
    np.savez_compressed(file, **values)
    return file.getvalue()


def test_the_package_leaves_room_below_the_limit(release):
    files = [f for f in Path(mbtl.__file__).parent.rglob("*") if f.suffix in {".npz", ".csv"}]
    size = sum(f.stat().st_size for f in files)
    assert size < release.LIMIT - 2_000_000, "keep the largest matrices out of the package"


def test_a_whole_wheel_passes(release, wheel):
    release.check_wheel(wheel(), {*release.NEEDED})


LICENSE = "mbtl/zoo/benchmark/data/LICENSE.md"
COMMAND = '{"command": "/home/somebody/.venv/bin/mbtl matrix build"}'


@pytest.mark.parametrize(
    ("name", "data", "is_committed", "words"),
    [
        ("mbtl/py.typed", None, False, r"does not have 1 files: mbtl/py\.typed"),
        ("mbtl/old.py", b"", False, r"not committed, 1 files: mbtl/old\.py"),
        (LICENSE, COMMAND.encode(), True, "names a path of a machine"),
        ("mbtl/a.npz", arrays(provenance=np.array(COMMAND)), True, "names a path of a machine"),
    ],
)
def test_what_lacks_is_left_over_or_names_a_machine_is_refused(
    release, wheel, name, data, is_committed, words
):
    with pytest.raises(release.Refused, match=words):
        release.check_wheel(wheel(**{name: data}), {*release.NEEDED, *[name] * is_committed})


def test_a_large_wheel_is_refused(release, wheel, monkeypatch):
    monkeypatch.setattr(release, "LIMIT", 100)
    with pytest.raises(release.Refused, match="keep the largest matrices out"):
        release.check_wheel(wheel(), {*release.NEEDED})


def test_citation_and_changelog_are_of_this_version():
    root = TOOL.parents[1]
    version = tomllib.loads((root / "pyproject.toml").read_text())["project"]["version"]
    assert f"\nversion: {version}\n" in (root / "CITATION.cff").read_text()
    assert f"## {version} " in (root / "CHANGELOG.md").read_text()
