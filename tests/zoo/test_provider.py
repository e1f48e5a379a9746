"""What the laboratory says it provides is there, and is not imported before it is asked for."""

import subprocess
import sys

from mbtl.provider import laboratory


def test_what_is_no_matrix_is_left_to_others(tmp_path):
    assert laboratory().subject(str(tmp_path), selector="specialists", budget=2, seed=0) is None


def test_commands_of_the_tool_import_none_of_the_laboratory():
    program = (
        "import sys; from mbtl.cli import main; sys.argv = ['mbtl', 'run', '--help']\n"
        "try: main()\nexcept SystemExit: pass\n"
        "print([m for m in sys.modules if m.startswith(('mbtl.zoo', 'mbtl.engine'))])"
    )
    said = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True).stdout
    assert said.splitlines()[-1] == "[]"
