"""A study on twenty workers of Ray, of which some are killed: its leases hold.

Two runs share a study and a cluster. A training is longer than a lease. Workers get SIGKILL in
mid-training, half way one of the runs does, and starts again.

    python benchmarks/executors.py --databases sqlite,postgresql
"""

import argparse
import contextlib
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from concurrent.futures import Executor
from pathlib import Path

import numpy as np
import ray
from kills import Witness, database

import mbtl
from mbtl.trainers import FunctionTrainer

RUNS, WORKERS, KILLS = 2, 20, 20
LEASE, TRAINING = 2.0, 4.0
"""Seconds."""
QUIET = {"log_to_driver": False, "logging_level": "error"}
SPACE = mbtl.ContextSpace.grid({mbtl.Linear("x", 0.0, 1.0): 200})


def trainer(folder):
    """Its policy is where it is at home. While it trains, a file is named by its process."""

    def train(context, seed):
        (mark := folder / f"in-{os.getpid()}").touch()
        time.sleep(TRAINING)
        mark.unlink(missing_ok=True)
        return np.array(context["x"])

    def evaluate(policy, contexts):
        return [-abs(context["x"] - policy) for context in contexts]

    def save(policy, place):
        np.save(place / "policy.npy", policy)

    return FunctionTrainer(train, evaluate, save, lambda place: np.load(place / "policy.npy"))


class Ray(Executor):
    """As docs/cluster.md has it."""

    def submit(self, fn, /, *args, **kwargs):
        """Its future."""
        return ray.remote(fn).remote(*args, **kwargs).future()


def drive(address, url, folder, trainings):
    """One of the runs."""
    place, aim = Path(folder), mbtl.Objective(bounds=(-1.0, 0.0))
    study = mbtl.create_study(
        SPACE, budget=int(trainings), strategy="random", objective=aim, storage=url, name="killed",
        artifacts=place, load_if_exists=True,
    )  # fmt: skip
    with ray.init(address, **QUIET):
        workers, witness = mbtl.Workers(WORKERS // RUNS, Ray(), LEASE), Witness(place / "told")
        study.run(trainer=trainer(place), workers=workers, callbacks=[witness], report=False)


def killed(folder, rng):
    """Whether a worker was there that could be killed in mid-training."""
    for mark in rng.sample(found := sorted(folder.glob("in-*")), len(found)):
        with contextlib.suppress(FileNotFoundError, ProcessLookupError):
            mark.unlink()  # it is gone when the training has just ended
            os.kill(int(mark.name[3:]), signal.SIGKILL)
            return True
    return False


def disturbed(url, folder, trainings):
    """Whether a study went well; what came of it is printed."""
    rng, begun, hits = random.Random(0), time.monotonic(), 0
    with ray.init("local", num_cpus=WORKERS, include_dashboard=False, **QUIET) as new:
        given = (new.address_info["address"], url, folder, str(trainings))
        command = (sys.executable, __file__, "--drive", *given)
        runs = [subprocess.Popen(command) for _ in range(RUNS)]
        while any(run.poll() is None for run in runs):
            time.sleep(rng.uniform(0.0, 1.0))
            hits += hits < KILLS and killed(folder, rng)
            if hits == KILLS // 2 and len(runs) == RUNS:
                runs[0].kill()
                runs.append(subprocess.Popen(command))
    seconds, codes = time.monotonic() - begun, [run.wait() for run in runs]
    study = mbtl.load_study(url, name="killed")
    told = [event.data for event in study.log.read() if event.kind == "told"]
    answers = {f"{one['pick']} {one['token']}" for one in told}
    lost = len(set((folder / "told").read_text().splitlines()) - answers)
    once, failed = len({one["pick"] for one in told}), len(study.state.failures)
    retaken = sum(len(pick.tokens) - 1 for pick in study.state.picks)
    print(
        f"{hits} workers killed in mid-training, runs ended {codes}; of {trainings} trainings "
        f"{once} told, {len(told) - once} twice, {lost} lost, {failed} failed; {retaken} leases "
        f"taken over; {seconds:.0f} s"
    )
    return [once, len(told), lost, failed, *codes] == [trainings] * 2 + [0, 0, -9, 0, 0]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--databases", default="sqlite,postgresql")
    parser.add_argument("--trainings", type=int, default=100)
    given, well = parser.parse_args(), True
    for base in given.databases.split(","):
        with database(base) as server, tempfile.TemporaryDirectory() as made:
            folder = Path(made)
            url = str(folder / "study.db") if server is None else server.url
            print(base, flush=True)
            well &= disturbed(url, folder, given.trainings)
    sys.exit(0 if well else 1)


if __name__ == "__main__":
    drive(*sys.argv[2:]) if sys.argv[1:2] == ["--drive"] else main()
