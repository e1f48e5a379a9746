"""What a log is told while a training runs."""

import io
import json
import subprocess
import sys

from rich.console import Console

import mbtl
from mbtl.cli.progress import LiveProgress
from mbtl.trainers import Progress


def told(monkeypatch, silence):
    monkeypatch.setattr("mbtl.cli.common.SILENCE", silence)
    space = mbtl.ContextSpace.grid({mbtl.Linear("x", 0.0, 1.0): 5})
    study = mbtl.create_study(space, budget=2, seed=0, strategy="specialists")
    out = io.StringIO()
    with LiveProgress(study, Console(file=out, width=100)) as live:
        pick = study.ask()
        live.on_pick(study, pick)
        live.on_progress(study, pick, Progress(3, 40, {"score": 2.5}, "episodes"))
    return out.getvalue()


def test_a_log_hears_of_a_long_training_now_and_then(monkeypatch):
    assert "pick 1/2  x = 0.5  3/40 episodes score 2.50" in told(monkeypatch, 0.0)
    assert "episodes" not in told(monkeypatch, 3600.0)


def test_a_training_that_is_begun_again_has_one_bar():
    space = mbtl.ContextSpace.grid({mbtl.Linear("x", 0.0, 1.0): 5})
    study = mbtl.create_study(space, budget=2, strategy="specialists")
    with LiveProgress(study, Console(file=io.StringIO())) as live:
        live.on_pick(study, pick := study.ask())
        study.fail(pick, "diverged", again=True)
        live.on_pick(study, study.ask())
        assert len(live._bars.tasks) == 2  # the study's, too


def test_the_bar_of_a_study_that_pays_a_cost_shows_the_cost():
    space = mbtl.ContextSpace.grid({mbtl.Linear("x", 0.0, 1.0): 5})
    study = mbtl.create_study(space, budget=mbtl.Cost(40.0, [7.0] * 5), strategy="specialists")
    study.tell(study.ask(), [0.5] * 5)
    with LiveProgress(study, Console(file=io.StringIO())) as live:
        live.on_pick(study, pick := study.ask())
        live.on_progress(study, pick, Progress(1, 2, {}))
        assert (live._bars.tasks[0].completed, live._bars.tasks[0].total) == (7.0 + 3.5, 40.0)


def test_a_document_is_alone_on_standard_output_whatever_simulators_print():
    code = (
        "import os, subprocess, sys\n"
        "from mbtl.cli.common import json_alone, print_json\n"
        "with json_alone():\n"
        "    print('Using libsumo as traci')\n"
        "    os.write(1, b'Step #0.00\\n')\n"
        "    subprocess.run([sys.executable, '-c', 'print(1)'])\n"
        "    print_json({'ok': True})\n"
        "print('after')\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    document, _, after = done.stdout.rpartition("\n}")
    assert json.loads(document + "}") == {"ok": True}
    assert after.split() == ["after"]
    assert "Step #0.00" in done.stderr
