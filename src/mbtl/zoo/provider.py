"""What the laboratory gives the tool: see `mbtl.provider`.

Nothing of it is imported before it is asked for.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mbtl.problems.cmdp import CMDP
    from mbtl.report.reference import ReferenceCurves
    from mbtl.report.subject import Subject
    from mbtl.study import Study

names: Mapping[str, str] = {
    "TransferMatrix": "mbtl.zoo.benchmark.matrix:TransferMatrix",
    "compare": "mbtl.zoo.benchmark.compare:compare",
    "load_matrix": "mbtl.zoo.benchmark.shipped:load_matrix",
    "load_transfers": "mbtl.zoo.benchmark.transfers:load_transfers",
}

commands: Mapping[str, str] = {
    "cmdps": "mbtl.zoo.cli.cmdps:cmdps",
    "play": "mbtl.zoo.cli.play:play",
    "matrix": "mbtl.zoo.cli.matrix:matrix_app",
    "bench": "mbtl.zoo.cli.bench:bench",
    "reproduce": "mbtl.zoo.cli.reproduce:reproduce_command",
}


def ids() -> Sequence[str]:
    """Ids of our CMDPs."""
    from mbtl.zoo.cmdps import cmdp_ids

    return cmdp_ids()


def get(id: str, **switches: Any) -> CMDP:
    """One of them (`mbtl.zoo.cmdps.get_cmdp`)."""
    from mbtl.zoo.cmdps import get_cmdp

    return get_cmdp(id, **switches)


def subjects() -> Sequence[str]:
    """Ids of the shipped matrices."""
    from mbtl.zoo.benchmark.shipped import shipped_matrices

    return shipped_matrices()


def subject(given: str, *, selector: str, budget: int, seed: int) -> Subject | None:
    """A selector replayed on a matrix, a file or a shipped one."""
    path = Path(given)
    if path.suffix == ".npz" or (given in subjects() and not path.exists()):
        from mbtl.zoo.benchmark.subject import of_file

        return of_file(given, selector, budget=budget, seed=seed)
    if path.is_dir() and not (path / "study.db").exists() and any(path.glob("*.npz")):
        from mbtl.zoo.benchmark.npz import a_folder

        raise a_folder(path)
    return None


def curves(study: Study) -> ReferenceCurves | None:
    """Other methods on a shipped matrix whose recipe is this study's, where there is one."""
    from mbtl.zoo.benchmark.subject import reference_curves

    return reference_curves(study)
