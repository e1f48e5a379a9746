"""Building a transfer matrix: train every source, run each policy on every target.

Work is done in pieces of a few sources. A piece is one file that appears
whole or not at all, so an interrupted build goes on where it was, in any number of processes.

Notation (shapes): N contexts, M of them sources, P sources of a piece, E episodes.
"""

from __future__ import annotations

import json
import pickle
import shutil
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, wait
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import islice
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from mbtl.arrays import Array
from mbtl.contexts import Context, ContextSpace
from mbtl.errors import InvalidInput, StorageError, StudyError, TrainingFailed, few, written
from mbtl.files import claimed_folder, whole_file
from mbtl.processes import separate_workers
from mbtl.seeds import MATRIX_TRIAL, evaluation_seeds, training_seed
from mbtl.trainers.contract import (
    ManyTrainer,
    MeasuringTrainer,
    Trainer,
    checked_returns,
    even_groups,
    reference_rows,
)
from mbtl.zoo.benchmark.matrix import Floats
from mbtl.zoo.benchmark.npz import read_npz, read_text, text_array, write_npz
from mbtl.zoo.benchmark.provenance import here

# A piece of a transfer matrix: some sources are trained, and their policies run on every target
#
# Policies are kept beside the pieces, where their trainer can save them, with a note on where they
# were trained: they can be evaluated again, and nothing is trained.
#
# Notation (shapes): N contexts, P sources of a piece, E episodes, L lengths of training.


ONLY = "policy"
"""Name of the one checkpoint of a trainer that does not offer several."""


@dataclass(frozen=True)
class Piece:
    """Some sources of a matrix, complete in itself so that any process can do it.

    Attributes:
        trainer: trains and evaluates.
        sources: P indices.
        contexts: the P sources.
        seeds: their training seeds.
        targets: the N contexts.
        evaluation: N seeds of the evaluations, one per target.
        keep: checkpoints to evaluate.
        path: where its rows go.
        policies: folder of the policies kept.
        train: train where policies are not kept.
    """

    trainer: Trainer
    sources: Sequence[int]
    contexts: Sequence[Context]
    seeds: Sequence[int]
    targets: Sequence[Context]
    evaluation: Sequence[int]
    keep: tuple[str, ...]
    path: Path
    policies: Path
    train: bool = True

    @property
    def note(self) -> Path:
        """Where and in what time the policies of this piece were trained."""
        return self.policies / f"trained-{self.sources[0]:05d}.json"

    def policy_folder(self, checkpoint: str, source: int) -> Path:
        """Where the policy of a source is kept."""
        return self.policies / checkpoint / f"source-{source:05d}"


def perform(piece: Piece) -> None:
    """Train the sources of one piece unless their policies are kept, evaluate, write its file."""
    begin = time.perf_counter()
    policies = _kept(piece)
    if policies is None:
        policies = _train(piece)
        note: dict[str, Any] = {"origin": here(), "seconds": time.perf_counter() - begin}
        _write_note(piece, note)
    else:
        note = _read_note(piece)
    arrays: dict[str, Any] = {
        f"{checkpoint}_returns": _evaluate(piece, policies[checkpoint]).astype(np.float32)
        for checkpoint in piece.keep
    }
    arrays["seconds"] = np.array(time.perf_counter() - begin)
    arrays["train_seconds"] = np.array(note["seconds"])
    arrays["origin"] = text_array(note["origin"])
    arrays["evaluated"] = text_array(here())
    write_npz(piece.path, arrays)
    _partial(piece).unlink(missing_ok=True)


Policies = Mapping[str, Sequence[Any]]
"""Checkpoint -> the P policies of a piece."""


def _partial(piece: Piece) -> Path:
    """Of an interrupted training."""
    return piece.path.with_suffix(".partial.npz")


def _train(piece: Piece) -> Policies:
    """Its policies, each kept where its trainer can save it."""
    if not piece.train:
        raise StudyError(
            f"evaluating again needs the policy of every source, got none of source "
            f"{piece.sources[0]} in {piece.policies}; build without --evaluate-again"
        )
    trainer = piece.trainer
    if isinstance(trainer, ManyTrainer):
        policies: Policies = trainer.train_many(
            piece.contexts, piece.seeds, keep=piece.keep, state=_partial(piece)
        )
    else:
        pairs = zip(piece.contexts, piece.seeds, strict=True)
        policies = {ONLY: [trainer.train([dict(context)], seed).policy for context, seed in pairs]}
    for checkpoint in piece.keep:
        for source, policy in zip(piece.sources, policies[checkpoint], strict=True):
            _keep(trainer, policy, piece.policy_folder(checkpoint, source))
    return policies


def _keep(trainer: Any, policy: Any, place: Path) -> None:
    """Save a policy into a folder that appears whole; trainers that cannot save keep none."""
    save = getattr(trainer, "save", None)
    if save is None:
        return
    partial = place.with_name(f".{place.name}.partial")
    with written(place):
        shutil.rmtree(partial, ignore_errors=True)
        partial.mkdir(parents=True)
        if save(policy, partial):
            shutil.rmtree(place, ignore_errors=True)
            partial.rename(place)
        else:
            partial.rmdir()


def _write_note(piece: Piece, note: Mapping[str, Any]) -> None:
    """Beside the policies, if they were kept."""
    if piece.policies.is_dir():
        with whole_file(piece.note) as file:
            file.write(json.dumps(note).encode())


def _read_note(piece: Piece) -> dict[str, Any]:
    """Of kept policies."""
    if not piece.note.is_file():
        return {"origin": {}, "seconds": 0.0}
    note: dict[str, Any] = json.loads(piece.note.read_text(encoding="utf-8"))
    return note


def _kept(piece: Piece) -> Policies | None:
    """The policies of a piece, if all were kept."""
    folders = {c: [piece.policy_folder(c, s) for s in piece.sources] for c in piece.keep}
    if not all(folder.is_dir() for some in folders.values() for folder in some):
        return None
    load = piece.trainer.load
    return {checkpoint: [load(place) for place in some] for checkpoint, some in folders.items()}


def _evaluate(piece: Piece, policies: Sequence[Any]) -> Array:
    """(P, N, E) returns."""
    trainer, targets = piece.trainer, list(piece.targets)
    if isinstance(trainer, ManyTrainer):
        rows: Any = trainer.evaluate_many(policies, targets, piece.evaluation)
    else:
        rows = [trainer.evaluate(policy, targets, piece.evaluation) for policy in policies]
    return np.stack([checked_returns(row, len(targets), whole=True) for row in rows])


# ---- the whole -------------------------------------------------------------------------------


@dataclass(frozen=True)
class Build:
    """One seed of a transfer matrix, and the folder in which it grows.

    Attributes:
        trainer: trains and evaluates.
        space: the N contexts.
        seed: of the matrix; a study with this root seed trains the same policies.
        folder: of the pieces; created when missing.
        settings: JSON-able; a folder goes on only with equal settings.
        keep: checkpoints to evaluate, of a trainer that offers several (`ManyTrainer`).
        lanes: sources trained together, P.
        kept: folder of policies that are only to be evaluated again; None: train.
        every: train only on every n-th context, beginning with the first; all are targets.
    """

    trainer: Trainer
    space: ContextSpace
    seed: int
    folder: Path
    settings: Mapping[str, Any]
    keep: tuple[str, ...] = (ONLY,)
    lanes: int = 1
    kept: Path | None = None
    every: int = 1

    def __post_init__(self) -> None:
        if not 1 <= self.every <= self.space.n:
            raise InvalidInput(
                f"every must be from 1 to the number of contexts ({self.space.n}), got {self.every}"
            )
        if self.lanes < 1:
            raise InvalidInput(f"lanes must be >= 1, got {self.lanes}")

    @property
    def claim(self) -> dict[str, Any]:
        """JSON-able; what a folder must have been begun with to go on."""
        own = {"seed": self.seed, "lanes": self.lanes, "keep": self.keep}
        more: dict[str, Any] = {}
        if self.every != 1:
            more["every"] = self.every
        if self._sizes != even_groups(len(self.sources), self.lanes):
            more["groups"] = self._sizes
        return {**self.settings, **own, **more}

    @property
    def sources(self) -> range:
        """(M,) contexts to train on."""
        return range(0, self.space.n, self.every)

    @cached_property
    def _sizes(self) -> list[int]:
        """Of the groups of sources that are trained together, at most `lanes` in each."""
        if hasattr(self.trainer, "groups"):
            some = [self.space.context(source) for source in self.sources]
            return list(self.trainer.groups(some, self.lanes))
        return even_groups(len(self.sources), self.lanes)

    def pieces(self) -> list[Piece]:
        """All of the matrix, done or not."""
        contexts, ends = self.space.contexts, np.cumsum(self._sizes)
        groups = [
            self.sources[end - size : end] for size, end in zip(self._sizes, ends, strict=True)
        ]
        return [
            Piece(
                self.trainer,
                some,
                [contexts[source] for source in some],
                [training_seed(self.seed, MATRIX_TRIAL, source) for source in some],
                contexts,
                self._evaluation_seeds,
                self.keep,
                self.folder / f"sources-{some[0]:05d}.npz",
                self.kept or self.folder / "policies",
                self.kept is None,
            )
            for some in groups
        ]

    def run(self, workers: int = 1, on_piece: Callable[[int, int], None] | None = None) -> None:
        """Do what is missing.

        Args:
            workers: processes; with 1 this process does it itself.
            on_piece: called with (sources done, M), first with what was there already.

        Raises:
            InvalidInput: the folder holds another matrix, or `workers` < 1.
            StorageError: the folder cannot be written, or another process builds in it.
            StudyError: a worker process died; or a policy that is to be evaluated again is gone.
            TrainingFailed: a training failed; all others were done and are kept.
        """
        if workers < 1:
            raise InvalidInput(f"workers must be >= 1, got {workers}")
        with claimed_folder(self.folder, self.claim, "a transfer matrix"):
            pieces = self.pieces()
            todo = [piece for piece in pieces if not piece.path.is_file()]
            done = len(self.sources) - sum(len(piece.sources) for piece in todo)
            if on_piece is not None:
                on_piece(done, len(self.sources))
            failed: list[tuple[Piece, TrainingFailed]] = []
            for piece, error in _perform_all(todo, workers):
                if error is not None:
                    failed.append((piece, error))
                    continue
                done += len(piece.sources)
                if on_piece is not None:
                    on_piece(done, len(self.sources))
            if failed:
                raise _some_failed(failed)
            self._refer()

    def returns(self, checkpoint: str) -> Floats:
        """(M, N, E) return of every episode, axes (source, target, episode).

        Raises:
            StorageError: pieces are missing.
        """
        return np.concatenate(self._entries(f"{checkpoint}_returns"))

    def seconds(self, key: str = "seconds") -> float:
        """Wall time of all pieces together, seconds of one process; of the training alone by
        "train_seconds".
        """
        return float(sum(self._entries(key)))

    def references(self) -> dict[str, Floats]:
        """(N, E) returns of every episode without a policy, by name; see `MeasuringTrainer`."""
        return dict(read_npz(self._references)) if self._references.is_file() else {}

    def origins(self, key: str = "origin") -> list[dict[str, Any]]:
        """The distinct places where its policies were trained (`provenance.here`).

        Each with the number of sources, as "sources"; by "evaluated", where they were evaluated.
        """
        entries = (read_text(entry, "origin") for entry in self._entries(key))
        sizes = (len(piece.sources) for piece in self.pieces())
        found = distinct(zip(entries, sizes, strict=True))
        return [{**origin, "sources": sum(sizes)} for origin, sizes in found]

    @cached_property
    def _evaluation_seeds(self) -> list[int]:
        """One per target."""
        return evaluation_seeds(self.seed, MATRIX_TRIAL, range(self.space.n))

    @property
    def _references(self) -> Path:
        return self.folder / "references.npz"

    def _refer(self) -> None:
        trainer = self.trainer
        if self._references.is_file() or not isinstance(trainer, MeasuringTrainer):
            return
        rows, n = reference_rows(trainer, self.space.contexts, self._evaluation_seeds), self.space.n
        if not rows:
            return
        checked = {name: checked_returns(row, n, whole=True) for name, row in rows.items()}
        write_npz(self._references, {k: row.astype(np.float32) for k, row in checked.items()})

    def _entries(self, key: str) -> list[Any]:
        """An entry of every piece, in order."""
        pieces = self.pieces()
        missing = sum(not piece.path.is_file() for piece in pieces)
        if missing:
            raise StorageError(
                f"the matrix in {self.folder} needs {len(pieces)} pieces, {missing} are missing; "
                "run the same command again"
            )
        return [read_npz(piece.path)[key] for piece in pieces]


_Member = TypeVar("_Member")


def distinct(
    origins: Iterable[tuple[dict[str, Any], _Member]],
) -> list[tuple[dict[str, Any], list[_Member]]]:
    """Each origin once, with all that comes from it."""
    found: list[tuple[dict[str, Any], list[_Member]]] = []
    for origin, what in origins:
        same = [those for one, those in found if one == origin]
        if same:
            same[0].append(what)
        else:
            found.append((origin, [what]))
    return found


Done = tuple[Piece, TrainingFailed | None]
"""A piece, and why there is no file of it."""


def _perform_all(pieces: Sequence[Piece], workers: int) -> Iterator[Done]:
    """Do all pieces; yields each when it is over. After another failure none is begun."""
    if workers == 1 or len(pieces) <= 1:
        for piece in pieces:
            yield piece, _outcome(partial(perform, piece))
        return
    _check_sent(pieces[0], workers)
    todo = iter(pieces)
    with separate_workers(workers) as pool:
        running = {pool.submit(perform, piece): piece for piece in islice(todo, workers)}
        try:
            while running:
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    piece = running.pop(future)
                    outcome = _outcome(future.result)
                    running |= {pool.submit(perform, coming): coming for coming in islice(todo, 1)}
                    yield piece, outcome
        except BrokenExecutor as error:
            raise StudyError(
                "a worker process died (killed, or out of memory); what was done is kept: run "
                "again, with fewer workers if memory is short"
            ) from error


def _check_sent(piece: Piece, workers: int) -> None:
    """Before a pool is made, whose own error is a traceback."""
    try:
        pickle.dumps(piece)
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise InvalidInput(
            f"a trainer must be made of functions of a module to work in {workers} processes, got "
            f"{type(piece.trainer).__name__}: {error}; move its functions to the top of a module, "
            "or take one worker (--workers 1)"
        ) from error


def _outcome(work: Callable[[], None]) -> TrainingFailed | None:
    try:
        work()
    except TrainingFailed as error:
        return error
    return None


def _some_failed(failed: Sequence[tuple[Piece, TrainingFailed]]) -> TrainingFailed:
    sources = [str(source) for piece, _ in failed for source in piece.sources]
    which = few(sources, 10)
    first = failed[0][1]
    error = TrainingFailed(
        f"a matrix needs the policy of every source, got none of source {which} ({first}); the "
        "others are kept: run again when that is mended, or leave the contexts out"
    )
    error.__cause__ = first
    return error
