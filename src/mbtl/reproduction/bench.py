"""What a reproduction works on: the matrices there are, replayed once and kept on disk."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from pathlib import Path
from typing import Any

from mbtl.benchmark.matrix import TransferMatrix
from mbtl.benchmark.multitask import load_multitask
from mbtl.benchmark.shipped import DEFAULT, data_folder, load_matrix, matrix_id, seed_files
from mbtl.errors import unknown_name
from mbtl.files import whole_file
from mbtl.reproduction.case import Case, case_of
from mbtl.reproduction.paper import Published, published
from mbtl.version import __version__

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
        kept: folder in which replays are kept; None: nowhere.
        says: told what is being done, for a progress display.
    """

    setting: Setting = field(default_factory=Setting)
    kept: Path | None = None
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
        """Its replay, from the disk if nothing it depends on has changed."""
        variant = variant or self.setting.variant
        key = matrix_id(id, variant)
        if key not in self._cases:
            self._cases[key] = self._kept_case(id, variant)
        return self._cases[key]

    def cases(self, prefix: str = "") -> dict[str, Case]:
        """Replays of all that are available, in the paper's order."""
        return {id: self.case(id) for id in self.available(prefix)}

    def signature(self, prefixes: Sequence[str] = ("",), variants: Iterable[str] = ()) -> str:
        """Changes if anything does that results on these CMDPs depend on."""
        ids = [id for id in self.ids if id.startswith(tuple(prefixes))]
        names = [matrix_id(id, v) for id in ids for v in (self.setting.variant, *variants)]
        parts = [__version__, _code(), str(self.setting.budget), self.setting.variant, *ids]
        parts += [self.fingerprint(name) for name in names]
        parts += [_hash(sorted(self._baselines.glob(f"{id}-*.npz"))) for id in ids]
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

    @property
    def _baselines(self) -> Path:
        return self._place / "multitask"

    def _kept_case(self, id: str, variant: str) -> Case:
        name = matrix_id(id, variant)
        baselines = _hash(sorted(self._baselines.glob(f"{id}-*.npz")))
        made_of = [
            __version__,
            _replay_code(),
            self.setting.budget,
            self.fingerprint(name),
            baselines,
        ]
        file = None if self.kept is None else self.kept / f"{name}.json"
        record = None if file is None else read_record(file)
        if record is not None and record.get("made_of") == made_of:
            return Case.from_json(record["case"])
        self.says(f"replaying selectors on {name}")
        found = case_of(
            id,
            variant,
            self.matrix(id, variant),
            load_multitask(id, folder=self._baselines),
            self.setting.budget,
        )
        if file is not None:
            write_record(file, {"made_of": made_of, "case": found.to_json()})
        return found


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
    return _hash([*sorted(Path(__file__).parent.rglob("*.py")), *_replaying()])


@cache
def _replay_code() -> str:
    return _hash([Path(__file__).with_name("case.py"), *_replaying()])


def _replaying() -> list[Path]:
    """The code that replays depend on: selectors and what they are made of, and the benchmark."""
    package = Path(__file__).parents[1]
    parts = ("benchmark", "selectors", "models", "acquisition")
    return [file for part in parts for file in sorted((package / part).rglob("*.py"))]
