"""The catalogue in docs is that of the registry."""

import subprocess
import sys

import blocks


def test_the_page_is_what_the_command_writes():
    script = blocks.ROOT / "evidence" / "catalogue.py"
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, check=True)
    written = (blocks.ROOT / "docs" / "catalogue.md").read_text()
    assert done.stdout.strip() == written.strip(), "run: python evidence/catalogue.py --write"
