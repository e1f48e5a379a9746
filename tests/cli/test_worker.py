"""`mbtl worker` and `mbtl run --workers`, as a user and a batch system start them."""

import signal
import subprocess
import threading

import pytest
from test_interrupt import begun, wait_until

import mbtl

QUICK = """
import pathlib, time, mbtl
def train(context, seed):
    while context['x'] == pathlib.Path('slow').exists() * 0.5 and pathlib.Path('slow').exists():
        pathlib.Path('training').touch()
        time.sleep(0.02)
    return context['x']
def evaluate(p, contexts, seeds): return [1 - abs(c['x'] - p) for c in contexts]
def save(p, folder): (folder / 'x').write_text(str(p))
def load(folder): return float((folder / 'x').read_text())
space = mbtl.ContextSpace.grid({mbtl.Linear('x', 0, 1): 5})
problem = mbtl.CMDP.from_functions(
    'quick', space, train=train, evaluate=evaluate, save=save, load=load, budget=3,
    bounds=(0.0, 1.0))
other = mbtl.CMDP.from_functions('other', space, train=train, evaluate=evaluate, budget=3)
"""


pytestmark = pytest.mark.usefixtures("undrawn")


@pytest.fixture
def place(folder):
    """A working folder with a problem; `slow` in it makes the training in the centre endless."""
    (folder / "quick.py").write_text(QUICK)
    return folder


def made(place, **settings):
    problem = mbtl.faults.load_object("quick.py:problem")
    return problem.study(
        storage=place / "s" / "study.db", strategy="mbtl", **{"budget": 3, **settings}
    )


def worker(*arguments):
    return begun(("worker", *arguments), stdout=subprocess.PIPE, text=True)


def test_a_worker_trains_what_is_left_of_a_study_and_says_so(place, mbtl_command):
    made(place)
    said = mbtl_command.document("worker", "s", "quick.py:problem")
    assert (said["told"], said["rows"], said["finished"]) == (3, 3, True)
    assert "budget of 3 trainings is spent" in said["ended"]
    code, out, err = mbtl_command("worker", "s", "quick.py:problem")  # nothing is left
    assert (code, out) == (0, "")
    assert "it told 0 of the 3 rows" in err


def test_a_master_makes_the_study_waits_for_its_workers_and_sums_up(place, mbtl_command):
    helped = []

    def help_out():
        wait_until((place / "shared.db").exists)
        process = worker("shared.db", "quick.py:problem", "--json")
        helped.append((process.communicate()[0], process.returncode))

    helper = threading.Thread(target=help_out)
    helper.start()
    run = ("run", "quick.py:problem", "--workers", "shared.db", "--study", "mine")
    code, _, err = mbtl_command(*run, "--json")
    helper.join()
    assert code == 0, err
    assert helped[0][1] == 0, helped
    assert "mbtl worker shared.db quick.py:problem --name mine" in err
    assert "done, V = " in err
    assert (place / "mine" / "portfolio").is_dir()
    assert mbtl.load_study(place / "shared.db").state.fresh is not None
    assert "mbtl worker" in mbtl_command.refusal(*run, "--parallel", 2)


def test_a_master_with_other_code_says_so_and_does_not_wait(place):
    made(place).run(progress=False, report=False).study.extend(4)
    (place / "quick.py").write_text(QUICK.replace("return context['x']", "return 0.0"))
    run = ("run", "quick.py:problem", "--workers", "s/study.db", "--study", "s", "--budget", "4")
    process = begun((*run, "--strategy", "mbtl", "--all"), stdout=subprocess.PIPE, text=True)
    said = process.communicate(timeout=60)[0]
    assert process.returncode == 2
    assert "since it was last recorded `train` changed" in said


@pytest.mark.parametrize(
    "number", [signal.SIGTERM, pytest.param(signal.SIGINT, marks=pytest.mark.long)]
)
def test_a_worker_that_is_told_to_end_gives_its_training_back_at_once(place, number):
    study = made(place)
    (place / "slow").touch()
    process = worker("s", "quick.py:problem")
    wait_until((place / "training").exists, process)
    assert study.refresh().open_picks[0].lease is not None
    process.send_signal(number)
    out, _ = process.communicate()
    assert process.returncode == 130, out
    assert "run the same command again" in out
    assert "Traceback" not in out
    assert study.refresh().open_picks[0].lease is None  # by itself: nobody had to miss it
    assert study.ask().number == 0


def test_a_worker_that_need_not_wait_leaves_the_last_training_to_others(place, mbtl_command):
    study = made(place, budget=1)
    study.ask(lease=600.0)
    said = mbtl_command.document("worker", "s", "quick.py:problem", "--no-wait")
    assert (said["ended"], said["finished"]) == ("others are at the last trainings", False)


NOBODY = "postgresql+psycopg://me:pw9@127.0.0.1:1/db"


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (("nowhere", "quick.py:problem"), 1, "there is none at"),
        (("s", "quick.py:problem", "--name", "theirs"), 2, "no study is called 'theirs'"),
        (("s", "quick.py:other"), 2, "the problem it was made for"),
        (("s", "quick.py:nothing"), 2, "no attribute"),
        (("s", "quick.py:problem", "--lease", "0"), 2, "seconds > 0"),
        ((NOBODY, "quick.py:problem"), 1, "does not answer"),
    ],
)
def test_what_a_worker_cannot_do_it_says_in_a_sentence(place, mbtl_command, arguments, code, words):
    pytest.importorskip("psycopg")
    made(place)
    said = mbtl_command.refusal("worker", *arguments, code=code)
    assert words in said
    assert "pw9" not in said
