"""A piece of a transfer matrix: some sources are trained, and their policies run on every target.

Policies are kept beside the pieces, where their trainer can save them, with a note on where they
were trained: they can be evaluated again, and nothing is trained.

Notation (shapes): N contexts, P sources of a piece, E episodes, L lengths of training.
"""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from mbtl.arrays import Array
from mbtl.benchmark.npz import read_npz, read_text, text_array, write_npz
from mbtl.checkpoints import Along
from mbtl.contexts import Context
from mbtl.errors import StudyError, cannot_write
from mbtl.files import whole_file
from mbtl.provenance import here
from mbtl.trainer import ManyTrainer, Progress, Trainer, checked_returns

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
        along: rows along the trainings, if any. Their policies are not kept.
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
    along: Along | None = None

    @property
    def checkpoints(self) -> tuple[str, ...]:
        """All that its trainings must leave behind."""
        more = self.along.names.values() if self.along else ()
        return tuple(dict.fromkeys([*self.keep, *(name for names in more for name in names)]))

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
        policies, lasted = _train(piece)
        note: dict[str, Any] = {
            "origin": here(), "seconds": time.perf_counter() - begin, "lasted": lasted
        }  # fmt: skip
        _write_note(piece, note)
    else:
        note = _read_note(piece)
    arrays: dict[str, Any] = {
        f"{checkpoint}_returns": _evaluate(piece, policies[checkpoint]).astype(np.float32)
        for checkpoint in piece.keep
    }
    if piece.along:
        arrays["along_returns"] = _along(piece, piece.along, policies).astype(np.float32)
        arrays["lasted"] = np.array(note["lasted"])
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


def _train(piece: Piece) -> tuple[Policies, list[list[int]]]:
    """Policies, and of each training: done, planned, and of one update; in steps or episodes."""
    if not piece.train:
        raise StudyError(
            f"evaluating again needs the policy of every source, got none of source "
            f"{piece.sources[0]} in {piece.policies}; build without --evaluate-again"
        )
    trainer = piece.trainer
    lasted = [0, 0]

    def on_progress(progress: Progress) -> None:
        lasted[:] = progress.step, progress.total

    if isinstance(trainer, ManyTrainer):
        policies: Policies = trainer.train_many(
            piece.contexts,
            piece.seeds,
            keep=piece.checkpoints,
            state=_partial(piece),
            on_progress=on_progress,
        )
    else:
        pairs = zip(piece.contexts, piece.seeds, strict=True)
        policies = {ONLY: [trainer.train([dict(context)], seed).policy for context, seed in pairs]}
    for checkpoint in piece.keep:
        for source, policy in zip(piece.sources, policies[checkpoint], strict=True):
            _keep(trainer, policy, piece.policy_folder(checkpoint, source))
    lasted.append(getattr(trainer, "update_length", 1))
    return policies, [lasted] * len(piece.sources)


def _keep(trainer: Any, policy: Any, place: Path) -> None:
    """Save a policy into a folder that appears whole; trainers that cannot save keep none."""
    save = getattr(trainer, "save", None)
    if save is None:
        return
    partial = place.with_name(f".{place.name}.partial")
    try:
        shutil.rmtree(partial, ignore_errors=True)
        partial.mkdir(parents=True)
        if save(policy, partial):
            shutil.rmtree(place, ignore_errors=True)
            partial.rename(place)
        else:
            partial.rmdir()
    except OSError as error:
        raise cannot_write(place, error) from error


def _write_note(piece: Piece, note: Mapping[str, Any]) -> None:
    """Beside the policies, if they were kept."""
    if piece.policies.is_dir():
        with whole_file(piece.note) as file:
            file.write(json.dumps(note).encode())


def _read_note(piece: Piece) -> dict[str, Any]:
    """Of kept policies; older ones have it in the rows that were first made with them."""
    first = piece.policies.parent / piece.path.name
    if piece.note.is_file():
        note: dict[str, Any] = json.loads(piece.note.read_text(encoding="utf-8"))
        return note
    if first.is_file():
        arrays = read_npz(first)
        seconds = float(arrays.get("train_seconds", np.nan))
        return {"origin": read_text(arrays["origin"], "origin"), "seconds": seconds}
    return {"origin": {}, "seconds": 0.0}


def _kept(piece: Piece) -> Policies | None:
    """The policies of a piece, if all were kept."""
    folders = {c: [piece.policy_folder(c, s) for s in piece.sources] for c in piece.checkpoints}
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


def _along(piece: Piece, along: Along, policies: Policies) -> Array:
    """(2, L, P, N, E) returns of the rows along the trainings; equal policies play once."""
    trainer = replace(piece.trainer, eval_episodes=along.episodes)  # type: ignore[type-var]
    few = replace(piece, trainer=trainer)
    distinct: dict[bytes, Any] = {}
    names: list[list[list[bytes]]] = []
    for kind in along.names.values():
        names.append([])
        for checkpoint in kind:
            some = policies[checkpoint]
            keys = [b"".join(x.tobytes() for x in (*p.weights, *p.biases)) for p in some]
            distinct |= dict(zip(keys, some, strict=True))
            names[-1].append(keys)
    rows = dict(zip(distinct, _evaluate(few, list(distinct.values())), strict=True))
    return np.array([[[rows[key] for key in keys] for keys in kind] for kind in names])
