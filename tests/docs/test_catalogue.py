"""The catalogue in docs is that of the registry."""

import runpy
import sys

import blocks


def test_the_page_is_what_the_command_writes(monkeypatch, capsys):
    script = blocks.ROOT / "evidence" / "catalogue.py"
    monkeypatch.setattr(sys, "argv", [str(script)])
    monkeypatch.syspath_prepend(script.parent)
    runpy.run_path(str(script), run_name="__main__")
    written = (blocks.ROOT / "docs" / "catalogue.md").read_text()
    told = capsys.readouterr().out.strip()
    assert told == written.strip(), "run: python evidence/catalogue.py --write"
