"""Compare selectors on transfer matrices: every matrix seed x selector x selector seed.

A training costs nothing here: the row of a pick is read from the matrix and told to the selector,
exactly as a study would after a real training. Where a matrix has two halves of its evaluation
episodes, selectors and routes see one and every V is of the other.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import count
from pathlib import Path

import numpy as np

from mbtl.arrays import Array
from mbtl.errors import InvalidInput, MbtlError, UnknownName, unknown_name
from mbtl.history import History
from mbtl.plain import whole
from mbtl.selectors.base import Exhausted, SelectionProblem
from mbtl.selectors.contract import Selector, traits_of, without_family
from mbtl.selectors.random import Random
from mbtl.selectors.registry import get_selector, selector_names
from mbtl.strategies import get_strategy
from mbtl.zoo.benchmark.base import RowSource, measured_curve
from mbtl.zoo.benchmark.comparison import Comparison, Run, summarise
from mbtl.zoo.benchmark.oracle import Reference, reference
from mbtl.zoo.benchmark.replay import checked_source, replay
from mbtl.zoo.benchmark.shipped import family_of, open_matrices

ORACLE = "oracle"
RANDOM = "random"


@dataclass(frozen=True)
class Step:
    """Progress of a comparison, reported before each piece of work and once at the end.

    Attributes:
        done: pieces finished.
        total: pieces in all.
        doing: what comes next, for people; empty at the end.
    """

    done: int
    total: int
    doing: str


OnStep = Callable[[Step], None]


def compare(
    selectors: Sequence[str | Selector],
    matrices: Sequence[str | Path | RowSource],
    budget: int = 15,
    seeds: int = 3,
    *,
    on_step: OnStep | None = None,
) -> Comparison:
    """Run selectors on matrices for K = `budget` trainings each.

    Args:
        selectors: registered names or selector objects; "oracle" is the Sequential Oracle.
        matrices: paths ending in .npz, ids of shipped matrices, "all", synthetic ids, or matrices.
        budget: K, from 1 to the smallest N.
        seeds: how often a selector that draws at random runs on each matrix seed (there are as many
            of those as the matrix has; all are used). One that always picks the same runs once; one
            of your own says that it does with `traits = Traits(deterministic=True)`.
        on_step: called before each piece of work, for a progress display.

    Raises:
        UnknownName: a matrix or selector has no such name.
        InvalidInput: a matrix is unusable, the budget or number of seeds is out of range, a name
            comes twice, or a selector refuses a matrix (greedy and equidistant need one axis), or
            proposes nothing, a context again, or one that nobody may train on.
    """
    budget, seeds = whole("budget", budget), whole("seeds", seeds)
    if seeds < 1:
        raise InvalidInput(f"seeds must be at least 1, got {seeds}")
    sources = open_matrices(matrices)
    entrants = _entrants(selectors)
    _check_budget(sources, budget)
    problems = {name: _problem(name, source, budget) for name, source in sources.items()}
    for name, problem in problems.items():
        _check_runnable(entrants, name, problem)

    tries = {
        label: 1 if traits_of(selector).deterministic else seeds
        for label, selector in entrants.items()
        if selector is not None
    }
    done = count()
    total = sum(source.n_seeds for source in sources.values()) * (1 + sum(tries.values()))

    def tell(doing: str) -> None:
        if on_step is not None:
            on_step(Step(next(done), total, doing))

    runs: list[Run] = []
    curves: dict[str, dict[str, list[Array]]] = {m: {e: [] for e in entrants} for m in sources}
    references: dict[str, list[Reference]] = {m: [] for m in sources}
    for name, source in sources.items():
        for s in range(source.n_seeds):
            tell(f"{name}, seed {s}: oracle and exact Random")
            known = reference(source, s, budget)
            references[name].append(known)
            for label, selector in entrants.items():
                if selector is None:
                    best, theta = known.oracle, problems[name].theta
                    group = [Run(name, s, ORACLE, 0, theta, best.sources, best.curve, best.seconds)]
                else:
                    group, fair = [], held_out(selector, getattr(source, "cmdp", ""))
                    for seed in range(tries[label]):
                        tell(f"{name}, seed {s}: {label}")
                        group.append(_run(fair, source, problems[name], (name, s, seed)))
                runs += group
                mean = np.mean([run.performance for run in group], axis=0)
                curves[name][label].append(known.random if label == RANDOM else mean)
    tell("")
    stacked = {m: {e: np.array(v) for e, v in by.items()} for m, by in curves.items()}
    caveats = {name: getattr(source, "caveat", None) for name, source in sources.items()}
    return Comparison(tuple(runs), summarise(stacked, references, caveats), stacked, references)


def held_out(selector: Selector, cmdp: str) -> Selector:
    """The selector or strategy as it would be had it never seen the family of a CMDP.

    One that has learned from matrices has a method `without(family)`; see `family_of`. A matrix is
    of the CMDP that its provenance names, whether it is opened by file or by id.
    """
    return without_family(selector, family_of(cmdp))


def default_selectors(matrices: Sequence[str | Path | RowSource]) -> list[str]:
    """Every registered selector that can run on all these matrices, and the oracle."""
    problems = [source.problem(1) for source in open_matrices(matrices).values()]
    names = [name for name in selector_names() if all(_refusal(name, p) is None for p in problems)]
    return [*names, ORACLE]


def _run(
    selector: Selector, source: RowSource, problem: SelectionProblem, key: tuple[str, int, int]
) -> Run:
    matrix, matrix_seed, seed = key
    found = replay(
        selector, problem, lambda i: source.rows(matrix_seed, [i])[0], seed=seed, trial=matrix_seed
    )
    return Run(
        matrix=matrix,
        matrix_seed=matrix_seed,
        selector=selector.name,
        seed=seed,
        theta=problem.theta,
        sources=found.history.sources,
        performance=measured_curve(source, matrix_seed, found.history.sources),
        select_seconds=found.select_seconds,
    )


def _entrants(selectors: Sequence[str | Selector]) -> dict[str, Selector | None]:
    """Selectors by name, in order; None stands for the oracle."""
    if isinstance(selectors, str):
        raise InvalidInput(f"selectors must be a list of names, got the text {selectors!r}")
    entrants: dict[str, Selector | None] = {}
    for given in selectors:
        selector = None if given == ORACLE else selector_of(given)
        name = ORACLE if selector is None else selector.name
        if name in entrants:
            raise InvalidInput(f"selectors must have distinct names, got {name!r} twice")
        if name in (RANDOM, ORACLE) and not isinstance(selector, (Random, type(None))):
            raise InvalidInput(
                f"{name!r} is the name of a reference, got {type(given).__name__} called so; give "
                "your selector another name"
            )
        entrants[name] = selector
    if not entrants:
        raise InvalidInput("a comparison needs one or more selectors, got none")
    return entrants


def selector_of(given: str | Selector) -> Selector:
    """A selector that a matrix can answer, by name or your own.

    Raises:
        InvalidInput: it asks for other trainings than specialists.
        UnknownName: there is none of this name.
    """
    try:
        selector = get_strategy(given)
    except UnknownName:
        if ":" in str(given):  # of a user's own, whose names are not ours
            raise
        raise unknown_name("selector", str(given), [*selector_names(), ORACLE]) from None
    if traits_of(selector).any_training:
        raise InvalidInput(
            f"a matrix holds specialists alone, and {selector.name!r} asks for trainings of every "
            "kind; replay it on transfer data (docs/own-selector.md)"
        )
    return selector


def _check_budget(sources: Mapping[str, RowSource], budget: int) -> None:
    """Name every matrix that is too small at once."""
    sizes = {name: len(source.problem(1).sources) for name, source in sources.items()}
    small = [f"{name} ({size})" for name, size in sizes.items() if size < budget]
    if len(small) > 1:
        raise InvalidInput(
            f"budget must be at most the number of contexts, and {budget} is more than "
            f"{', '.join(small)} have; take {min(sizes.values())} or fewer, or leave those out"
        )


def _problem(name: str, source: RowSource, budget: int) -> SelectionProblem:
    try:
        return source.problem(budget)
    except InvalidInput as error:
        raise InvalidInput(f"matrix {name!r}: {error}") from error


def _check_runnable(
    entrants: Mapping[str, Selector | None], matrix: str, problem: SelectionProblem
) -> None:
    """Find selectors that refuse a matrix before hours of work, not after."""
    for name, selector in entrants.items():
        refusal = None if selector is None else _refusal(selector, problem)
        if refusal is not None:
            raise InvalidInput(
                f"selector {name!r} cannot run on matrix {matrix!r}: {refusal}; "
                "leave one of them out"
            ) from refusal


def _refusal(given: str | Selector, problem: SelectionProblem) -> MbtlError | None:
    """What a selector says against a problem at its first proposal, or breaks; None if it runs."""
    selector, nothing = get_selector(given), History(problem.n)
    try:
        first = selector.propose(problem, nothing, np.random.default_rng(0))
        checked_source(selector, problem, nothing, first)
    except (InvalidInput, Exhausted) as error:
        return error
    return None
