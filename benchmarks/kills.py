"""Kills at random moments of real runs: nothing told is lost, nothing is told twice, all end.

A study is worked on by a run of two trainings at a time and by two workers, as `mbtl worker` has
them. At random moments one of the processes gets SIGKILL and is started again; where the database
is a server, it is stopped in the midst of things now and then (`pg_ctl stop -m immediate`, or
SIGKILL) and started again. Processes are forked, since a thousand imports of mbtl would take longer
than what is to be seen.

    python benchmarks/kills.py --kills 1000 --databases sqlite,postgresql

Three kinds of study are killed, one after the other: one counts trainings of one context; the
others count units and steps, and have one policy for all contexts, copies tuned from it, trainings
that go on, and policies that are evaluated once more on further contexts.
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
from mbtl.errors import Unreachable
from mbtl.seeds import training_seed
from mbtl.selectors import Exhausted, Proposal, Traits
from mbtl.study import Callback
from mbtl.study.study import Workers, run
from mbtl.trainers import Trained, Trainer

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


UNIT, EPISODE = 1_000, 10
"""Environment steps of a whole training, and of an episode."""


class Stepping(Trainer):
    """A trainer whose policies follow from contexts, seed, length and start, and nothing else.

    A policy is (4,): where it is at home, its seed, how long it trained, what it began with.
    """

    takes = frozenset({"sets", "start", "length", "state", "resume"})
    whole = UNIT

    def train(self, contexts, seed, *, start=None, length=None, done=0.0, state=None, **asked):
        """To so many steps; the file says how many are done. On several as on the middle."""
        home = float(np.mean([c["x"] for c in contexts]))
        steps = round(UNIT * (1.0 if length is None else length))
        if state is not None and state.exists():
            had, begun = json.loads(state.read_text())
        else:
            had = round(UNIT * done)
            begun = begun_with(start) if start is not None and not done else 0.0
            begun = float(start[3]) if done else begun
        while had < steps:  # going on costs what is left
            had += UNIT // 2
            time.sleep(0.01 + 0.02 * (seed % 7) / 7)
            if state is not None:
                state.with_suffix(".new").write_text(json.dumps([had, begun]))
                os.replace(state.with_suffix(".new"), state)
        return Trained(np.array([home, seed % 1000, steps, begun]), steps)

    def evaluate_steps(self, policy, contexts, seeds):
        """Returns and steps, without luck."""
        home, seed, steps, begun = policy
        far = np.array([abs(context["x"] - home) for context in contexts])
        returns = 1.0 - far * (1.0 - steps / 8_000) - 1e-6 * seed + 1e-3 * begun
        time.sleep(0.002)
        return returns[:, None], np.full((len(contexts), 1), EPISODE)

    def evaluate(self, policy, contexts, seeds):
        """Returns alone."""
        return self.evaluate_steps(policy, contexts, seeds)[0]

    def save(self, policy, folder):
        """As plain numbers."""
        np.save(folder / "policy.npy", policy, allow_pickle=False)
        return True

    def load(self, folder):
        """As `save` left it."""
        return np.load(folder / "policy.npy", allow_pickle=False)


def begun_with(policy):
    """What a tuned policy remembers of the one that it was begun with."""
    return 1.0 + float(policy @ [1.0, 1e-3, 1e-6, 0.1])


class Everything:
    """One policy for all, then in turns a copy tuned from it and a fresh one; each goes on once.

    Every policy is evaluated on every second context, and later on the others.
    """

    name, traits = "everything", Traits(any_training=True)

    def propose(self, problem, history, rng):
        """The first of these that is due."""
        here = tuple(range(0, problem.n, 2))
        for i in range(len(history)):
            made, source = history.made(i), history.sources[i]
            like = {"start": i, "sources": made.contexts}
            missing = np.flatnonzero(np.isnan(history.rows[i])).tolist()
            busy = [one for one in history.under_way if one.start == i]
            if missing and not any(one.length == 0.0 for one in busy):
                return Proposal(source, "further", length=0.0, targets=tuple(missing), **like)
            longer = [one for one in history.asked if one.start == i and one.goes_on]
            if not made.goes_on and not longer:
                return Proposal(source, "longer", length=2.0 + 2.0 * (i % 2), targets=here, **like)
        begun = [one for one in history.asked if not one.goes_on and one.length]
        if not begun:
            return Proposal(15, "all", length=1.0, targets=here, sources=tuple(range(problem.n)))
        if len(begun) < BEGUN:
            taken = {one.contexts for one in begun}
            free = [c for c in range(problem.n) if (c,) not in taken]
            start = 0 if len(begun) % 2 and len(history) else None
            source = free[7 * len(begun) % len(free)]
            return Proposal(source, "begun", start=start, length=1.0, targets=here)
        raise Exhausted("all that is wanted was asked for")


BEGUN = 12


class Witness(Callback):
    """Writes down, outside of the study, what a process believes to have told."""

    def __init__(self, file: Path) -> None:
        self.file = file

    def on_told(self, study, pick):
        """One line, of what was answered with True."""
        with self.file.open("a") as out:  # one short line is written at once or not at all
            out.write(f"{pick.number} {pick.token}\n")


@dataclass
class Place:
    """Where a study is."""

    url: str
    name: str
    folder: Path
    counts: str

    def study(self):
        """Made or opened, as soon as the database answers."""
        budget, strategy = BUDGET, "random"
        if self.counts != "trainings":
            budget, strategy = 1_000, Everything()  # ends when all that it wants is done
        if self.counts == "steps":
            budget = mbtl.Steps(10**6, unit=UNIT, horizon=EPISODE)
        while True:
            try:
                return mbtl.create_study(
                    SPACE, budget=budget, strategy=strategy, storage=self.url, name=self.name,
                    objective=mbtl.Objective(bounds=(0.0, 1.0)), artifacts=self.folder,
                    load_if_exists=True,
                )  # fmt: skip
            except Unreachable:
                time.sleep(0.05)

    @property
    def answers(self) -> int:
        """Of the whole study."""
        return BUDGET if self.counts == "trainings" else 4 * BEGUN


def work(place: Place, role: str) -> None:
    """What one process does."""
    study, witness = place.study(), [Witness(place.folder / "told")]
    with ThreadPoolExecutor(2) as pool:
        workers = Workers(lease=LEASE, parallel=2 if role == "run" else 1, executor=pool)
        run(study, Stepping(), workers=workers, callbacks=witness, report=False)


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

    def looked() -> None:
        os.write(writer, json.dumps(found(place)).encode())

    pid = forked(looked)
    os.close(writer)
    with os.fdopen(reader) as pipe:
        said = pipe.read()
    count.crashed += os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) != 0
    count.studies += 1
    for name, number in json.loads(said or "{}").items():
        setattr(count, name, getattr(count, name) + number)


def found(place: Place) -> dict[str, int]:
    """What is in the log: every policy made again, every row by it, every step paid once."""
    study, trainer = place.study(), Stepping()
    state = study.state
    events = study.log.read()
    told = [event.data for event in events if event.kind == "told"]
    believed = [line.split() for line in (place.folder / "told").read_text().splitlines()]
    answers = {(str(one["pick"]), one["token"]) for one in told}
    made: dict[int, Any] = {}
    wrong = 0
    for row in state.rows:
        seed, start = study.pick(row.pick).seed, made.get(row.start)
        if start is None and len(row.sources) == 1:
            wrong += seed != training_seed(study.spec.seed, study.spec.trial, row.sources)
        if row.done:
            wrong += seed % 1000 != start[1]
            begun = start[3]
        else:
            begun = 0.0 if start is None else begun_with(start)
        home = float(np.mean([SPACE.context(i)["x"] for i in row.sources]))
        policy = made[row.event] = np.array([home, seed % 1000, UNIT * row.length, begun])
        kept = trainer.load(study.artifacts.read(row.policy, row.sha256))
        right = trainer.evaluate(policy, SPACE.contexts, None)[:, 0]
        evaluated = np.isfinite(row.returns)
        wrong += not np.array_equal(kept, policy)
        wrong += not np.array_equal(row.returns[evaluated], right[evaluated])
        wrong += study.is_finished and not evaluated.all()
    bill = state.bill()
    trained = UNIT * sum(state.picks[row.pick].price for row in state.rows)
    wrong += bill.training + bill.extension != trained
    if place.counts == "steps":
        wrong += bill.evaluation != EPISODE * sum(len(one["targets"]) for one in told)
    numbers = collections.Counter(one["pick"] for one in told)
    numbers_believed = collections.Counter(line[0] for line in believed)
    return {
        "rows": len(state.rows),
        "late": sum(event.kind == "late" for event in events),
        "taken_over": sum(max(len(pick.tokens) - 1, 0) for pick in state.picks),
        "lost": sum(tuple(line) not in answers for line in believed)
        + (place.answers - len(told) if study.is_finished else 0),
        "twice": sum(n - 1 for n in numbers.values())
        + sum(n - 1 for n in numbers_believed.values()),
        "wrong": int(wrong),
        "unfinished": int(not study.is_finished),
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


def warm() -> None:
    """Import what a run imports before any fork: kills are to hit trainings, not imports."""
    with tempfile.TemporaryDirectory() as folder:
        work(Place(str(Path(folder) / "study.db"), "warm", Path(folder), "trainings"), "worker")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=1000, help="for each database and kind")
    parser.add_argument("--studies", default="trainings,units,steps", help="what they count")
    parser.add_argument("--databases", default="sqlite,postgresql")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    logging.getLogger("mbtl").addHandler(logging.NullHandler())  # of kills there is enough to read
    warm()
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
