"""Consoles that take nothing, texts that would colour them, and code that exits: no traceback, no
silence, and the study goes on."""

import contextlib
import os
import signal
import subprocess
import sys
import time

import pytest
from test_interrupt import PROGRAM, begun, wait_until

import mbtl
from mbtl.faults import harmless

OWN = r"""
import ctypes, sys, time, mbtl
colours = mbtl.Categorical('colour', ('plain', 're\x1b[31md', 'bl\x9b31mue'))
space = mbtl.ContextSpace.grid({colours: 3})
def train(context, seed):
    return context['colour']
def evaluate(policy, contexts, seed):
    return [float(c['colour'] == policy) for c in contexts]
def coloured(context, seed):
    raise RuntimeError('\x1b[31mred \udcff' + 10_000 * 'long ')
def sleeps(context, seed):
    time.sleep(600)
def leaves(context, seed):
    if context['colour'] == 'plain':
        sys.exit(0)
    return context['colour']
def locks(context, seed):
    libc, mutex = ctypes.CDLL(None), ctypes.create_string_buffer(64)
    libc.pthread_mutex_lock(mutex)
    libc.pthread_mutex_lock(mutex)
of = mbtl.CMDP.from_functions
own = of('own', space, train=train, evaluate=evaluate, budget=3, bounds=(0, 1))
red = of('red', space, train=coloured, evaluate=evaluate, budget=3, bounds=(0, 1))
exits = of('exits', space, train=leaves, evaluate=evaluate, budget=3, bounds=(0, 1))
slow = of('slow', space, train=sleeps, evaluate=evaluate, budget=3)
stuck = of('stuck', space, train=locks, evaluate=evaluate, budget=3)
def make_env(context): sys.exit(0)
unmade = mbtl.CMDP.from_env('unmade', mbtl.ContextSpace.grid({mbtl.Linear('x', 0, 1): 3}),
    make_env=make_env, timesteps=100)
"""
SHOWN = (r"re\x1b[31md", r"bl\x9b31mue", r"\x1b[31mred \udcff")


@pytest.fixture
def folder(folder):
    (folder / "own.py").write_text(OWN)
    return folder


def shell(folder, line):
    """The program in a shell: (exit code, stdout, stderr)."""
    file = folder / "program.py"
    file.write_text(f"import sys; sys.modules['matplotlib'] = None\n{PROGRAM}")  # no pictures
    line = line.replace("MBTL", f"{sys.executable} {file}")
    done = subprocess.run(line, shell=True, cwd=folder, capture_output=True, text=True)
    assert "Exception ignored" not in done.stderr
    assert "mbtl/cli" not in done.stderr, done.stderr  # nor in a traceback
    return done.returncode, done.stdout, done.stderr


def rows_of(folder):
    return len(mbtl.load_study(next(folder.glob("runs/*"))).state.rows)


RUN = "MBTL run own.py:own --all"


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs /dev/full")
@pytest.mark.parametrize(
    ("line", "code", "words"),
    [
        (f"{RUN} 2>/dev/full", 0, ""),
        pytest.param(f"{RUN} 2>&-", 0, "", marks=pytest.mark.long),
        ("MBTL study list >/dev/full", 1, "cannot be written (No space left on device)"),
        (f"({RUN}; echo $? >code) 2>&1 | true; exit $(cat code)", 1, ""),
    ],
)
def test_what_cannot_be_printed_is_not_worth_a_study(folder, line, code, words):
    found, _, err = shell(folder, line)
    assert (found, words in err) == (code, True), err
    if "own.py" in line:
        assert rows_of(folder) == 3


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs /dev/full")
def test_a_progress_line_is_not_worth_a_study_in_python_either(folder):
    """Nor is one in letters that the file does not know."""
    problem = mbtl.faults.load_object("own.py:own")
    for place in ("/dev/full", "log"):
        with contextlib.suppress(OSError), open(place, "w", encoding="ascii") as file:
            study = problem.study(stopping=mbtl.Stopping())
            with contextlib.redirect_stderr(file):
                study.run()
            assert len(study.state.rows) == 3
    said = (folder / "log").read_text()
    assert "\x1b" not in said
    assert SHOWN[0] in said


@pytest.mark.parametrize("columns", ["0", "many"])
@pytest.mark.usefixtures("folder", "undrawn")
def test_texts_of_others_are_shown_and_do_nothing(mbtl_command, monkeypatch, columns):
    monkeypatch.setenv("COLUMNS", columns)
    err = mbtl_command.refusal("run", "own.py:red", "--json", code=1)
    assert SHOWN[2] in err
    assert "\x1b" not in err
    assert len(err) < 25_000  # 50,000 letters were raised, and are said twice
    if columns != "0":
        return
    code, out, err = mbtl_command("run", "own.py:own", "--all")
    assert code == 0, err
    assert SHOWN[0] in out + err
    assert "\x1b" not in out + err
    assert "\x9b" not in out + err


@pytest.mark.usefixtures("undrawn")
def test_code_that_exits_is_a_failed_training_and_a_failed_check(folder, mbtl_command):
    exits = "run", "own.py:exits", "--all", "--strategy", "random", "--json"
    code, out, err = mbtl_command(*exits)
    assert code == 0, err
    assert rows_of(folder) == 2
    assert "sys.exit(0) was called, where it must return or raise" in err
    code, out, _ = mbtl_command("check", "own.py:unmade")
    assert (code, "sys.exit(0) was called" in out) == (1, True)


@pytest.mark.usefixtures("folder")
def test_a_training_that_never_reports_ends_at_its_limit(mbtl_command):
    code, _, err = mbtl_command("run", "own.py:slow", "--timeout", "0.3")
    assert (code, "it took longer than 0.3 s" in err) == (1, True)


@pytest.mark.long  # it is given time to clean up
def test_native_code_that_never_returns_is_recorded_and_ends_the_process(folder):
    code, _, err = shell(folder, "MBTL run own.py:stuck --strategy random --timeout 0.3")
    assert code == 1
    assert "in native code that does not return. This process ends" in err
    (study,) = folder.glob("runs/*")
    (failure,) = mbtl.load_study(study).state.failures
    assert failure.reason.startswith("it took longer than 0.3 s")
    assert not mbtl.load_study(study).state.open_picks


@pytest.mark.parametrize("gap", [pytest.param(0.0, marks=pytest.mark.long), 0.01])
def test_five_interrupts_are_one(folder, gap):
    process = begun(("run", "own.py:slow", "--no-rehearsal"), cwd=folder, stdout=-1, text=True)
    wait_until(lambda: list(folder.glob("runs/*/.study.db.*.lock")), process, 600.0)  # it has begun
    for _ in range(5):
        process.send_signal(signal.SIGINT)
        time.sleep(gap)
    said = process.communicate()[0]
    assert process.returncode == 130, said
    assert "run the same command again to go on" in said
    assert "Traceback" not in said


def test_harmless_texts_stay_as_they_are():
    same = "naïve 日本語 ‌می‌خواهم 👩‍👩‍👧\n\ttabs and lines"
    assert harmless(same) == same
    assert harmless("a\x1b[2J\x07\r\x85\u202eb\udc80") == r"a\x1b[2J\x07\r\x85\u202eb\udc80"
    assert harmless("x" * 20, 10) == "xxxxxxx..."
