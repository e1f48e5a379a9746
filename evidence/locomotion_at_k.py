"""Walkers and cheetahs: what K trainings reach, by three scales, beside what the paper printed.

    python evidence/locomotion_at_k.py [MATRIX ...] [--multitask FOLDER] [--budget 5 15] [--write]

A MATRIX is the id of a shipped one, with all its seeds, or a file. Selectors pick by the scale of
the CMDP. What they reach is the mean return over all targets, on episodes that chose nothing, by
three scales: of the CMDP, of the paper, and from the CMDP's 0 to the best entry. Random is its
exact expectation. Independent is the mean over the contexts that were trained on, each with its own
policy. The last column has what the paper printed for K = 15, of its own policies and by its own
scale. `--write` puts the mean returns of all shipped ones, over their seeds, into
docs/locomotion.md, and below them performance by the paper's scale beside the paper's.

example: python evidence/locomotion_at_k.py cheetah-gravity
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path

import pages

from mbtl.report import REFERENCE_NAMES as NAMES
from mbtl.zoo.benchmark import TransferMatrix, compare, load_matrix
from mbtl.zoo.benchmark.multitask import load_multitask
from mbtl.zoo.cmdps.registry import paper_bounds
from mbtl.zoo.reproduction.paper import HEADS, published

SHIPPED = (
    "walker-gravity", "walker-friction", "walker-scale",
    "cheetah-gravity", "cheetah-friction", "cheetah-stiffness",
)  # fmt: skip

SELECTORS = {
    "random": "Random", "greedy": "Greedy", "mbtl": "MBTL", "specialists": "auto",
    "oracle": "Sequential Oracle",
}  # fmt: skip
ALL_AT_ONCE = "one policy for all"
PRINTED_K = 15
"""Trainings behind the paper's table."""


def problem_of(matrix: TransferMatrix) -> str:
    """Id of its CMDP."""
    return str(matrix.records[0].get("problem", matrix.name))


def levels_of(
    matrix: TransferMatrix, budgets: Sequence[int], folder: Path | None
) -> dict[str, float]:
    """V by the scale of the matrix, by the head of its row; mean over seeds."""
    known = {
        k: compare(list(SELECTORS), [matrix], k).summary.matrices[matrix.name] for k in budgets
    }
    some = known[budgets[0]]
    found = {NAMES.get(name, name): value for name, value in some.references.items()}
    for name, one in load_multitask(problem_of(matrix), folder=folder).items():
        which = name.removeprefix("ppo").strip("-").replace("-", ", ")
        head = f"{ALL_AT_ONCE} ({which})" if which else ALL_AT_ONCE
        found[head] = float(matrix.bounds.normalise(one.returns).mean())
    found[HEADS["independent"]] = some.independent
    for k, summary in known.items():
        for name, head in SELECTORS.items():
            value = summary.selectors[name].V_K.value
            assert value is not None
            found[f"{head}, K = {k}"] = value
    found[HEADS["oracle_transfer"]] = some.oracle_transfer
    return found


def printed_of(id: str) -> dict[str, float]:
    """The paper's values by the heads of `levels_of`."""
    if id not in published():
        return {}
    values = published()[id].values
    heads = {HEADS[name]: value.mean for name, value in values.items()}
    own = {HEADS["independent"]: HEADS["independent"], HEADS["multitask"]: ALL_AT_ONCE}
    return {own.get(head, f"{head}, K = {PRINTED_K}"): value for head, value in heads.items()}


def table(matrix: TransferMatrix, known: Mapping[str, float]) -> list[str]:
    """Lines of Markdown."""
    id, low, high = problem_of(matrix), matrix.bounds.low, matrix.bounds.high
    best = max(float(x.max()) for x in (matrix.returns, matrix.fresh_returns) if x is not None)
    scales = {"ours": (low, high), "paper's": paper_bounds(id) or (low, high),
              "best seen": (low, best)}  # fmt: skip
    heads = " | ".join(f"{name}: {a:g}..{b:.0f}" for name, (a, b) in scales.items())
    trained = matrix.n if matrix.sources is None else len(matrix.sources)
    seeds = "one seed" if matrix.n_seeds == 1 else f"{matrix.n_seeds} seeds"
    printed = printed_of(id)
    lines = [
        f"**{id}**, {seeds}, {trained} of {matrix.n} contexts trained on",
        "",
        f"| | return | {heads} | printed by the paper |",
        "|---|---|---|---|---|---|",
    ]
    for head, value in known.items():
        mean = low + (high - low) * value
        cells = " | ".join(f"{(mean - a) / (b - a):.3f}" for a, b in scales.values())
        there = f"{printed[head]:.3f}" if head in printed else ""
        lines.append(f"| {head} | {mean:.0f} | {cells} | {there} |")
    return lines


def page(ids: Sequence[str], budgets: Sequence[int], folder: Path | None) -> list[str]:
    """Mean returns of all, a line per head, a column per CMDP; then those that the paper has."""
    columns, beside = {}, {}
    for id in ids:
        matrix = load_matrix(id)
        known = {
            head: float(matrix.bounds.denormalise(value))
            for head, value in levels_of(matrix, budgets, folder).items()
        }
        columns[f"{id} ({matrix.n_seeds})"] = known
        low, high = paper_bounds(id) or (matrix.bounds.low, matrix.bounds.high)
        beside[id] = {
            head: f"{(known[head] - low) / (high - low):.2f}, *{value:.2f}*"
            for head, value in printed_of(id).items()
            if head in known
        }
    heads = list(dict.fromkeys(head for column in columns.values() for head in column))
    heads.sort(key=lambda head: (head.startswith(ALL_AT_ONCE), "K = " in head))
    lines = [f"| mean return (seeds) | {' | '.join(columns)} |", "|---|" + "---|" * len(columns)]
    for head in heads:
        cells = [f"{column[head]:.0f}" if head in column else "" for column in columns.values()]
        lines.append(f"| {head} | {' | '.join(cells)} |")
    lines += ["", f"| ours, *the paper's* | {' | '.join(beside)} |", "|---|" + "---|" * len(beside)]
    for head in dict.fromkeys(head for column in beside.values() for head in column):
        lines.append(f"| {head} | {' | '.join(column[head] for column in beside.values())} |")
    return lines


def main() -> None:
    """Print a table per matrix, or write that of all."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("matrices", nargs="*", help="ids, or files .npz; default: all shipped")
    parser.add_argument("--multitask", type=Path, help="folder; default: what is shipped")
    parser.add_argument("--budget", nargs="+", type=int, default=[5, PRINTED_K], help="K")
    parser.add_argument("--write", action="store_true", help="into docs/locomotion.md")
    args = parser.parse_args()
    budgets = sorted(args.budget)
    if args.write:
        pages.fill("locomotion.md", "returns at K", page(SHIPPED, budgets, args.multitask))
        return
    for name in args.matrices or SHIPPED:
        matrix = TransferMatrix.load(name) if name.endswith(".npz") else load_matrix(name)
        print("\n".join(table(matrix, levels_of(matrix, budgets, args.multitask))))
        print()


if __name__ == "__main__":
    main()
