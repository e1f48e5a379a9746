"""Transfer curves: the rows of policies along their trainings, J[seed, length, source, target].

Of every training there are two policies at each of L lengths: the best one so far, and the latest.
With them selectors are compared that decide how long to train.

Notation (shapes): S seeds, L lengths, N contexts, H = 2 halves of the episodes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from mbtl.contexts import ContextSpace
from mbtl.errors import InvalidInput, StorageError, unknown_name
from mbtl.objective import Bounds
from mbtl.plain import LARGEST, refused
from mbtl.zoo.benchmark.matrix import (
    Floats,
    TransferMatrix,
    halves,
    is_entry,
    keywords,
    same_sources,
)
from mbtl.zoo.benchmark.npz import read_npz, write_npz
from mbtl.zoo.benchmark.shipped import DEFAULT, data_folder, matrix_id, seed_files

Kind = Literal["best", "last"]
"""Which policy of a training at a length: the best so far on its own context, or the latest."""

FOLDER = "curves"
_ROWS = ("best_returns", "best_fresh_returns", "last_returns", "last_fresh_returns")
_OWN = ("lengths", "steps", "unit", *_ROWS)


@dataclass(frozen=True, eq=False, repr=False)
class TransferCurves:
    """Every policy along every training on every target.

        curves = mbtl.zoo.benchmark.load_curves("pendulum-length")
        short = curves.matrix(2)                    # a `TransferMatrix` after T/16
        curves.lengths, curves.steps                # what the trainings cost

    Attributes:
        name: what results call it.
        lengths: (L,) environment steps of a training (of some problems: episodes), rising; the last
            is T.
        steps: (S, L, M) how many of them were done: fewer where a training ended early, because
            nothing was left to gain on its own context.
        returns: kind -> (S, L, H, M, N) raw returns, axes (seed, length, half, source, target).
        episodes: (H,) behind an entry of each half.
        space: the N contexts.
        bounds: return -> performance.
        theta: slope of the linear gap, performance per grid step.
        unit: of `lengths`, "steps" or "episodes".
        provenance: how it was made.
        sources: (M,) contexts that were trained on; None: all N.
    """

    name: str
    lengths: NDArray[np.int64]
    steps: NDArray[np.int64]
    returns: Mapping[Kind, Floats]
    episodes: tuple[int, ...]
    space: ContextSpace
    bounds: Bounds
    theta: float
    unit: str = "steps"
    provenance: Mapping[str, Any] = field(default_factory=dict)
    sources: NDArray[np.intp] | None = None

    def __repr__(self) -> str:
        seeds, _, m = self.steps.shape
        lengths = ", ".join(f"{length:,}" for length in self.lengths)
        size = f"{seeds} seed{'s' * (seeds > 1)}, {m} sources x {self.space.n} targets"
        return f"TransferCurves({self.name!r}: {size}, after {lengths} {self.unit})"

    def __post_init__(self) -> None:
        n, lengths = self.space.n, np.asarray(self.lengths)
        m = n if self.sources is None else len(self.sources)
        if lengths.ndim != 1 or not len(lengths) or (np.diff(lengths) <= 0).any() or lengths[0] < 1:
            raise InvalidInput(f"lengths must be whole numbers >= 1 that rise, got {lengths}")
        n_seeds = len(self.steps)
        if np.shape(self.steps) != (n_seeds, len(lengths), m):
            raise InvalidInput(
                f"steps must have shape (seed, length, source) {(n_seeds, len(lengths), m)}, got "
                f"{np.shape(self.steps)}"
            )
        shape = (n_seeds, len(lengths), 2, m, n)
        for kind in get_args(Kind):
            got = self.returns[kind].shape if kind in self.returns else None
            if got != shape or refused(self.returns[kind]).any():
                raise InvalidInput(
                    f"returns of the {kind} policies must be finite, within {LARGEST:g}, of shape "
                    f"(seed, length, half, source, target) {shape}, got {got}"
                )

    @classmethod
    def of_episodes(
        cls, returns: Floats, lasted: NDArray[np.int64], lengths: Sequence[int], **entries: Any
    ) -> TransferCurves:
        """One seed from single episodes.

        Args:
            returns: (2, L, M, N, E) of the best and the latest policies.
            lasted: (M,) steps that each training took.
            lengths: (L,) steps at which its policies were kept, unless it ended before.
            **entries: the other attributes.
        """
        means, count = halves(returns)
        if len(means) < 2:
            raise InvalidInput("rows along a training need two episodes or more, got one")
        both = np.stack(means, axis=2)[:, None]  # (2, 1, L, H, M, N)
        steps = np.minimum(np.asarray(lengths)[:, None], lasted)[None]
        return cls(
            lengths=np.asarray(lengths),
            steps=steps,
            returns={"best": both[0], "last": both[1]},
            episodes=count,
            **entries,
        )

    @property
    def n_seeds(self) -> int:
        """Number of seeds S."""
        return len(self.steps)

    def matrix(self, length: int, kind: Kind = "best") -> TransferMatrix:
        """The transfer matrix of trainings of one length.

        Args:
            length: index into `lengths`.
            kind: which policies.

        Raises:
            InvalidInput: there is no such length.
            UnknownName: no such kind.
        """
        if kind not in self.returns:
            raise unknown_name("kind of policy", kind, self.returns)
        if not -len(self.lengths) <= length < len(self.lengths):
            raise InvalidInput(f"length is an index of {len(self.lengths)} lengths, got {length}")
        rows = self.returns[kind][:, length].astype(np.float32)
        return TransferMatrix(
            name=f"{self.name} after {self.lengths[length]} {self.unit} ({kind})",
            returns=rows[:, 0],
            fresh_returns=rows[:, 1],
            episodes=self.episodes,
            space=self.space,
            bounds=self.bounds,
            theta=self.theta,
            provenance=self.provenance,
            sources=self.sources,
        )

    def save(self, path: str | Path) -> None:
        """Write a `.npz` file that `load` reads back.

        Returns are stored as float16, whose error, 1 in 2,000, is far below that of their episodes.

        Raises:
            StorageError: the place cannot be written.
        """
        entries = self.matrix(-1).arrays()
        del entries["returns"], entries["fresh_returns"]
        for kind, rows in self.returns.items():
            for half, name in enumerate((f"{kind}_returns", f"{kind}_fresh_returns")):
                entries[name] = rows[:, :, half].astype(np.float16)
        entries |= {
            "lengths": np.asarray(self.lengths),
            "steps": np.asarray(self.steps),
            "unit": np.array(self.unit),
        }
        write_npz(Path(path), entries)

    @classmethod
    def load(cls, path: str | Path, *, name: str | None = None) -> TransferCurves:
        """Read what `save` wrote.

        Raises:
            InvalidInput: the file cannot be read or breaks a rule; the message names file and rule.
        """
        file = Path(path)
        arrays = read_npz(file, lambda name: is_entry(name) or name in _OWN)
        missing = {"lengths", "steps", "episodes", *_ROWS} - set(arrays)
        if missing:
            raise InvalidInput(f"{file}: transfer curves need {sorted(missing)}, which is missing")
        best, fresh, last, last_fresh = (arrays[key] for key in _ROWS)
        try:
            if best.ndim != 4 or not best.shape == fresh.shape == last.shape == last_fresh.shape:
                raise InvalidInput(
                    "returns must have shape (seed, length, source, target), the same for all "
                    f"four, got {[arrays[key].shape for key in _ROWS]}"
                )
            words = keywords({**arrays, "returns": best[:, -1], "fresh_returns": fresh[:, -1]})
            end = TransferMatrix.of(**words)
            return cls(
                name=name or str(path),
                lengths=arrays["lengths"],
                steps=arrays["steps"],
                returns={
                    "best": np.stack([best, fresh], axis=2),
                    "last": np.stack([last, last_fresh], axis=2),
                },
                episodes=end.episodes or (),
                space=end.space,
                bounds=end.bounds,
                theta=end.theta,
                unit=str(arrays.get("unit", "steps")),
                provenance=end.provenance,
                sources=end.sources,
            )
        except InvalidInput as error:
            raise InvalidInput(f"{file}: {error}") from error


def load_curves(
    cmdp: str, variant: str = DEFAULT, *, folder: str | Path | None = None
) -> TransferCurves:
    """Shipped transfer curves, their seed files stacked.

    Args:
        cmdp: CMDP id, e.g. "pendulum-length".
        variant: recipe, e.g. "hidden".
        folder: where to look instead of the package data, e.g. `matrices/curves`.

    Raises:
        UnknownName: there are none.
        StorageError: their files do not fit together.
    """
    place = data_folder() / FOLDER if folder is None else Path(folder)
    files, name = seed_files(place), matrix_id(cmdp, variant)
    if name not in files:
        hint = f"Known: {', '.join(sorted(files))}." if files else f"{place.name} holds none."
        raise unknown_name("transfer curves", name, files, hint=hint)
    parts = [TransferCurves.load(file, name=name) for _, file in sorted(files[name].items())]
    first = parts[0]
    for part in parts[1:]:
        same = (part.space, part.bounds, part.theta, part.episodes, part.unit) == (
            first.space, first.bounds, first.theta, first.episodes, first.unit,
        ) and np.array_equal(part.lengths, first.lengths)  # fmt: skip
        same &= same_sources(part.sources, first.sources)
        if not same:
            raise StorageError(
                f"the curves of {name!r} must agree on contexts, scale, lengths and episodes, and "
                "one of their files does not; build it again"
            )
    return replace(
        first,
        steps=np.concatenate([part.steps for part in parts]),
        returns={
            kind: np.concatenate([part.returns[kind] for part in parts]) for kind in get_args(Kind)
        },
        provenance={"seeds": [dict(part.provenance) for part in parts]},
    )
