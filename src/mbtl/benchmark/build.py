"""Building a transfer matrix: train every source, run each policy on every target.

Work is done in pieces of a few sources (`mbtl.benchmark.piece`). A piece is one file that appears
whole or not at all, so an interrupted build goes on where it was, in any number of processes.

Notation (shapes): N contexts, M of them sources, P sources of a piece, E episodes.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, wait
from dataclasses import asdict, dataclass
from functools import cached_property, partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbtl.benchmark.entries import Floats
from mbtl.benchmark.npz import read_npz, read_text, write_npz
from mbtl.benchmark.piece import ONLY, Piece, perform
from mbtl.checkpoints import Along
from mbtl.contexts import ContextSpace
from mbtl.errors import InvalidInput, StorageError, StudyError, TrainingFailed, few
from mbtl.files import claimed_folder
from mbtl.processes import worker_pool
from mbtl.seeds import MATRIX_TRIAL, evaluation_seeds, training_seed
from mbtl.trainer import ManyTrainer, ReferenceTrainer, Trainer, checked_returns, even_groups


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
        along: rows along the trainings, of a `ManyTrainer`, if any.
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
    along: Along | None = None
    every: int = 1

    def __post_init__(self) -> None:
        if not 1 <= self.every <= self.space.n:
            raise InvalidInput(
                f"every must be from 1 to the number of contexts ({self.space.n}), got {self.every}"
            )
        if self.lanes < 1:
            raise InvalidInput(f"lanes must be >= 1, got {self.lanes}")
        if self.along and not isinstance(self.trainer, ManyTrainer):
            raise InvalidInput(
                "rows along a training need a trainer that keeps weights on the way (the jax "
                f"engine and the traffic twins do), got {type(self.trainer).__name__}"
            )

    @property
    def claim(self) -> dict[str, Any]:
        """JSON-able; what a folder must have been begun with to go on."""
        own = {"seed": self.seed, "lanes": self.lanes, "keep": self.keep}
        more: dict[str, Any] = {"along": asdict(self.along)} if self.along else {}
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
                self.along,
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
            StorageError: pieces are missing, or were written by an older version.
        """
        return np.concatenate(self._entries(f"{checkpoint}_returns"))

    def along_returns(self) -> Floats:
        """(2, L, M, N, E) of the rows along the trainings, in the order of `Along.names`."""
        return np.concatenate(self._entries("along_returns"), axis=2)

    def lasted(self) -> NDArray[np.int64]:
        """(M, 3) environment steps, or episodes, of each training: done, planned, of an update."""
        return np.concatenate(self._entries("lasted"))

    def seconds(self, key: str = "seconds") -> float:
        """Wall time of all pieces together, seconds of one process; of the training alone by
        "train_seconds".
        """
        return float(sum(self._entries(key)))

    def references(self) -> dict[str, Floats]:
        """(N, E) returns of every episode without a policy, by name; see `ReferenceTrainer`."""
        return dict(read_npz(self._references)) if self._references.is_file() else {}

    def origins(self, key: str = "origin") -> list[dict[str, Any]]:
        """The distinct places where its policies were trained (`mbtl.provenance.here`).

        Each with the number of sources, as "sources"; by "evaluated", where they were evaluated.
        """
        found: list[dict[str, Any]] = []
        for piece, entry in zip(self.pieces(), self._entries(key), strict=True):
            origin = read_text(entry, "origin")
            same = [one for one in found if {**one, "sources": None} == {**origin, "sources": None}]
            if same:
                same[0]["sources"] += len(piece.sources)
            else:
                found.append({**origin, "sources": len(piece.sources)})
        return found

    @cached_property
    def _evaluation_seeds(self) -> list[int]:
        """One per target."""
        return evaluation_seeds(self.seed, MATRIX_TRIAL, range(self.space.n))

    @property
    def _references(self) -> Path:
        return self.folder / "references.npz"

    def _refer(self) -> None:
        trainer = self.trainer
        if self._references.is_file() or not isinstance(trainer, ReferenceTrainer):
            return
        rows, n = trainer.reference_rows(self.space.contexts, self._evaluation_seeds), self.space.n
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
        entries = []
        for piece in pieces:
            arrays = read_npz(piece.path)
            if key == "evaluated":  # of older pieces: where they were trained
                key = key if key in arrays else "origin"
            if key not in arrays:
                raise StorageError(
                    f"{piece.path} was written by an older version, which kept no episodes; remove "
                    "the pieces of this folder and run the same command again"
                )
            entries.append(arrays[key])
        return entries


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
    with worker_pool(workers) as pool:
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
