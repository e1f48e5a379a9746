"""What stands beside the score of a study's policies, so that nobody takes a jam for a success.

A score is one number. Measured with it, over the same contexts by the same weights: throughput, CO2
and stops in traffic, say, of the policies where they serve, and of what goes without them.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mbtl.report.reference import REFERENCE_NAMES
from mbtl.seeds import Purpose
from mbtl.study import Study

FILE = "beside.json"
"""In the folder of a study."""


def measure(
    study: Study,
    trainer: Any,
    units: Mapping[str, str],
    folder: Path,
    say: Callable[[str], None] = lambda words: None,
) -> list[str]:
    """Play the serving policies once more, note what was measured in the folder, and say it.

    Nothing is played where it is known already, where nothing is measured, or where policies are
    missing.

    Args:
        study: with rows and its policies.
        trainer: as of the study; one with `beside` can measure.
        units: of the measures that people need to see, by name.
        folder: of the study.
        say: told what is played, before it is.
    """
    told = len(study.state.rows)
    if not (units and told and hasattr(trainer, "beside")):
        return []
    portfolio = study.portfolio(trainer)
    if _read(folder).get("trainings") != told and not portfolio.policies_missing:
        route, space = study.routing.route, study.space
        served = [np.flatnonzero(route == k) for k in range(told)]
        policies = [portfolio.policy(k) if some.size else None for k, some in enumerate(served)]
        contexts = [[space.context(int(i)) for i in some] for some in served]
        targets = np.concatenate(served)
        say(f"Playing {targets.size} contexts for what stands beside the score")
        seeds, weights = study.evaluation_seeds(targets, Purpose.REPORT), space.weights[targets]
        found = {
            who: {
                n: float(weights @ rows[n].mean(axis=1))
                for n in ("score", *units)
                if n in rows and np.isfinite(rows[n]).all()  # else it is not told
            }
            for who, rows in trainer.beside(policies, contexts, seeds, tuple(units)).items()
        }
        record = {"trainings": told, "units": dict(units), "measures": found}
        (folder / FILE).write_text(json.dumps(record, indent=2), encoding="utf-8")
    return sentences(folder)


def sentences(folder: Path | None) -> list[str]:
    """What was measured, for people; none where nothing was."""
    record = {} if folder is None else _read(folder)
    units: Mapping[str, str] = record.get("units", {})
    return [
        f"{REFERENCE_NAMES.get(who, who)}, mean over the contexts: "
        + ", ".join([f"score {found['score']:.4g}",
                     *(f"{found[n]:.4g} {unit}" for n, unit in units.items() if n in found)])
        for who, found in record.get("measures", {}).items()
    ]  # fmt: skip


def _read(folder: Path) -> dict[str, Any]:
    try:
        record = json.loads((folder / FILE).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return record if isinstance(record, dict) else {}
