"""Is the transfer model's uncertainty honest? Rows held out, of families its prior has not seen.

    .venv/bin/python evidence/calibration.py [--write]

From k = 1, 2, 4, 8, 15 rows of a shipped matrix, which `auto` picked or chance did, the model
predicts what a new training on every other source would give. Measured per case, a case being
(matrix, seed, k, how the rows were chosen):

    coverage    share of held-out entries inside the central 50, 80, 90, 95 % interval
    PIT         where entries fall in their predicted distribution, by tenths; flat if calibrated
    NLPD, CRPS  negative log predictive density and continuous ranked probability score per entry
    gain        what `auto` says that its next pick will gain, and what that training does gain
    chance      what it says of the chance of gaining 0.01 or more, and how often that happens

Three predictive distributions stand side by side. *Gaussian*: the model's posterior, as it is.
*Heavy tails*: its mean and a share of its deviation as location and scale of a Student-t with two
degrees of freedom; the share is the one of least NLPD on the *other* families. *Naive*: the mean of
each target over the rows seen and one deviation for all; of one row, its mean and deviation.

Matrices are those of one axis with 30 contexts or more, as evidence/learn_prior.py takes them
(all seeds, at most 50 contexts, no "-final" twins), every second context a target. Cases of a
family are averaged, each counting once. `--write` puts the tables into
docs/appendix/calibration.md and draws docs/images/calibration.png.
"""

from __future__ import annotations

import measure  # noqa: F401  first: threads

import argparse  # isort: skip
import itertools
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pages
from learn_prior import small
from scipy.stats import norm

from mbtl.arrays import Array
from mbtl.history import History
from mbtl.models.priors import prior_without
from mbtl.models.transfer_gp import TransferGP
from mbtl.models.transfer_kernel import Places, TransferPrior, grid_pairs
from mbtl.selectors import SelectionProblem
from mbtl.selectors.auto import Auto
from mbtl.zoo.benchmark.shipped import family_of, load_by_id, shipped_matrices

FIGURE = pages.DOCS / "images/calibration.png"
ROWS = (1, 2, 4, 8, 15)
FEW = 2
"""Up to so many rows a case is one of few; the table shows few and more apart."""
LEVELS = np.array([0.50, 0.80, 0.90, 0.95])
GRID = np.linspace(0.05, 0.95, 19)
TENTHS = np.linspace(0.0, 1.0, 11)
FLOOR = 0.02
"""Least deviation of the naive model, in performance."""
SHARES = (0.4, 0.5, 0.6, 0.75, 1.0)
"""Scales of the heavy tails, as shares of the model's deviation."""
EDGES = (0.0, 0.003, 0.01, 0.03, 0.1, np.inf)
LEAST = 0.01
"""Gain in V whose chance is asked for."""
CHANCES = (0.0, 0.05, 0.25, 0.5, 0.75, 0.95, 1.0)
NOTHING = 1e-5
"""Gain drawn as none, in performance."""


@dataclass(frozen=True)
class Score:
    """How well one predictive distribution fits the held-out entries of a case."""

    coverage: Array
    curve: Array
    pit: Array
    nlpd: float
    crps: float


@dataclass(frozen=True)
class Case:
    """One set of rows seen, and what was predicted from it.

    Attributes:
        heavy: one score for each of `SHARES`.
        said, gained: of the next pick.
        chance: said, that it gains `LEAST`.
    """

    matrix: str
    k: int
    gaussian: Score
    heavy: tuple[Score, ...]
    naive: Score
    said: float
    gained: float
    chance: float

    @property
    def family(self) -> str:
        """What no prior may have seen."""
        return family_of(self.matrix)


def gaussian(y: Array, mean: Array, std: Array) -> Score:
    """Of normal distributions; arrays of one shape."""
    z = (y - mean) / std
    place, density = norm.cdf(z), norm.pdf(z)
    crps = std * (z * (2.0 * place - 1.0) + 2.0 * density - 1.0 / np.sqrt(np.pi))
    return _score(place, norm.logpdf(z) - np.log(std), crps)


def heavy(y: Array, mean: Array, scale: Array) -> Score:
    """Of Student-t distributions with two degrees of freedom: density (2 + z^2)^(-3/2)."""
    z = (y - mean) / scale
    root = np.sqrt(2.0 + np.square(z))
    place = 0.5 * (1.0 + z / root)
    crps = scale * (z * (2.0 * place - 1.0) + 2.0 / root - np.pi / np.sqrt(8.0))
    return _score(place, -3.0 * np.log(root) - np.log(scale), crps)


def _score(place: Array, log_density: Array, crps: Array) -> Score:
    inside = 2.0 * np.abs(place - 0.5)
    return Score(
        coverage=np.array([np.mean(inside <= level) for level in LEVELS]),
        curve=np.array([np.mean(inside <= level) for level in GRID]),
        pit=np.histogram(place, TENTHS)[0] / place.size,
        nlpd=float(-log_density.mean()),
        crps=float(crps.mean()),
    )


def naive(seen: Array) -> tuple[Array, float]:
    """Mean (T,) and deviation of a new row, from k rows (k, T)."""
    k = len(seen)
    if k == 1:
        return np.full(seen.shape[1], seen.mean()), max(float(seen.std()), FLOOR)
    mean = seen.mean(axis=0)
    square = np.square(seen - mean).sum() / ((k - 1) * seen.shape[1])
    return mean, max(float(np.sqrt(square * (1.0 + 1.0 / k))), FLOOR)


def held_out(
    problem: SelectionProblem, rows: Array, sources: Sequence[int], prior: TransferPrior
) -> tuple[Score, tuple[Score, ...], Score]:
    """Of the three distributions, on all sources that were not seen."""
    seen, targets = np.asarray(sources), np.arange(1, problem.n, 2)
    unseen = np.setdiff1d(np.arange(problem.n), seen)
    y = rows[np.ix_(seen, targets)]
    places = Places.of(problem.unit, problem.steps)
    model = TransferGP(places, prior, grid_pairs(seen, targets), y.ravel())
    mean, std = model.predict(unseen, targets)
    std = np.sqrt(np.square(std) + model.scale * prior.noise)
    truth = rows[np.ix_(unseen, targets)]
    guess, deviation = naive(y)
    return (
        gaussian(truth, mean, std),
        tuple(heavy(truth, mean, share * std) for share in SHARES),
        gaussian(truth, np.broadcast_to(guess, truth.shape), np.full(truth.shape, deviation)),
    )


def cases(matrix: str) -> Iterator[Case]:
    """Of all seeds of a matrix."""
    prior = prior_without(family_of(matrix))
    auto = Auto(prior=prior, most_targets=25, cover=0)  # what the model itself would pick
    for seed, (problem, rows) in enumerate(small(matrix, max(ROWS) + 1)):
        asked = replace(problem, least_gain=LEAST)
        shuffled = np.random.default_rng([0, seed]).permutation(problem.n).tolist()
        for by_auto in (True, False):
            history = History(problem.n)
            for k in range(max(ROWS) + 1):
                source = shuffled[k]
                if by_auto or k in ROWS:
                    pick = auto.propose(asked, history, np.random.default_rng(0))
                    source = pick.source if by_auto else source
                if k in ROWS:
                    best = history.rows.max(axis=0)
                    gained = np.maximum(rows[pick.source] - best, 0.0) @ problem.weights
                    scores = held_out(problem, rows, history.sources, prior)
                    said, chance = float(pick.acquisition or 0.0), float(pick.chance or 0.0)
                    yield Case(matrix, k, *scores, said, float(gained), chance)
                history = history.with_row(source, rows[source])


def fit_for_this(matrix: str) -> bool:
    """Whether there is one axis, all were trained on, and as many rows to hold out as to see."""
    loaded = load_by_id(matrix)
    enough = loaded.sources is None and loaded.n >= 2 * max(ROWS)
    return loaded.space.d == 1 and enough and not matrix.endswith("-final")


def share_without(found: Sequence[Case], family: str) -> int:
    """Index into `SHARES` of least NLPD on the other families, each counting once."""
    others = [f for f in families(found) if f != family] or [family]
    loss = [average([c for c in found if c.family == f], _heavy_nlpd) for f in others]
    return int(np.mean(loss, axis=0).argmin())


def _heavy_nlpd(case: Case) -> list[float]:
    return [score.nlpd for score in case.heavy]


def distributions(found: Sequence[Case], family: str) -> dict[str, Callable[[Case], Score]]:
    """Their scores by name."""
    share = share_without(found, family)
    return {
        "Gaussian": lambda c: c.gaussian,
        f"heavy tails, {SHARES[share]:g}": lambda c: c.heavy[share],
        "naive": lambda c: c.naive,
    }


def table(found: Sequence[Case]) -> list[str]:
    """One line per family, number of rows and distribution."""
    heads = ["family", "rows", "distribution", *(f"{v:.0%}" for v in LEVELS), "NLPD", "CRPS"]
    lines = [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    for family in families(found):
        kinds = distributions(found, family)
        for label, part in parts([c for c in found if c.family == family]).items():
            for name, kind in kinds.items():
                covered = " | ".join(f"{v:.0%}" for v in mean_score(part, kind, "coverage"))
                quality = (
                    f"{mean_score(part, kind, 'nlpd'):.2f} | {mean_score(part, kind, 'crps'):.3f}"
                )
                lines.append(f"| {family} | {label} | {name} | {covered} | {quality} |")
    return lines


def gains(found: Sequence[Case]) -> list[str]:
    """By predicted gain, and by family; the slope is of gained on said, through zero."""
    heads = ["gain said", "picks", "said, mean", "gained, mean", "slope", "gained nothing"]
    lines = [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    for low, high in itertools.pairwise(EDGES):
        inside = [c for c in found if low <= c.said < high]
        if inside:
            label = f"{low:g} to {high:g}" if np.isfinite(high) else f"{low:g} and more"
            lines.append(f"| {label} | {_gain_cells(inside)} |")
    for family in families(found):
        for label, part in parts([c for c in found if c.family == family]).items():
            lines.append(f"| {family}, {label} rows | {_gain_cells(part)} |")
    return lines


def chances(found: Sequence[Case]) -> list[str]:
    """How often a gain of `LEAST` happened, by its chance."""
    heads = [f"chance said of a gain of {LEAST:g}", "picks", "said, mean", "happened"]
    lines = [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    for low, high in itertools.pairwise(CHANCES):
        inside = [c for c in found if low <= c.chance and (c.chance < high or high == 1.0)]
        if inside:
            said, happened = average(inside, lambda c: (c.chance, c.gained >= LEAST))
            lines.append(f"| {low:g} to {high:g} | {len(inside)} | {said:.2f} | {happened:.2f} |")
    return lines


def _gain_cells(part: Sequence[Case]) -> str:
    said, gained = np.array([[c.said, c.gained] for c in part]).T
    slope = said @ gained / max(said @ said, NOTHING**2)
    none = np.mean(gained < NOTHING)
    return f"{len(part)} | {said.mean():.4f} | {gained.mean():.4f} | {slope:.2f} | {none:.0%}"


def families(found: Sequence[Case]) -> list[str]:
    return sorted({c.family for c in found})


def parts(found: Sequence[Case]) -> dict[str, list[Case]]:
    few = [c for c in found if c.k <= FEW]
    more = [c for c in found if c.k > FEW]
    return {f"1 to {FEW}": few, f"{min(c.k for c in more)} to {max(ROWS)}": more}


def average(found: Sequence[Case], what: Callable[[Case], Any]) -> Any:
    return np.mean([what(c) for c in found], axis=0)


def mean_score(found: Sequence[Case], kind: Callable[[Case], Score], name: str) -> Any:
    """Of one number or array of the scores."""
    return np.mean([getattr(kind(c), name) for c in found], axis=0)


def draw(found: Sequence[Case], path: Path) -> None:
    """Coverage, PIT, density and gain; from records alone."""
    from matplotlib import colormaps, rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with rc_context({"axes.spines.top": False, "axes.spines.right": False, "font.size": 8}):
        figure = Figure(figsize=(9.0, 6.0), layout="constrained")
        FigureCanvasAgg(figure)
        (covered, pit), (density, gain) = figure.subplots(2, 2)
    for i, family in enumerate(families(found)):
        mine = [c for c in found if c.family == family]
        more = list(parts(mine).values())[1]
        ours, tailed, plain = distributions(found, family).values()
        style: dict[str, Any] = {"color": colormaps["tab10"](i)}
        pit.stairs(mean_score(more, ours, "pit"), TENTHS, **style)
        for line, kind in (("-", ours), ("--", tailed)):
            label = family if kind is ours else None
            covered.plot(GRID, mean_score(mine, kind, "curve"), line, label=label, **style)
            seen = [[c for c in mine if c.k == k] for k in ROWS]
            better = [
                mean_score(part, plain, "crps") - mean_score(part, kind, "crps") for part in seen
            ]
            density.plot(ROWS, better, line, **style)
        gain.plot(*np.maximum([[c.said, c.gained] for c in mine], NOTHING).T, ".", ms=4, **style)
    covered.plot([0, 1], [0, 1], color="#999999", lw=0.8, zorder=0)
    covered.set(xlabel="central interval", ylabel="entries inside", title="coverage")
    pit.axhline(0.1, color="#999999", lw=0.8, zorder=0)
    pit.set(xlabel="place in predicted distribution", ylabel="share", title="PIT, 4 to 15 rows")
    density.axhline(0.0, color="#999999", lw=0.8, zorder=0)
    density.set(xlabel="rows seen", ylabel="CRPS: naive - model", title="better than naive")
    ends = [NOTHING, 1.0]
    gain.plot(ends, ends, color="#999999", lw=0.8, zorder=0)
    gain.set(xscale="log", yscale="log", title="gain of the next pick")
    gain.set(xlabel="said", ylabel="gained (1e-5: nothing)", xlim=(NOTHING, 1.0))
    covered.legend(frameon=False, title="dashed: heavy tails")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=120)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--only", default="", help="matrices whose id begins so")
    args = parser.parse_args()
    found: list[Case] = []
    begin = time.process_time()
    for matrix in shipped_matrices():
        if matrix.startswith(args.only) and fit_for_this(matrix):
            found += cases(matrix)
    lines = [*table(found), "", *gains(found), "", *chances(found), ""]
    print("\n".join(lines))
    print(f"{time.process_time() - begin:.0f} s of processor")
    if args.write:
        pages.write_appendix("calibration", "Calibration: all tables", "calibration.md", lines)
        draw(found, FIGURE)


if __name__ == "__main__":
    main()
