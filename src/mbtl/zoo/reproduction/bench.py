"""What a reproduction works on: the matrices there are, replayed once."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np

from mbtl.arrays import Array
from mbtl.errors import unknown_name
from mbtl.files import whole_file
from mbtl.objective import k_star
from mbtl.version import __version__
from mbtl.zoo.benchmark.compare import compare, default_selectors
from mbtl.zoo.benchmark.matrix import TransferMatrix
from mbtl.zoo.benchmark.multitask import MultiTask, load_multitask
from mbtl.zoo.benchmark.oracle import reference
from mbtl.zoo.benchmark.shipped import DEFAULT, data_folder, load_matrix, matrix_id, seed_files
from mbtl.zoo.benchmark.transfers import FOLDER, TransferData, load_transfers, transfer_ids
from mbtl.zoo.reproduction.paper import Published, Value, published

# ---- one CMDP replayed: every curve, level and pick that the items of the paper need ---------
#
# Notation (shapes): S matrix seeds, K trainings, M sources, N targets. All values are performance;
# where a matrix has two halves of its episodes, they are of the half that chose nothing.


OWN = ("ppo", "trpo", "dqn")
"""Multi-task baselines that stand in the paper's column: a CMDP has the one of its algorithm."""

SEARCHED = 100
"""Trainings until which k* is looked for, all of every CMDP of the paper."""

SELECTORS = ("greedy", "mbtl", "mbtl-ei", "mbtl-release", "specialists")
"""Replayed on every matrix; greedy needs one axis."""


@dataclass(frozen=True)
class Case:
    """What was replayed on the matrix of one CMDP.

    Attributes:
        cmdp: CMDP id.
        variant: set of matrices.
        n: contexts N.
        n_sources: contexts trained on, M.
        n_seeds: matrix seeds S.
        apart: whether values are of episodes that chose nothing.
        theta: slope of the linear gap, performance per grid step.
        axis: name, label and (N,) values of its (first) axis.
        curves: selector -> (S, K) V; also "random" (its exact expectation) and
            "sequential_oracle".
        picks: selector -> per seed its K sources; also "sequential_oracle".
        far: (S, min(M, SEARCHED)) V of MBTL.
        levels: "independent", "oracle_transfer" and "grand_mean" (one random policy) -> (S,).
        references: reference rows by name -> (S,); see `mbtl.zoo.benchmark.oracle`.
        multitask: every multi-task baseline of the same problem -> (S',).
        one_policy: units -> (S,) of one training on all contexts that went on, up to K units.
        caveat: what must be said beside these values.
    """

    cmdp: str
    variant: str
    n: int
    n_sources: int
    n_seeds: int
    apart: bool
    theta: float
    axis: Mapping[str, Any]
    curves: Mapping[str, Array]
    picks: Mapping[str, list[list[int]]]
    far: Array
    levels: Mapping[str, Array]
    references: Mapping[str, Array]
    multitask: Mapping[str, Array]
    one_policy: Mapping[float, Array]
    caveat: str | None

    @property
    def own(self) -> Array | None:
        """(S',) the multi-task baseline of the CMDP's own algorithm, if there is one."""
        return next((self.multitask[name] for name in OWN if name in self.multitask), None)

    @property
    def per_seed(self) -> dict[str, Array]:
        """Values at K by method of the paper's table; what is missing is not there."""
        curves = {"random": "random", "greedy": "greedy", "mbtl": "mbtl",
                  "sequential_oracle": "sequential_oracle"}  # fmt: skip
        found = {m: self.curves[c][:, -1] for m, c in curves.items() if c in self.curves}
        found["independent"] = self.levels["independent"]
        found["oracle_transfer"] = self.levels["oracle_transfer"]
        if self.own is not None:
            found["multitask"] = self.own
        if self.one_policy:
            found["one_policy"] = self.one_policy[max(self.one_policy)]
        return found

    @property
    def values(self) -> dict[str, Value]:
        """The same as means and deviations."""
        return {method: Value.of(seeds) for method, seeds in self.per_seed.items()}

    @property
    def target_levels(self) -> Array:
        """(S,) the better of Independent and Multi-task, which k* is about.

        Of each seed its own, since seeds differ in their evaluation episodes; of a baseline with
        another number of seeds the mean.
        """
        independent = self.levels["independent"]
        if self.own is None:
            return independent
        own = self.own if len(self.own) == self.n_seeds else np.full(self.n_seeds, self.own.mean())
        return np.maximum(independent, own)

    @property
    def k_star(self) -> tuple[int | None, ...]:
        """Per seed, trainings until MBTL reaches its level; None: not among those replayed."""
        return self.stars_of(self.far)

    def stars_of(self, curves: Array) -> tuple[int | None, ...]:
        """Likewise of other curves, (S, K)."""
        pairs = zip(curves, self.target_levels, strict=True)
        return tuple(k_star(curve, float(level)) for curve, level in pairs)

    def share(self, values: Array) -> Array:
        """Values on the scale from one random policy (0) to all policies (1), per seed.

        Args:
            values: (S,) or (S, K).
        """
        low, high = self.levels["grand_mean"], self.levels["oracle_transfer"]
        if values.ndim == 2:
            low, high = low[:, None], high[:, None]
        return np.asarray((values - low) / np.maximum(high - low, 1e-12))


def case_of(
    cmdp: str,
    variant: str,
    matrix: TransferMatrix,
    baselines: Mapping[str, MultiTask],
    budget: int,
    transfers: TransferData | None = None,
) -> Case:
    """Replay all selectors on a matrix.

    Args:
        cmdp: CMDP id.
        variant: set of matrices.
        matrix: of that set.
        baselines: multi-task baselines of the CMDP; those of another problem are left out.
        budget: trainings K; at most M are done.
        transfers: trainings of every kind, if there are; likewise.
    """
    m = len(matrix.problem(1).sources)
    k = min(budget, m)
    known = [reference(matrix, seed, k) for seed in range(matrix.n_seeds)]
    able = default_selectors([matrix])
    curves = {
        "random": np.array([one.random for one in known]),
        "sequential_oracle": np.array([one.oracle.curve for one in known]),
    }
    picks = {"sequential_oracle": [list(map(int, one.oracle.sources)) for one in known]}
    far = min(m, SEARCHED)
    for name in SELECTORS:
        if name not in able:
            continue
        runs = compare([name], [matrix], max(far, k) if name == "mbtl" else k, 1).results
        rows = np.array([run.performance for run in runs])
        if name == "mbtl":  # its picks do not depend on the budget
            longest, rows = rows, rows[:, :k]
        curves[name] = rows
        picks[name] = [[int(source) for source in run.sources[:k]] for run in runs]
    weights = matrix.problem(1).weights
    axis = matrix.space.axes[0]
    return Case(
        cmdp,
        variant,
        matrix.n,
        m,
        matrix.n_seeds,
        matrix.measures_apart,
        matrix.theta,
        {
            "name": axis.name,
            "label": axis.label,
            "values": [float(v) for v in matrix.space.values(axis.name)],
        },
        curves,
        picks,
        longest,
        {
            level: np.array([getattr(one.levels, level) for one in known])
            for level in ("independent", "oracle_transfer", "grand_mean")
        },
        {name: np.array([one.rows[name] for one in known]) for name in known[0].rows},
        {
            name: matrix.bounds.normalise(found.returns) @ weights
            for name, found in sorted(baselines.items())
            if same_problem(found, matrix, variant)
        },
        {}
        if transfers is None or not same_problem(transfers, matrix, variant)
        else {
            units: transfers.bounds.normalise(rows[:, 1]) @ weights
            for units, rows in transfers.generalists.items()
            if units <= budget
        },
        matrix.caveat,
    )


def same_problem(baseline: MultiTask | TransferData, matrix: TransferMatrix, variant: str) -> bool:
    """Whether both were trained with the same switches, in the same simulator of the same version.

    So they have the same score: signals and eco-driving have several.

    Where policies see no context by default, one for all contexts is told which one it is in.
    """
    records = (baseline.provenance[0], matrix.provenance["seeds"][0])
    versions = {record["version"] for record in records if "version" in record}
    if len(versions) > 1:
        return False
    one, other = (record.get("switches") for record in records)
    if one is None or other is None:
        return True
    if other.get("visibility") == "hidden" and "hidden" not in variant:
        one = {**one, "visibility": "hidden"}
    return bool(one == other)


# ---- the whole -------------------------------------------------------------------------------


Says = Callable[[str], None]


@dataclass(frozen=True)
class Setting:
    """Which CMDPs, which matrices, how many trainings.

    Attributes:
        cmdps: ids; None: all 22 of the paper.
        budget: trainings K.
        variant: set of matrices.
        folder: of matrices, instead of those that are shipped.
    """

    cmdps: tuple[str, ...] | None = None
    budget: int = 15
    variant: str = DEFAULT
    folder: Path | None = None

    def to_json(self) -> dict[str, Any]:
        """JSON-able record."""
        return {
            "cmdps": None if self.cmdps is None else list(self.cmdps),
            "budget": self.budget,
            "variant": self.variant,
            "folder": None if self.folder is None else str(self.folder),
        }


@dataclass
class Bench:
    """Matrices and their replays.

    Attributes:
        setting: what is asked for.
        says: told what is being done, for a progress display.
    """

    setting: Setting = field(default_factory=Setting)
    says: Says = lambda text: None
    _cases: dict[str, Case] = field(default_factory=dict)

    def __post_init__(self) -> None:
        known = [*self.paper, *self._there]
        for id in self.setting.cmdps or ():
            if matrix_id(id, self.setting.variant) not in known and id not in known:
                raise unknown_name("CMDP of the paper or transfer matrix", id, known)

    @cached_property
    def paper(self) -> Mapping[str, Published]:
        """The published lines, in the paper's order."""
        return published()

    @property
    def ids(self) -> list[str]:
        """CMDPs asked for, whether there are matrices or not."""
        return list(self.paper if self.setting.cmdps is None else self.setting.cmdps)

    @property
    def missing(self) -> list[str]:
        """Those of them without a matrix."""
        return [id for id in self.ids if not self.has(id)]

    def has(self, id: str, variant: str | None = None) -> bool:
        """Whether there is a matrix."""
        return matrix_id(id, variant or self.setting.variant) in self._there

    def available(self, prefix: str = "") -> list[str]:
        """CMDPs asked for of which there are matrices and whose ids begin so."""
        return [id for id in self.ids if id.startswith(prefix) and self.has(id)]

    def matrix(self, id: str, variant: str | None = None) -> TransferMatrix:
        """A matrix that there is."""
        return load_matrix(id, variant or self.setting.variant, folder=self.setting.folder)

    def case(self, id: str, variant: str | None = None) -> Case:
        """Its replay."""
        variant = variant or self.setting.variant
        key = matrix_id(id, variant)
        if key not in self._cases:
            self.says(f"replaying selectors on {key}")
            self._cases[key] = case_of(
                id,
                variant,
                self.matrix(id, variant),
                load_multitask(id, folder=self._baselines),
                self.setting.budget,
                self._transfers(id) if variant == DEFAULT else None,
            )
        return self._cases[key]

    def cases(self, prefix: str = "") -> dict[str, Case]:
        """Replays of all that are available, in the paper's order."""
        return {id: self.case(id) for id in self.available(prefix)}

    def signature(
        self, prefixes: Sequence[str] = ("",), variants: Iterable[str] = (), *, code: bool = True
    ) -> str:
        """Changes if anything does that results on these CMDPs depend on; or their data alone."""
        ids = [id for id in self.ids if id.startswith(tuple(prefixes))]
        names = [matrix_id(id, v) for id in ids for v in (self.setting.variant, *variants)]
        parts = [__version__, _code()] if code else []
        parts += [str(self.setting.budget), self.setting.variant, *ids]
        parts += [self.fingerprint(name) for name in names]
        for place in (self._baselines, self._place / FOLDER):
            parts += [_hash(sorted(place.glob(f"{id}-*.npz"))) for id in ids]
        return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:16]

    def fingerprint(self, name: str) -> str:
        """Of the files of a matrix; empty if there are none."""
        return _hash(list(self._there[name].values())) if name in self._there else ""

    # ---- inside ----------------------------------------------------------------------------------

    @cached_property
    def _there(self) -> dict[str, dict[int, Path]]:
        return seed_files(self._place)

    @property
    def _place(self) -> Path:
        return self.setting.folder or data_folder()

    def _transfers(self, id: str) -> TransferData | None:
        place = self._place / FOLDER
        return load_transfers(id, folder=place) if id in transfer_ids(place) else None

    @property
    def _baselines(self) -> Path:
        return self._place / "multitask"


def read_record(file: Path) -> dict[str, Any] | None:
    """A JSON object of ours; None if there is none that can be read."""
    try:
        record = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return record if isinstance(record, dict) else None


def write_record(file: Path, record: Mapping[str, Any]) -> None:
    """A JSON object, whole or not at all."""
    file.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(file) as writing:
        writing.write(json.dumps(record, allow_nan=False).encode())


def _hash(files: Sequence[Path]) -> str:
    found = hashlib.sha256()
    for file in files:
        found.update(file.name.encode())
        found.update(file.read_bytes())
    return found.hexdigest()[:16]


@cache
def _code() -> str:
    """Of the code that makes these numbers, so that a developer is not shown old ones."""
    package = Path(__file__).parents[2]
    parts = ("zoo/reproduction", "zoo/benchmark", "selectors", "models", "acquisition")
    return _hash([file for part in parts for file in sorted((package / part).rglob("*.py"))])
