"""Kills at random moments of real runs: nothing told is lost, nothing is told twice, all end.

A study is worked on by a run of two trainings at a time and by two workers, as `mbtl worker` has
them. At random moments one of the processes gets SIGKILL and is started again; where the database
is a server, it is stopped in the midst of things now and then (`pg_ctl stop -m immediate`, or
SIGKILL) and started again. Processes are forked, since a thousand imports of mbtl would take longer
than what is to be seen.

    python benchmarks/kills.py --kills 1000 --databases sqlite,postgresql

Two kinds of study are killed, one after the other: one counts trainings of one context; the other
counts steps, and has one policy for all contexts, copies tuned from it, trainings that go on, and
policies that are evaluated once more on further contexts.
"""

from __future__ import annotations

import argparse
import collections
import contextlib
import json
import logging
import os
import random
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from postgres import Server, missing

import mbtl
from mbtl.actions import Evaluate, Extend, Start, StartOn, Stop, Wait
from mbtl.errors import Unreachable
from mbtl.seeds import training_seed
from mbtl.study import Callback
from mbtl.study.runner import run
from mbtl.study.steps.callbacks import StepCallback
from mbtl.trainer import FunctionTrainer, Trained

SPACE = mbtl.ContextSpace.grid({mbtl.Linear("x", 0.0, 1.0): 30})
BUDGET = 20
LEASE = 1.0
"""Seconds; where the database is a file, the dead are missed at once."""
LONGEST = 0.8
"""Seconds until the next kill, at most."""
OF_THE_DATABASE = 0.1
"""Share of the kills that hit a server."""
OF_A_STUDY = 50
"""Kills of one study; then it may end. On a busy machine more would leave it no time to begin."""
PATIENCE = 300.0
"""Seconds in which a study of twenty quick trainings ends after its last kill."""


def train(context, seed):
    time.sleep(0.01 + 0.03 * (seed % 7) / 7)
    return np.array([context["x"], seed % 1000], dtype=np.float64)


def evaluate(policy, contexts, seeds):
    return np.array([1.0 - abs(c["x"] - policy[0]) - 1e-6 * policy[1] for c in contexts])


def save(policy, folder):
    np.save(folder / "policy.npy", policy, allow_pickle=False)


def load(folder):
    return np.load(folder / "policy.npy", allow_pickle=False)


TRAINER = FunctionTrainer(train, evaluate, save, load)


LENGTHS = (1_000, 2_000, 4_000)
"""Marks of a training that counts steps."""


class Stepping:
    """A trainer whose policies follow from context, seed, length and start, and from nothing else.

    A policy is (4,): where it is at home, its seed, how long it trained, what it began with.
    """

    takes = frozenset({"sets", "start", "length", "state"})
    whole, counts = LENGTHS[-1], "steps"
    eval_episodes = 1
    policy_format = "custom"

    def train(self, contexts, seed, *, start=None, length=1.0, state=None, **asked):
        """To so many steps; the file says how many are done. On several as on the middle."""
        home, steps = float(np.mean([c["x"] for c in contexts])), round(length * self.whole)
        done = json.loads(state.read_text()) if state is not None and state.exists() else 0
        while done < steps:  # going on costs what is left
            done += 500
            time.sleep(0.02 + 0.04 * (seed % 7) / 7)
            if state is not None:
                state.with_suffix(".new").write_text(json.dumps(done))
                os.replace(state.with_suffix(".new"), state)
        begun = 0.0 if start is None else 1.0 + float(start @ [1.0, 1e-3, 1e-6, 0.1])
        return Trained(np.array([home, seed % 1000, steps, begun]), steps)

    def evaluate_steps(self, policy, contexts, seeds):
        """Returns and steps, without luck."""
        home, seed, steps, begun = policy
        far = np.array([abs(context["x"] - home) for context in contexts])
        returns = 1.0 - far * (1.0 - steps / 8_000) - 1e-6 * seed + 1e-3 * begun
        time.sleep(0.002)
        return returns[:, None], np.full((len(contexts), 1), 10)

    def evaluate(self, policy, contexts, seeds):
        """Returns alone."""
        return self.evaluate_steps(policy, contexts, seeds)[0]

    def save(self, policy, folder):
        """As the functions do."""
        save(policy, folder)
        return True

    def load(self, folder):
        """As the functions do."""
        return load(folder)


class Everything:
    """One policy for all, then in turns a copy tuned from it and a fresh one; each goes on once.

    Every policy is evaluated on every second context, and later on the others.
    """

    name, in_parallel, trains_on_all, starts_warm = "everything", True, True, True

    def decide(self, problem, trail, rng):
        """The first of these that is due."""
        if trail.unevaluated is not None:
            return Evaluate(trail.unevaluated, tuple(range(0, problem.n, 2)))
        for i, policy in enumerate(trail.policies):
            if np.isnan(trail.rows[i]).any() and policy.training not in trail.busy:
                return Evaluate(policy, tuple(range(problem.n)))
        for number, training in enumerate(trail.trainings):
            if training.length == 0 and number not in trail.busy:
                return Extend(number, 1 + number % 2)
        under_way = sum(isinstance(one, Start | StartOn) for one in trail.under_way)
        begun = under_way + sum(one.length >= 0 for one in trail.trainings)
        if begun == 0:
            return StartOn(tuple(range(problem.n)), 0)
        if begun < STEP_TRAININGS:
            free = [c for c in range(problem.n) if c not in trail.begun]
            tuned = begun % 2 and bool(trail.policies)
            return Start(free[7 * begun % len(free)], 0, trail.policies[0] if tuned else None)
        return Wait() if trail.under_way else Stop()


STEP_TRAININGS = 12


class StepWitness(StepCallback):
    """As `Witness`, of studies that count steps."""

    def __init__(self, file: Path) -> None:
        self.file = file

    def on_evaluated(self, study, policy):
        """One line, of what is believed to be in the log."""
        with self.file.open("a") as out:
            out.write(f"{policy.training} {policy.length}\n")


class Witness(Callback):
    """Writes down, outside of the study, what a process believes to have told."""

    def __init__(self, file: Path) -> None:
        self.file = file

    def on_told(self, study, pick):
        """One line, of what was answered with True."""
        with self.file.open("a") as out:  # one short line is written at once or not at all
            out.write(f"{pick.number} {pick.source} {pick.token}\n")


@dataclass
class Place:
    """Where a study is."""

    url: str
    name: str
    folder: Path
    counts: str

    def study(self):
        """Made or opened, as soon as the database answers."""
        while True:
            try:
                if self.counts == "steps":
                    return mbtl.create_study(
                        SPACE, cost="steps", budget=10**6, bounds=(0.0, 1.0), trainer=Stepping(),
                        strategy=Everything(), lengths=LENGTHS, horizon=10, episodes=1,
                        storage=self.url, artifacts=self.folder, name=self.name,
                        load_if_exists=True,
                    )  # fmt: skip
                return mbtl.create_study(
                    SPACE, budget=BUDGET, bounds=(0.0, 1.0), selector="random", storage=self.url,
                    artifacts=self.folder, name=self.name, load_if_exists=True,
                )  # fmt: skip
            except Unreachable:
                time.sleep(0.05)


def work(place: Place, role: str) -> None:
    """What one process does."""
    study = place.study()
    if place.counts == "steps":
        seen = [StepWitness(place.folder / "told")]
        study.run(callbacks=seen, report=False, lease=LEASE, progress=False)
        return
    witness = [Witness(place.folder / "told")]
    settings = {"callbacks": witness, "report": False, "lease": LEASE}
    if role == "run":
        with ThreadPoolExecutor(2) as pool:
            run(study, TRAINER, parallel=2, executor=pool, **settings)
    else:
        run(study, TRAINER, **settings)


def forked(job: Callable[[], Any]) -> int:
    """Its process; what it raises is printed, and its exit code is 1."""
    sys.stdout.flush()
    pid = os.fork()
    if pid:
        return pid
    code = 1
    try:
        random.seed()
        job()
        code = 0
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stderr.flush()
        os._exit(code)


@dataclass
class Count:
    """What happened."""

    kills: collections.Counter[str] = field(default_factory=collections.Counter)
    studies: int = 0
    rows: int = 0
    late: int = 0
    taken_over: int = 0
    lost: int = 0
    twice: int = 0
    wrong: int = 0
    crashed: int = 0
    unfinished: int = 0

    def __str__(self) -> str:
        hit = ", ".join(f"{n} of a {what}" for what, n in sorted(self.kills.items()))
        return (
            f"{self.kills.total()} kills ({hit}) in {self.studies} studies; "
            f"{self.rows} rows told, {self.taken_over} trainings taken over, {self.late} late "
            f"results; rows lost {self.lost}, told twice {self.twice}, wrong {self.wrong}, "
            f"processes that crashed {self.crashed}, studies that did not end {self.unfinished}"
        )

    @property
    def is_good(self) -> bool:
        """Nothing happened that must not."""
        return not (self.lost or self.twice or self.wrong or self.crashed or self.unfinished)


def disturb(place: Place, server: Server | None, rng: random.Random, count: Count, most: int):
    """One study to its end, with up to `most` kills."""
    alive: dict[str, int] = {}
    try:
        if _worked(place, server, rng, count, most, alive):
            judge(place, count)
    finally:  # an interrupt, or a study that does not end
        for pid in alive.values():
            os.kill(pid, signal.SIGKILL)
            os.waitpid(pid, 0)


def _worked(place, server, rng, count, most, alive):
    """False where it did not end."""
    roles = ["run", "worker", "another worker"]
    disturbed, left = time.monotonic(), most
    while roles:
        for role in roles:
            if role not in alive:
                alive[role] = forked(lambda role=role: work(place, role))
        until = time.monotonic() + rng.uniform(0.0, LONGEST)
        while roles and (time.monotonic() < until or not left):
            for role, pid in list(alive.items()):
                if (code := reaped(pid)) is not None:
                    alive.pop(role)
                    roles.remove(role)
                    count.crashed += code != 0
            if time.monotonic() - disturbed > PATIENCE:
                count.unfinished += 1
                return False
            time.sleep(0.005)
        if not roles or not left:
            break
        left, disturbed = left - 1, time.monotonic()
        if server is not None and rng.random() < OF_THE_DATABASE:
            how = rng.choice([signal.SIGQUIT, signal.SIGKILL])
            server.stop(how)
            time.sleep(rng.uniform(0.0, 0.3))
            server.start()
            count.kills["database"] += 1
            continue
        role = rng.choice(sorted(alive))
        os.kill(alive[role], signal.SIGKILL)
        os.waitpid(alive.pop(role), 0)
        count.kills["run" if role == "run" else "worker"] += 1
    return True


def reaped(pid: int) -> int | None:
    """Exit code of a child; None while it runs."""
    ended, status = os.waitpid(pid, os.WNOHANG)
    return os.waitstatus_to_exitcode(status) if ended else None


def judge(place: Place, count: Count) -> None:
    """Hold the log against what processes believe, and rows against their trainings."""
    reader, writer = os.pipe()

    def of_steps() -> None:
        os.write(writer, json.dumps(steps_found(place)).encode())

    def looked() -> None:
        study = place.study()
        state, events = study.state, study.log.read()
        told = [event.data for event in events if event.kind == "told"]
        rows = {row.pick: row for row in state.rows}
        believed = [line.split() for line in (place.folder / "told").read_text().splitlines()]
        answers = {(str(one["pick"]), str(one["source"]), one["token"]) for one in told}
        wrong = 0
        for row in state.rows:
            pick = study.pick(row.pick)
            policy = np.array([pick.context["x"], pick.seed % 1000])
            kept = load(study.artifacts.read(row.policy, row.sha256))
            right = np.array_equal(row.returns, evaluate(policy, SPACE.contexts, 0))
            wrong += not (right and np.array_equal(kept, policy))
        numbers = collections.Counter(one["pick"] for one in told)
        numbers_believed = collections.Counter(line[0] for line in believed)
        found = {
            "rows": len(rows),
            "late": len(state.late),
            "taken_over": sum(max(len(pick.tokens) - 1, 0) for pick in state.picks),
            "lost": sum(tuple(line) not in answers for line in believed)
            + (BUDGET - len(rows) if study.is_finished else 0),
            "twice": sum(n - 1 for n in numbers.values())
            + sum(n - 1 for n in numbers_believed.values()),
            "wrong": wrong,
            "unfinished": int(not study.is_finished),
        }
        os.write(writer, json.dumps(found).encode())

    pid = forked(of_steps if place.counts == "steps" else looked)
    os.close(writer)
    with os.fdopen(reader) as pipe:
        said = pipe.read()
    count.crashed += os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) != 0
    count.studies += 1
    for name, number in json.loads(said or "{}").items():
        setattr(count, name, getattr(count, name) + number)


def steps_found(place: Place) -> dict[str, int]:
    """The same of a study that counts steps: every policy made again, every row by its policy."""
    study, trainer = place.study(), Stepping()
    state, events = study.state, study.events()
    made: dict[tuple[int, int], Any] = {}
    wrong = 0
    for number, course in enumerate(state.trainings):
        lengths = state.lengths_of(number)
        for mark, kept in course.marks.items():
            start = (
                None if course.start is None else made[course.start.training, course.start.length]
            )
            key = SPACE.n if course.on else course.source
            seed = training_seed(study.spec.seed, study.spec.trial, key, course.repeat)
            middle = {
                "x": float(np.mean([SPACE.context(i)["x"] for i in course.on or (course.source,)]))
            }
            begun = 0.0 if start is None else 1.0 + float(start @ [1.0, 1e-3, 1e-6, 0.1])
            policy = np.array([middle["x"], seed % 1000, lengths[mark], begun])
            made[number, mark] = policy
            wrong += not np.array_equal(load(study.artifacts.read(kept.place, kept.sha256)), policy)
            wrong += kept.steps != lengths[mark]
    rows = 0
    for policy, row in zip(state.policies, state.returns, strict=True):
        right = trainer.evaluate(made[policy.training, policy.length], SPACE.contexts, None)[:, 0]
        wrong += not np.array_equal(row, right)
        rows += 1
    told = [e.data for e in events if e.kind == "evaluated"]
    answered = collections.Counter(
        (d["training"], d["length"], t) for d in told for t in d["targets"]
    )
    file = place.folder / "told"
    believed = [tuple(map(int, line.split())) for line in file.read_text().splitlines()]
    known = {(d["training"], d["length"]) for d in told}
    paid = sum(max(m.steps for m in c.marks.values()) for c in state.trainings)
    wrong += state.prices.training + state.prices.extension != paid
    wrong += state.prices.evaluation != 10 * SPACE.n * rows
    finished = study.is_finished
    return {
        "rows": rows,
        "taken_over": sum(e.kind == "claimed" for e in events),
        "lost": sum(one not in known for one in believed)
        + (2 * STEP_TRAININGS - rows if finished else 0),
        "twice": sum(n - 1 for n in answered.values()),
        "wrong": wrong,
        "unfinished": int(not finished),
    }


@contextlib.contextmanager
def database(kind: str) -> Iterator[Server | None]:
    if kind == "sqlite":
        yield None
        return
    with Server() as server:
        yield server


def campaign(kind: str, counts: str, kills: int, seed: int) -> Count:
    """Studies one after another until there were so many kills."""
    rng, count = random.Random(seed), Count()
    with database(kind) as server, tempfile.TemporaryDirectory() as folder:
        while (done := count.kills.total()) < kills and not count.unfinished:
            place = Path(folder) / f"study-{count.studies}"
            place.mkdir()
            url = str(place / "study.db") if server is None else server.url
            where = Place(url, place.name, place, counts)
            disturb(where, server, rng, count, min(kills - done, OF_A_STUDY))
            print(f"so far {count}", file=sys.stderr, flush=True)
    return count


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=1000, help="for each database and kind")
    parser.add_argument("--studies", default="trainings,steps", help="what they count")
    parser.add_argument("--databases", default="sqlite,postgresql")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    logging.getLogger("mbtl").addHandler(logging.NullHandler())  # of kills there is enough to read
    good = True
    for kind in arguments.databases.split(","):
        if kind == "postgresql" and (reason := missing()):
            print(f"{kind}: left out, {reason}")
            continue
        for counts in arguments.studies.split(","):
            count = campaign(kind, counts, arguments.kills, arguments.seed)
            good &= count.is_good
            print(f"{kind}, studies that count {counts}: {count}", flush=True)
    sys.exit(0 if good else 1)


if __name__ == "__main__":
    main()
