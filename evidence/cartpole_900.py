"""CartPole with 900 contexts (both masses, pole length) beside SD-MBTL's table of it.

The peer is the publication (AAAI 2026, arXiv 2601.08120): V after 12 trainings, and the mean of V
over the first 15 (printed there as 12). Returns are scaled as there, by the smallest and largest
over all seeds. Policies are trained otherwise than theirs (docs/cartpole-900.md says how), so what
can be compared is the order of the methods and the score (V - Random) / (oracle - Random), not V.

Random is its exact expectation; published is one order per trial. The oracle is each seed's own
greedy order; theirs is one order for all trials. `auto` has the prior fitted without CartPole.

example: python evidence/cartpole_900.py --write
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import measure
import numpy as np
import pages
from measure import cost_of, digits

from mbtl.arrays import Array
from mbtl.objective import Bounds
from mbtl.zoo.benchmark import TransferMatrix, compare, load_matrix
from mbtl.zoo.benchmark.comparison import Comparison, Trainings
from mbtl.zoo.benchmark.oracle import sequential_oracle

CMDP = "cartpole-masses-length"
RANDOM, ORACLE, INDEPENDENT = "random", "oracle", "independent"
SELECTORS = (RANDOM, "mbtl", "gp-mbtl", "m-mbtl", "sd-mbtl", "specialists", ORACLE)
METHODS = (INDEPENDENT, *SELECTORS)
NAMES = {
    INDEPENDENT: "Independent", RANDOM: "Random", "mbtl": "MBTL", "gp-mbtl": "GP-MBTL",
    "m-mbtl": "M-MBTL", "sd-mbtl": "M/GP-MBTL", "specialists": "`auto`", ORACLE: "oracle",
}  # fmt: skip
K_TABLE, K_CURVE, BUDGET = 12, 15, 30
SHOWN = (1, 2, 3, 4, 6, K_TABLE, K_CURVE, BUDGET)

PUBLISHED: Mapping[str, Mapping[str, float]] = {
    f"V at K = {K_TABLE}": {
        INDEPENDENT: 0.9346, RANDOM: 0.9861, "gp-mbtl": 0.9919, "m-mbtl": 0.9896,
        "sd-mbtl": 0.9898, ORACLE: 0.9998,
    },
    f"mean V, k = 1 to {K_CURVE}": {
        INDEPENDENT: 0.9346, RANDOM: 0.9502, "gp-mbtl": 0.9542, "m-mbtl": 0.9612,
        "sd-mbtl": 0.9612, ORACLE: 0.9939,
    },
}  # fmt: skip
STATISTICS: Mapping[str, Callable[[Array], Array]] = {  # of (S, K) curves, (S,)
    f"V at K = {K_TABLE}": lambda v: v[:, K_TABLE - 1],
    f"mean V, k = 1 to {K_CURVE}": lambda v: v[:, :K_CURVE].mean(axis=1),
}


def scaled(matrix: TransferMatrix) -> TransferMatrix:
    """Performance 0 and 1 at the smallest and largest return of all seeds."""
    return replace(matrix, bounds=Bounds.of(matrix.returns, matrix.bounds.direction))


def curves(comparison: Comparison, matrix: TransferMatrix) -> dict[str, Array]:
    """(S, K) V of every selector; Independent is level, Random the same mean for all seeds."""
    found = {
        name: np.array([r.performance for r in comparison.results if r.selector == name])
        for name in SELECTORS
    }
    exact = comparison.summary.matrices[matrix.name].random
    found[RANDOM] = np.tile(exact, (matrix.n_seeds, 1))
    found[INDEPENDENT] = np.tile(matrix.independent[:, None], (1, BUDGET))
    return found


def scores(values: Mapping[str, float]) -> dict[str, float]:
    """0 at Random, 1 at the oracle."""
    low, high = values[RANDOM], values[ORACLE]
    return {n: (v - low) / (high - low) for n, v in values.items() if n != INDEPENDENT}


def structure(matrix: TransferMatrix) -> dict[str, Any]:
    """What decides the entries of the first seed: source, target, their axes, or luck."""
    rows, shape = matrix.performance(0), matrix.space.shape or ()
    source, target = rows.mean(axis=1), rows.mean(axis=0)
    whole = float(rows.var())
    grids = {"source": source.reshape(shape), "target": target.reshape(shape)}
    near = [np.abs(np.diff(grids["source"], axis=q)).mean() for q in range(len(shape))]
    apart = np.abs(source[:, None] - source)[~np.eye(matrix.n, dtype=bool)]
    return {
        "all served": int((source >= 0.9999).sum()),
        "own below": int((np.diag(rows) < 0.98).sum()),
        "full pairs": float((rows >= 1.0).mean()),
        "share of sources": float(source.var()) / whole,
        "share of targets": float(target.var()) / whole,
        "neighbours": float(np.mean(near)),
        "strangers": float(apart.mean()),
        "axes": {
            axis.name: {
                kind: grid.mean(axis=tuple({*range(len(shape))} - {q})).tolist()
                for kind, grid in grids.items()
            }
            for q, axis in enumerate(matrix.axes)
        },
    }


def lines_of_structure(found: Mapping[str, Any]) -> list[str]:
    """A paragraph, and mean performance along each axis."""
    lines = [
        f"First seed: {found['all served']} policies have 0.9999 or more on average, "
        f"{found['own below']} less than 0.98 at home; {found['full pairs']:.0%} of the pairs are "
        f"full. Of the variance, {found['share of sources']:.0%} is that of the sources' means and "
        f"{found['share of targets']:.0%} that of the targets'. The means of two sources differ by "
        f"{found['neighbours']:.3f} if they are neighbours on the grid, by "
        f"{found['strangers']:.3f} if drawn at random.",
        "",
        "| mean along an axis, smallest value first | |",
        "|---|---|",
    ]
    for axis, kinds in found["axes"].items():
        for kind, means in kinds.items():
            lines.append(f"| {axis}, as {kind} | {' '.join(f'{mean:.2f}' for mean in means)} |")
    return lines


def row(label: str, values: Mapping[str, float], places: int) -> str:
    """One line of a table; a method without a value stays empty."""
    cells = [f"{values[name]:.{places}f}" if name in values else "" for name in METHODS]
    return f"| {' | '.join([label, *cells])} |"


def head(label: str) -> list[str]:
    names = [NAMES[name] for name in METHODS]
    return [f"| {' | '.join([label, *names])} |", "|---" * (len(METHODS) + 1) + "|"]


def trainings(found: Trainings) -> str:
    value = found.estimate.value
    return "-" if value is None else f"{'> ' if found.censored else ''}{value:.1f}"


def lines_of(document: Mapping[str, Any]) -> list[str]:
    """The tables, as markdown."""
    seeds, levels = document["seeds"], document["levels"]
    lines = [
        f"{seeds} seed{'s' * (seeds > 1)}, N = 900. One policy {levels['one policy']:.4f}, "
        f"Independent {levels[INDEPENDENT]:.4f}, Oracle Transfer {levels['Oracle Transfer']:.4f}.",
        "",
        *head("SD-MBTL's statistics"),
    ]
    for label, found in document["statistics"].items():
        lines.append(row(f"{label}, ours", found["ours"], 4))
        lines.append(row("... published", found["published"], 4))
        lines.append(row("... score, ours", scores(found["ours"]), 2))
        lines.append(row("... score, published", scores(found["published"]), 2))
    lines += ["", *head("V after k trainings")]
    for k, found in document["curve"].items():
        lines.append(row(f"k = {k}", found, 4))
    for level, by in document["trainings"].items():
        cells = [by.get(name, "") for name in METHODS]
        lines.append(f"| {' | '.join([f'trainings to {level} %', *cells])} |")
    seconds = document["seconds"]
    return [
        *lines,
        "",
        *lines_of_structure(document["structure"]),
        "",
        f"Reading the matrix takes {seconds['load']:.2f} s of processor time, the oracle with "
        f"K = {BUDGET} {seconds['oracle']:.2f} s per seed.",
    ]


def main() -> None:
    """Run what the arguments ask for."""
    parser = measure.parser(__doc__)
    parser.add_argument("--folder", help="of the matrix files, instead of the shipped ones")
    parser.add_argument("--write", action="store_true", help="docs/appendix/cartpole-900.md")
    args = parser.parse_args()
    load = cost_of(lambda: load_matrix(CMDP, folder=args.folder))
    matrix = scaled(load_matrix(CMDP, folder=args.folder))
    oracle = cost_of(lambda: sequential_oracle(matrix, 0, BUDGET))
    comparison = compare(SELECTORS, [matrix], BUDGET, seeds=1)
    summary = comparison.summary.matrices[matrix.name]
    found = curves(comparison, matrix)
    document = {
        "seeds": matrix.n_seeds,
        "levels": {
            "one policy": summary.grand_mean,
            INDEPENDENT: summary.independent,
            "Oracle Transfer": summary.oracle_transfer,
        },
        "statistics": {
            label: {
                "ours": {name: float(of(v).mean()) for name, v in found.items()},
                "each_seed": {name: of(v).tolist() for name, v in found.items()},
                "published": dict(PUBLISHED[label]),
            }
            for label, of in STATISTICS.items()
        },
        "curve": {k: {name: float(v[:, k - 1].mean()) for name, v in found.items()} for k in SHOWN},
        "trainings": {
            level: {n: trainings(getattr(s, f"k{level}")) for n, s in summary.selectors.items()}
            for level in (90, 95, 99)
        },
        "structure": structure(matrix),
        "seconds": {"load": digits(load.cpu, 2), "oracle": digits(oracle.cpu, 2)},
        "machine": measure.machine(),
    }
    lines = lines_of(document)
    measure.show(document, lines, as_json=args.json)
    if args.write:
        title = "CartPole with 900 contexts: all tables"
        pages.write_appendix("cartpole-900", title, "cartpole-900.md", lines)


if __name__ == "__main__":
    main()
