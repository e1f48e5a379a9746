"""Many workers on one study: what they wait for, and what a large study takes to load.

workers      64 workers on one PostgreSQL server, trainings that sleep for a second: how often a
             pick was given twice, and which share of their time goes into ask, tell and training
utilisation  eight trainings at a time with log-normal durations: the share of the slots' time that
             trains, told as they come and, as the peer, in whole batches
load         1,000,000 contexts: processor time and memory of `load_study`, per row

    python benchmarks/many_workers.py --parts workers,utilisation,load
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import os
import resource
import sqlite3
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from postgres import Server, missing

import mbtl
from mbtl.study import StudyFinished
from mbtl.study.storage import checksum_of


def forked(job: Callable[[], object]) -> tuple[int, int]:
    """A process and the pipe through which it says what `job` gave."""
    reader, writer = os.pipe()
    pid = os.fork()
    if pid == 0:
        try:
            with os.fdopen(writer, "w") as pipe:
                json.dump(job(), pipe)
        finally:
            os._exit(0)
    os.close(writer)
    return pid, reader


def said(pid: int, reader: int):
    with os.fdopen(reader) as pipe:
        answer = pipe.read()
    os.waitpid(pid, 0)
    return json.loads(answer)


def workers(number: int, trainings: int, seconds: float, selector: str) -> None:
    if reason := missing():
        print(f"workers: left out, {reason}")
        return
    space = mbtl.ContextSpace.grid({mbtl.Linear("x", 0.0, 1.0): 640})
    with Server() as server:
        settings = {
            "budget": number * trainings, "objective": mbtl.Objective((0.0, 1.0)),
            "strategy": selector, "storage": server.url, "name": "many", "load_if_exists": True,
        }  # fmt: skip
        pid, pipe = forked(lambda: mbtl.create_study(space, **settings).name)
        said(pid, pipe)

        def work():
            study = mbtl.load_study(server.url, "many")
            spent = {"ask": 0.0, "train": 0.0, "tell": 0.0, "beat": 0.0}
            picks, began, processor = [], time.perf_counter(), time.process_time()

            def timed(name, job):
                start = time.perf_counter()
                try:
                    return job()
                finally:
                    spent[name] += time.perf_counter() - start

            while True:
                try:
                    pick = timed("ask", lambda: study.ask(lease=60.0))
                except StudyFinished:
                    break
                timed("train", lambda: time.sleep(seconds))
                timed("beat", lambda pick=pick: study.heartbeat(pick))
                row = 1.0 - np.abs(np.arange(640) - pick.source) / 640
                assert timed("tell", lambda pick=pick, row=row: study.tell(pick, row))
                picks.append(pick.number)
            whole, cpu = time.perf_counter() - began, time.process_time() - processor
            return {"picks": picks, "whole": whole, "cpu": cpu, **spent}

        began = time.perf_counter()
        started = [forked(work) for _ in range(number)]
        found = [said(*each) for each in started]
        wall = time.perf_counter() - began
    given = [pick for one in found for pick in one["picks"]]
    whole = sum(one["whole"] for one in found)
    shares = {name: sum(one[name] for one in found) / whole for name in ("ask", "tell", "beat")}
    train = sum(one["train"] for one in found) / whole
    cpu = sum(one["cpu"] for one in found) / number / len(given)
    print(
        f"workers: {number} workers, selector {selector}, {len(given)} trainings of {seconds:g} s, "
        f"{len(given) - len(set(given))} picks given twice; of the workers' time {train:.1%} "
        f"training, {shares['ask']:.1%} ask (their wait for the proposals of others with it), "
        f"{shares['tell']:.1%} tell, {shares['beat']:.1%} heartbeats; {len(given) / wall:.1f} "
        f"trainings a second; a worker computes {1000 * cpu:.1f} ms for each training of the "
        f"study, its own or not; load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores",
        flush=True,
    )


def utilisation(slots: int, trainings: int, seconds: float, spread: float) -> None:
    space = mbtl.ContextSpace.grid({mbtl.Linear("x", 0.0, 1.0): trainings})
    shares = {
        mode: _share(space, slots, trainings, seconds, spread, mode) for mode in (False, True)
    }
    print(
        f"utilisation: {slots} slots, {trainings} trainings of {seconds:g} s in the mean, "
        f"log-normal with sigma {spread:g}: {shares[False]:.1%} as they come, {shares[True]:.1%} "
        f"in whole batches, {shares[False] / shares[True]:.2f} x",
        flush=True,
    )


def _share(space, slots, trainings, seconds, spread, batches):
    busy, lock = [0.0], threading.Lock()

    def train(context, seed):
        begun = time.perf_counter()
        draw = np.random.default_rng(seed).standard_normal()
        time.sleep(seconds * math.exp(spread * draw - spread**2 / 2.0))
        with lock:
            busy[0] += time.perf_counter() - begun
        return context["x"]

    def evaluate(policy, contexts, seeds):
        return [1.0 - abs(policy - context["x"]) for context in contexts]

    study = mbtl.create_study(
        space, budget=trainings, objective=mbtl.Objective((0.0, 1.0)), strategy="random"
    )
    with ThreadPoolExecutor(slots) as pool:
        began = time.perf_counter()
        while batches and not study.is_finished:
            picks = study.ask(slots)
            policies = pool.map(lambda pick: train(pick.context, pick.seed), picks)
            for pick, policy in zip(picks, policies, strict=True):
                study.tell(pick, evaluate(policy, space.contexts, ()))
        if not batches:
            study.run(
                train, evaluate, workers=mbtl.Workers(slots, pool),
                progress=False, report=False, failures=mbtl.Failures(rehearse=False),
            )  # fmt: skip
        return busy[0] / (slots * (time.perf_counter() - began))


TOLD = 20
"""Rows of a large study that are told one by one."""
_AGAIN = """
    insert into mbtl_events
    select study, :seq, time, kind, :data, arrays, :checksum from mbtl_events where seq = :like
"""


def load(contexts: int, rows: int, episodes: int) -> None:
    space = mbtl.ContextSpace.grid({mbtl.Linear("x", 0.0, 1.0): contexts})
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "study.db"

        def write():
            study = mbtl.create_study(
                space,
                budget=rows,
                objective=mbtl.Objective((0.0, 1.0)),
                strategy="random",
                storage=file,
            )
            rng, start = np.random.default_rng(0), time.process_time()
            told = min(rows, TOLD)
            for row in range(told):
                study.tell(row, rng.random((contexts, episodes), dtype=np.float32))
            seconds = (time.process_time() - start) / told
            with contextlib.closing(sqlite3.connect(file)) as base:  # the same ones, over again
                entries = "select kind, data, arrays from mbtl_events where seq > 1 order by seq"
                known = base.execute(entries).fetchall()
                for row in range(told, rows):
                    kind, data, arrays = known[row % told]
                    data, seq = json.dumps({**json.loads(data), "source": row}), row + 2
                    like = {"seq": seq, "like": row % told + 2, "data": data}
                    checksum = checksum_of(seq, kind, data, arrays)
                    base.execute(_AGAIN, {**like, "checksum": checksum})
                base.commit()
            return seconds

        def read():
            before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
            start = time.process_time()
            study = mbtl.load_study(file)
            assert len(study.state.rows) == rows
            seconds = time.process_time() - start
            after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
            return [seconds, (after - before) / 2**10]

        wrote = said(*forked(write))
        seconds, mib = said(*forked(read))
        size = file.stat().st_size / 2**20
    print(
        f"load: {contexts:,} contexts, {rows} rows of {episodes} episodes, processor time: "
        f"a tell {wrote:.2f} s; the file {size / rows:.1f} MiB a row; a load {seconds:.1f} s and "
        f"{mib:.0f} MiB, "
        f"{1000 * seconds / rows:.0f} ms and {mib / rows:.1f} MiB a row",
        flush=True,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--parts", default="workers,utilisation,load")
    parser.add_argument("--workers", default="8,64")
    parser.add_argument("--selector", default="random")
    parser.add_argument("--trainings", type=int, default=10, help="of each worker, in the mean")
    parser.add_argument("--rows", type=int, default=1000)
    parser.add_argument("--contexts", type=int, default=1_000_000)
    arguments = parser.parse_args()
    parts = arguments.parts.split(",")
    if "workers" in parts:
        for number in map(int, arguments.workers.split(",")):
            workers(number, arguments.trainings, 1.0, arguments.selector)
    if "utilisation" in parts:
        for spread in (0.5, 1.0):
            utilisation(8, 80, 1.0, spread)
    if "load" in parts:
        load(arguments.contexts, arguments.rows, 1)
    sys.stdout.flush()


if __name__ == "__main__":
    main()
