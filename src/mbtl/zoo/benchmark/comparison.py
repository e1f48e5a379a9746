"""A whole comparison: its runs, its summary, and what people do with them."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from mbtl.arrays import Array
from mbtl.errors import check_known, needs
from mbtl.objective import k_star
from mbtl.report.reference import REFERENCE_NAMES
from mbtl.zoo.benchmark.oracle import Reference

# ---- records of a comparison: numbers first, tables and figures are drawn from these ---------
#
# What each number means stands below; `to_json` gives the document of `mbtl bench`.


CONFIDENCE = 0.95
RESAMPLES = 10_000


@dataclass(frozen=True)
class Record:
    """What is written field by field."""

    def to_json(self) -> dict[str, Any]:
        """JSON-able record."""
        return {one.name: _json(getattr(self, one.name)) for one in fields(self)}


def _json(fact: Any) -> Any:
    if isinstance(fact, Mapping):
        return {key: _json(one) for key, one in fact.items()}
    if isinstance(fact, Record):
        return fact.to_json()
    return fact.tolist() if isinstance(fact, np.ndarray) else fact


def _grouped(record: dict[str, Any], **groups: Mapping[str, str]) -> dict[str, Any]:
    """The record with some entries, new name -> old, together below one name."""
    for group, names in groups.items():
        record[group] = {name: record.pop(old) for name, old in names.items()}
    return record


_CLOSED = {"at_K": "closed_at_K", "under_curve": "closed_under_curve"}


@dataclass(frozen=True, eq=False)
class Run(Record):
    """One selector on one matrix seed.

    Attributes:
        matrix: path or id as given.
        matrix_seed: position along the seed axis.
        selector: selector name.
        seed: selector seed; 0 for a deterministic selector.
        theta: slope that the selector was told, performance per grid step.
        sources: (K,) 0-based picks in order.
        performance: (K,) V_1..V_K, normalised, not clipped.
        select_seconds: total wall time of the K proposals.
    """

    matrix: str
    matrix_seed: int
    selector: str
    seed: int
    theta: float
    sources: tuple[int, ...]
    performance: Array
    select_seconds: float


@dataclass(frozen=True, repr=False)
class Estimate(Record):
    """A number and its 95 % interval, `low` to `high`; None where it does not exist."""

    value: float | None
    low: float | None
    high: float | None

    def __repr__(self) -> str:
        if self.value is None:
            return "none"
        interval = "" if self.low is None else f" [{self.low:.4g}, {self.high:.4g}]"
        return f"{self.value:.4g}{interval}"


@dataclass(frozen=True, repr=False)
class Trainings(Record):
    """Number of trainings until a level is reached.

    Attributes:
        estimate: geometric mean, censored seeds as K + 1; so a lower bound where any is censored.
        censored: number of seeds that did not reach the level within K.
        per_seed: each matrix seed's number; None when censored.
    """

    estimate: Estimate
    censored: int
    per_seed: tuple[int | None, ...]

    def __repr__(self) -> str:
        seeds = ", ".join("never" if k is None else str(k) for k in self.per_seed)
        if self.censored == 0:
            return f"{self.estimate!r} (by seed: {seeds})"
        least = "" if self.estimate.value is None else f">{self.estimate.value:.4g} "
        missing = f"{self.censored} of {len(self.per_seed)} seeds"
        return f"{least}({missing} did not get there; by seed: {seeds})"

    def to_json(self) -> dict[str, Any]:
        """JSON-able record."""
        record = super().to_json()
        return {**record.pop("estimate"), **record}


@dataclass(frozen=True)
class SelectorSummary(Record):
    """One selector on one matrix, or pooled; this module has every formula."""

    V_K: Estimate
    V_mean: Estimate
    k_star: Trainings
    k90: Trainings
    k95: Trainings
    k99: Trainings
    minus_random_at_K: Estimate
    minus_random_mean: Estimate
    closed_at_K: Estimate
    closed_under_curve: Estimate

    def to_json(self) -> dict[str, Any]:
        """JSON-able record."""
        ahead = {"at_K": "minus_random_at_K", "mean": "minus_random_mean"}
        return _grouped(super().to_json(), minus_random=ahead, closed_fraction=_CLOSED)


@dataclass(frozen=True)
class Lead(Record):
    """How far one selector is ahead of another, > 0 where it is better.

    Attributes:
        V_K: in V after the last training.
        V_mean: in V, mean over k = 1..K.
        closed_at_K: in the closed fraction, after the last training.
        closed_under_curve: in the closed fraction, over all trainings.
        per_seed: in mean V, of each matrix seed.
    """

    V_K: Estimate
    V_mean: Estimate
    closed_at_K: Estimate
    closed_under_curve: Estimate
    per_seed: tuple[float, ...]

    @property
    def ahead(self) -> int:
        """Number of matrix seeds where it is ahead."""
        return sum(lead > 0.0 for lead in self.per_seed)

    def to_json(self) -> dict[str, Any]:
        """JSON-able record."""
        return _grouped(super().to_json(), closed_fraction=_CLOSED)


@dataclass(frozen=True, repr=False)
class Difference(Record):
    """One selector less another, paired: both saw the same matrix seeds.

    Attributes:
        selector: the one.
        against: the other.
        matrices: by matrix; intervals over its seeds, drawn anew with replacement.
        pooled: mean over the matrices; intervals over the seeds of these matrices.
        over_matrices: the same means; intervals over the matrices, which are drawn anew, too: what
            to expect on another problem of this kind. No interval with fewer than three.
    """

    selector: str
    against: str
    matrices: Mapping[str, Lead]
    pooled: Lead
    over_matrices: Lead

    def __repr__(self) -> str:
        return difference_text(self)


@dataclass(frozen=True)
class MatrixSummary(Record):
    """One matrix: its levels and reference curves (means over seeds), and every selector.

    Attributes:
        n_seeds: number of matrix seeds S.
        independent: see `Levels`; so for the next two.
        random: (K,) expected V of Random.
        oracle: (K,) V of the Sequential Oracle.
        selectors: by selector name.
        references: V of the reference rows by name; see `mbtl.zoo.benchmark.oracle`.
        caveat: what must be said beside these numbers; None where there is nothing to say.
    """

    n_seeds: int
    independent: float
    oracle_transfer: float
    grand_mean: float
    random: Array
    oracle: Array
    selectors: Mapping[str, SelectorSummary]
    references: Mapping[str, float] = field(default_factory=dict)
    caveat: str | None = None

    def to_json(self) -> dict[str, Any]:
        """JSON-able record."""
        record = super().to_json()
        record["matrix_seeds"] = record.pop("n_seeds")
        levels = {name: name for name in ("independent", "oracle_transfer", "grand_mean")}
        return _grouped(record, levels=levels, curves={"random": "random", "oracle": "oracle"})


@dataclass(frozen=True)
class Summary(Record):
    """All of a comparison: per matrix, and pooled over the matrices."""

    budget: int
    matrices: Mapping[str, MatrixSummary]
    pooled: Mapping[str, SelectorSummary]

    def to_json(self) -> dict[str, Any]:
        """JSON-able record."""
        interval = {
            "method": "percentile bootstrap over matrix seeds, shared by all selectors",
            "level": CONFIDENCE,
            "resamples": RESAMPLES,
        }
        return {**super().to_json(), "interval": interval}


# ---- summary of a comparison: what each selector reached, with intervals over matrix seeds ---
#
# Notation (shapes): one matrix with S seeds, K trainings.
#     V        (S, K)  generalisation performance; a selector run with several selector seeds enters
#                      with the mean of its curves, `random` with its exact expectation
#     V_rand   (S, K)  Random's exact expectation      V_orac  (S, K)  Sequential Oracle
#
# Per matrix seed, then averaged over the seeds of a matrix:
#     V_K      V at k = K                              V_mean  mean of V over k = 1..K
#     k_star   first k with V >= Independent (the multi-task value is no part of a matrix)
#     k90      first k with V >= grand mean + 0.90 (Oracle Transfer - grand mean); k95, k99 alike
# Averages of k are geometric means. A level not reached within K is *censored*: the seed shows
# None, enters the geometric mean as K + 1, and is counted; with `censored` > 0 the value therefore
# is a lower bound, and with every seed censored it is None.
#
#     minus_random     V - V_rand, at K and as mean over k
#     closed_fraction  mean(V - V_rand) / mean(V_orac - V_rand), at K and under the curve (k =
#                      1..K): a ratio of means over seeds, never a mean of ratios; None if nobody
#                          can gain
#
# *Pooled* values average these per-matrix means over the matrices, each matrix counting once: V_K
# and V_mean arithmetically, k geometrically, closed_fraction as the ratio of the two pooled means.
#
# Intervals: 95 % percentile bootstrap. Seeds are the unit: the S seeds of each matrix are drawn
# with replacement, within that matrix, and all selectors share the draws, so differences are
# paired. One seed gives no interval, alone or in a pool. With three seeds the bootstrap knows only
# ten samples, and its intervals are too short; they show the scatter between seeds, not a tested
# claim.


SHARES = (0.90, 0.95, 0.99)
DRAWS_SEED = 20240604
_TIE = 1e-12

# Columns of the per-seed table; every statistic is a function of their means.
V_K, V_MEAN, LOG_K, GAIN, ROOM = 0, 1, slice(2, 6), slice(6, 8), slice(8, 10)


def summarise(
    curves: Mapping[str, Mapping[str, Array]],
    references: Mapping[str, Sequence[Reference]],
    caveats: Mapping[str, str | None] | None = None,
) -> Summary:
    """Summarise the curves of several selectors on several matrices.

    Args:
        curves: matrix name -> selector name -> (S, K) V; the same selectors for every matrix.
        references: matrix name -> one reference per matrix seed.
        caveats: matrix name -> what must be said beside its numbers.
    """
    rng = np.random.default_rng(DRAWS_SEED)
    draws = {name: seed_draws(len(refs), rng) for name, refs in references.items()}
    tables: dict[str, list[SeedTable]] = {}
    matrices = {}
    for name, refs in references.items():
        selectors = {}
        for selector, values in curves[name].items():
            table = SeedTable.of(values, refs, draws[name])
            tables.setdefault(selector, []).append(table)
            selectors[selector] = _summary([table])
        matrices[name] = _matrix_summary(refs, selectors, (caveats or {}).get(name))
    budget = len(next(iter(references.values()))[0].random)
    return Summary(budget, matrices, {name: _summary(group) for name, group in tables.items()})


@dataclass(frozen=True)
class SeedTable:
    """Per-seed columns of one selector on one matrix, and the shared bootstrap draws."""

    columns: Array  # (S, F)
    reached: tuple[tuple[int | None, ...], ...]  # per level, per seed
    draws: Array | None  # (B, S) shares of each seed, rows sum to 1

    @classmethod
    def of(cls, values: Array, refs: Sequence[Reference], draws: Array | None) -> SeedTable:
        """The columns of (S, K) V."""
        budget = values.shape[1]
        by_seed = [_reached(curve, ref) for curve, ref in zip(values, refs, strict=True)]
        reached = tuple(zip(*by_seed, strict=True))
        trainings = np.array([[budget + 1 if k is None else k for k in row] for row in reached])
        random = np.array([ref.random for ref in refs])
        gain, room = values - random, np.array([ref.oracle.curve for ref in refs]) - random
        columns = np.column_stack(
            [
                values[:, -1],
                values.mean(axis=1),
                np.log(trainings).T,
                gain[:, -1],
                gain.mean(axis=1),
                room[:, -1],
                room.mean(axis=1),
            ]
        )
        return cls(columns, reached, draws)


def trainings_to(curve: Array, low: float, high: float) -> list[int | None]:
    """Trainings until (K,) V has gone each of `SHARES` of the way from `low` to `high`."""
    return [k_star(curve, low + share * (high - low) - _TIE) for share in SHARES]


def _reached(curve: Array, ref: Reference) -> list[int | None]:
    """k_star, k90, k95, k99 of one seed."""
    low, high = ref.levels.grand_mean, ref.levels.oracle_transfer
    return [k_star(curve, ref.levels.independent - _TIE), *trainings_to(curve, low, high)]


def seed_draws(n_seeds: int, rng: np.random.Generator) -> Array | None:
    """(B, S) shares of each seed in B draws with replacement; None of a single seed."""
    if n_seeds == 1:
        return None
    counts = rng.multinomial(n_seeds, np.full(n_seeds, 1.0 / n_seeds), size=RESAMPLES)
    return np.asarray(counts / n_seeds)


def _summary(tables: Sequence[SeedTable]) -> SelectorSummary:
    """The statistics of one selector over one or more matrices."""
    means = np.mean([table.columns.mean(axis=0) for table in tables], axis=0)
    resampled = resampled_means(tables)

    def estimate(statistic: Any) -> Estimate:
        return estimated(statistic, means, resampled)

    def trainings(q: int) -> Trainings:
        per_seed = tuple(k for table in tables for k in table.reached[q])
        censored = sum(k is None for k in per_seed)
        if censored == len(per_seed):
            return Trainings(Estimate(None, None, None), censored, per_seed)
        return Trainings(estimate(lambda m: np.exp(m[..., LOG_K][..., q])), censored, per_seed)

    return SelectorSummary(
        V_K=estimate(lambda m: m[..., V_K]),
        V_mean=estimate(lambda m: m[..., V_MEAN]),
        k_star=trainings(0),
        k90=trainings(1),
        k95=trainings(2),
        k99=trainings(3),
        minus_random_at_K=estimate(lambda m: m[..., GAIN][..., 0]),
        minus_random_mean=estimate(lambda m: m[..., GAIN][..., 1]),
        closed_at_K=estimate(lambda m: _closed(m, 0)),
        closed_under_curve=estimate(lambda m: _closed(m, 1)),
    )


def estimated(
    statistic: Any, means: Array, resampled: Array | None, wider: float = 1.0
) -> Estimate:
    """A function of the (F,) means, with its interval by the (B, F) resampled ones, made wider."""
    value = float(statistic(means))
    low = high = None
    if resampled is not None:
        spread = np.asarray(statistic(resampled))
        spread = spread[np.isfinite(spread)]
        if spread.size:
            tail = (1.0 - CONFIDENCE) / 2.0
            ends = np.quantile(spread, [tail, 1.0 - tail])
            low, high = (float(value + wider * (q - value)) for q in ends)
    return Estimate(value, low, high) if np.isfinite(value) else Estimate(None, None, None)


def resampled_means(tables: Sequence[SeedTable]) -> Array | None:
    """(B, F) means under the bootstrap; None if a matrix has one seed, whose scatter is unknown."""
    parts = []
    for table in tables:
        if table.draws is None:
            return None
        parts.append(table.draws @ table.columns)
    return np.asarray(np.mean(parts, axis=0))


def ratio(gain: Array, room: Array) -> Array:
    """Gain / room; NaN where there is no room."""
    some = np.abs(room) > _TIE
    return np.where(some, gain / np.where(some, room, 1.0), np.nan)


def _matrix_summary(
    refs: Sequence[Reference], selectors: Mapping[str, SelectorSummary], caveat: str | None
) -> MatrixSummary:
    return MatrixSummary(
        n_seeds=len(refs),
        independent=float(np.mean([ref.levels.independent for ref in refs])),
        oracle_transfer=float(np.mean([ref.levels.oracle_transfer for ref in refs])),
        grand_mean=float(np.mean([ref.levels.grand_mean for ref in refs])),
        random=np.mean([ref.random for ref in refs], axis=0),
        oracle=np.mean([ref.oracle.curve for ref in refs], axis=0),
        selectors=selectors,
        references={key: float(np.mean([ref.rows[key] for ref in refs])) for key in refs[0].rows},
        caveat=caveat,
    )


# ---- one selector less another on the same matrix seeds, with intervals ----------------------
#
# What is hard about a matrix seed is hard for both, so it cancels in the difference, and the
# interval of a difference is shorter than those of the two. Formulas and the bootstrap are those of
# the summary: V_K, V_mean, and closed_fraction as a ratio of means,
# mean(V_a - V_b) / mean(V_orac - V_rand).
#
# Two intervals answer two questions. Over the seeds of these matrices: would other trainings on
# these very problems give the same? Over the matrices: what is to be expected on another problem?
# The second is wider where selectors differ from problem to problem, and by Student's t.


_FEWEST = 3
"""Matrices from which an interval over matrices says something."""


def difference(comparison: Comparison, selector: str, against: str) -> Difference:
    """The lead of one selector over another; see `Comparison.difference`."""
    rng = np.random.default_rng(DRAWS_SEED)  # the draws of the summary
    tables = {}
    for name, refs in comparison.references.items():
        draws, curves = seed_draws(len(refs), rng), comparison.curves[name]
        for asked in (selector, against):
            check_known("selector of this comparison", asked, curves)
        one, other = (SeedTable.of(curves[asked], refs, draws) for asked in (selector, against))
        columns = one.columns - other.columns
        columns[:, ROOM] = one.columns[:, ROOM]  # of the matrix, the same for both
        tables[name] = SeedTable(columns, (), draws)
    every = list(tables.values())
    return Difference(
        selector,
        against,
        {name: _lead([table], resampled_means([table])) for name, table in tables.items()},
        _lead(every, resampled_means(every)),
        _lead(every, _over_matrices(every), _few(len(every))),
    )


def _lead(tables: Sequence[SeedTable], resampled: Array | None, wider: float = 1.0) -> Lead:
    means = np.mean([table.columns.mean(axis=0) for table in tables], axis=0)
    return Lead(
        V_K=estimated(lambda m: m[..., V_K], means, resampled, wider),
        V_mean=estimated(lambda m: m[..., V_MEAN], means, resampled, wider),
        closed_at_K=estimated(lambda m: _closed(m, 0), means, resampled, wider),
        closed_under_curve=estimated(lambda m: _closed(m, 1), means, resampled, wider),
        per_seed=tuple(float(v) for table in tables for v in table.columns[:, V_MEAN]),
    )


def _closed(means: Array, which: int) -> Array:
    return ratio(means[..., GAIN][..., which], means[..., ROOM][..., which])


def _over_matrices(tables: Sequence[SeedTable]) -> Array | None:
    """(B, F) means over matrices, drawn with replacement; their scatter has that of their seeds."""
    if len(tables) < _FEWEST:
        return None
    rng = np.random.default_rng(DRAWS_SEED)
    each = np.array([table.columns.mean(axis=0) for table in tables])
    drawn = rng.integers(len(tables), size=(len(tables), RESAMPLES))
    return np.asarray(each[drawn].mean(axis=0))


def _few(n: int) -> float:
    """How much wider Student's interval of the mean of n is than the bootstrap's.

    The latter covers 75, 84 and 90 % with 3, 5 and 10 matrices, made wider 94 or 95 %.
    """
    from scipy.special import ndtri, stdtrit  # slow to import

    if n < _FEWEST:
        return 1.0
    end = (1.0 + CONFIDENCE) / 2.0
    return float(stdtrit(n - 1, end) / ndtri(end) * np.sqrt(n / (n - 1)))


# ---- the whole -------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False, repr=False)
class Comparison:
    """Every run of a comparison, and its summary; shown, it is the table of `mbtl bench`.

    Attributes:
        results: every run; one of `random` is one order of many.
        summary: what the table shows.
        curves: matrix -> selector -> (S, K) V of each matrix seed: the mean over selector seeds,
            and Random's exact expectation over all orders.
        references: matrix -> levels and reference curves of each matrix seed.
    """

    results: tuple[Run, ...]
    summary: Summary
    curves: Mapping[str, Mapping[str, Array]]
    references: Mapping[str, Sequence[Reference]]

    def __repr__(self) -> str:
        return comparison_text(self)

    def to_json(self) -> dict[str, Any]:
        """The document that `mbtl bench --json` prints."""
        return {
            "results": [run.to_json() for run in self.results],
            "summary": self.summary.to_json(),
        }

    def difference(self, selector: str, against: str) -> Difference:
        """How far one selector is ahead of another on the same matrix seeds, with intervals.

        Args:
            selector: name of one that was compared.
            against: name of another.

        Raises:
            UnknownName: one of them was not compared.
        """
        return difference(self, selector, against)

    def to_frame(self) -> Any:
        """A pandas table, a line per run and training: k, the source, and V after it.

        Random is exact, as in the table: its V is the mean over all orders, and it has no source.
        The orders that were drawn are in `results`.

        Raises:
            MissingExtra: pandas is not installed.
        """
        with needs("pandas", "frames"):
            import pandas
        lines: list[tuple[Any, ...]] = []
        for run in self.results:
            sources: Sequence[int | None] = run.sources
            values = run.performance
            if run.selector == "random":
                if run.seed > 0:
                    continue
                sources = [None] * len(sources)
                values = self.curves[run.matrix]["random"][run.matrix_seed]
            head = (run.matrix, run.matrix_seed, run.selector, run.seed)
            lines += [
                (*head, k, source, float(value))
                for k, (source, value) in enumerate(zip(sources, values, strict=True), 1)
            ]
        heads = ["matrix", "matrix_seed", "selector", "seed", "k", "source", "V"]
        return pandas.DataFrame(lines, columns=heads).astype({"source": "Int64"})

    def plot(self, matrix: str | None = None, *, ax: Any = None) -> Any:
        """V against k of every selector on one matrix; see `mbtl.plot.comparison`."""
        from mbtl.plot import comparison

        return comparison(self, matrix, ax=ax)


# ---- tables: what `mbtl bench` prints, and how a `Comparison` shows itself --------------------


WIDE = 90
"""Columns of a terminal from which all numbers are shown."""
_WIDE_ONLY = ("mean V", "k95")


def comparison_text(comparison: Comparison) -> str:
    """The same as text, with all numbers."""
    return _text(lambda screen: show_comparison(screen, comparison))


def difference_text(difference: Difference) -> str:
    """A difference as text: a line per matrix, and the means."""
    rows = dict(difference.matrices)
    if len(rows) > 1:
        rows["pooled, over their seeds"] = difference.pooled
        rows["pooled, over matrices"] = difference.over_matrices
    title = f"{difference.selector} less {difference.against}, on the same seeds"
    return _text(lambda screen: screen.print(_lead_table(title, "matrix", rows)), width=2 * WIDE)


def _text(show: Callable[[Console], None], width: int = WIDE) -> str:
    screen = Console(file=io.StringIO(), width=width, color_system=None, force_jupyter=False)
    show(screen)
    assert isinstance(screen.file, io.StringIO)
    return "\n".join(line.rstrip() for line in screen.file.getvalue().splitlines())


def show_comparison(screen: Console, comparison: Comparison, against: str | None = None) -> None:
    """Print one table per matrix, and the pooled one when there are several.

    Args:
        screen: to print on; below `WIDE` columns some are left out.
        comparison: what to show.
        against: selector whose differences to all others are shown, too.
    """
    summary, wide = comparison.summary, screen.width >= WIDE
    others = [name for name in summary.pooled if name != against]
    leads = [comparison.difference(name, against) for name in others] if against else []
    for name, one in summary.matrices.items():
        seeds = f"{one.n_seeds} seed" + ("s" if one.n_seeds > 1 else "")
        title = f"{name} ({seeds}), K = {summary.budget}"
        table = _table(title, one.selectors, summary.budget, wide)
        table.caption = "\n".join(captions(one))
        table.caption_justify = "left"
        screen.print(table)
        if leads:
            rows = {lead.selector: lead.matrices[name] for lead in leads}
            title = f"less {against}, on the same seeds"
            screen.print(_lead_table(title, "selector", rows, wide))
    if len(summary.matrices) > 1:
        title = f"pooled over {len(summary.matrices)} matrices, K = {summary.budget}"
        screen.print(_table(title, summary.pooled, summary.budget, wide))
        if leads:
            known = all(lead.over_matrices.V_mean.low is not None for lead in leads)
            rows = {lead.selector: lead.over_matrices if known else lead.pooled for lead in leads}
            over = "matrices" if known else "their seeds"
            title = f"pooled: less {against}, intervals over {over}"
            screen.print(_lead_table(title, "selector", rows, wide))
    notes = [
        "[..] 95 % bootstrap interval over matrix seeds (none with one seed).",
        "k*: trainings to reach Independent; k90: 90 % of the way from the grand mean to Oracle "
        "Transfer; geometric means over seeds.",
        f"> is a lower bound: a seed that did not get there within K = {summary.budget} counts as "
        f"{summary.budget + 1}, so >{summary.budget + 0.7:.1f} can stand there; a larger --budget "
        "says more.",
        "random policy: one policy trained on a random context, the grand mean of the matrix.",
        "closed: share of the distance from Random to the Sequential Oracle.",
    ]
    if not wide:
        notes.append(f"A terminal of {WIDE} columns also shows mean V and k95.")
    if leads:
        notes.append(
            "less ...: paired differences, > 0 is better; where the interval holds 0, it may be "
            "chance. ahead: matrix seeds with a higher mean V."
        )
    if "random" in summary.pooled:
        notes.append("random: exact expectation over all orders.")
    if "specialists" in summary.pooled:
        notes.append(
            "specialists: its prior has not seen the family of a matrix, where provenance names it."
        )
    screen.print("\n".join(notes), style="dim", markup=False, highlight=False)


def captions(one: MatrixSummary) -> list[str]:
    """What stands under a table of selectors: levels, and what must be said of them."""
    rows = [f"{REFERENCE_NAMES.get(key, key)} {v:.4f}" for key, v in one.references.items()]
    levels = f"Independent {one.independent:.4f}, Oracle Transfer {one.oracle_transfer:.4f}"
    return [", ".join(rows), levels, *([] if one.caveat is None else [f"Note: {one.caveat}."])]


def _table(title: str, selectors: Mapping[str, SelectorSummary], budget: int, wide: bool) -> Table:
    heads = ("V_K", "mean V", "k*", "k90", "k95", "k99", "closed\nat K", "closed,\ncurve")
    table = _empty(title, "selector", [head for head in heads if wide or head not in _WIDE_ONLY])
    for name, one in selectors.items():
        cells = {
            "V_K": _number(one.V_K, 4) + _interval(one.V_K, 3),
            "mean V": _number(one.V_mean, 4),
            "k*": _count(one.k_star, budget),
            "k90": _count(one.k90, budget),
            "k95": _count(one.k95, budget),
            "k99": _count(one.k99, budget),
            "closed at K": _number(one.closed_at_K, 2) + _interval(one.closed_at_K, 2),
            "curve": _number(one.closed_under_curve, 2) + _interval(one.closed_under_curve, 2),
        }
        table.add_row(
            name, *(cell for head, cell in cells.items() if wide or head not in _WIDE_ONLY)
        )
    return table


def _lead_table(title: str, first: str, rows: Mapping[str, Lead], wide: bool = True) -> Table:
    heads = ("V_K", "mean V", "closed\nat K", "closed,\ncurve", "ahead")
    table = _empty(title, first, heads if wide else heads[2:])
    for name, lead in rows.items():
        cells = [
            *(_signed(one, 4) for one in (lead.V_K, lead.V_mean)),
            *(_signed(one, 2) for one in (lead.closed_at_K, lead.closed_under_curve)),
            f"{lead.ahead} of {len(lead.per_seed)}",
        ]
        table.add_row(Text(name), *(cells if wide else cells[2:]))
    return table


def _empty(title: str, first: str, heads: Sequence[str]) -> Table:
    table = Table(title=Text(title), box=box.SIMPLE, padding=0, show_edge=False)
    table.add_column(first, no_wrap=True)
    for head in heads:
        table.add_column(head, justify="right", no_wrap=True)
    return table


def _signed(estimate: Estimate, digits: int) -> str:
    if estimate.value is None:
        return "-"
    return f"{estimate.value:+.{digits}f}" + _interval(estimate, min(digits, 3), "+")


def _number(estimate: Estimate, digits: int) -> str:
    return "-" if estimate.value is None else f"{estimate.value:.{digits}f}"


def _interval(estimate: Estimate, digits: int, sign: str = "") -> str:
    """On a line of its own, so that the table fits 80 columns."""
    if estimate.low is None or estimate.high is None or estimate.low == estimate.high:
        return ""
    low, high = (f"{end:{sign}.{digits}f}" for end in (estimate.low, estimate.high))
    return f"\n\\[{low}, {high}]"


def _count(trainings: Trainings, budget: int) -> str:
    value = trainings.estimate.value
    if value is None:
        return f">{budget}"
    return f"{'>' if trainings.censored else ''}{value:.1f}"
