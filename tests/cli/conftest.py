import sys

import pytest

from mbtl.cli import main


@pytest.fixture
def mbtl_command(capsys, monkeypatch, tmp_path):
    """Run the program in a folder of its own: arguments -> (exit code, stdout, stderr)."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "100")
    monkeypatch.setattr(sys, "path", list(sys.path))

    def invoke(*arguments):
        monkeypatch.setattr(sys, "argv", ["mbtl", *map(str, arguments)])
        try:
            main()
            code = 0
        except SystemExit as stop:
            code = stop.code or 0
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    before = set(sys.modules)
    yield invoke
    for name in set(sys.modules) - before:  # a user's modules in tmp_path, of this test only
        if str(tmp_path) in str(getattr(sys.modules[name], "__file__", "")):
            del sys.modules[name]
