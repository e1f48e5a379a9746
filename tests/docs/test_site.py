"""The site builds, and a warning is an error, as in `make docs`."""

import subprocess
import sys

import blocks
import pytest


@pytest.mark.long
def test_the_site_builds_without_warnings(tmp_path):
    pytest.importorskip("sphinx")
    build = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-E", "-b", "html"]
    done = subprocess.run(
        [*build, blocks.ROOT / "docs", tmp_path], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "api" / "selectors.html").exists()
