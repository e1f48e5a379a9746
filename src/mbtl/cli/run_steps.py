"""`mbtl run --steps`: pay in environment steps, all in."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from mbtl.cli.common import console, print_json, printer
from mbtl.cli.folders import check_folder, set_aside, study_in
from mbtl.cli.master import artifacts_for, check_master, command
from mbtl.cli.step_progress import StepProgress
from mbtl.cli.step_worker import follow
from mbtl.cmdps import resolve_cmdp
from mbtl.errors import InvalidInput, MissingExtra, StorageError
from mbtl.plot import policy_map, save
from mbtl.report.step_text import show_steps
from mbtl.study.limits import check_limits
from mbtl.study.steps.claims import LEASE
from mbtl.study.steps.create import create_step_study
from mbtl.study.steps.prices import in_units
from mbtl.study.steps.strategies import DEFAULT, strategy_named
from mbtl.study.steps.study import StepStudy
from mbtl.study.steps.summary import counted
from mbtl.trainer import Trainer

_NUMBER = re.compile(r"(\d+(?:\.\d+)?(?:e\d+)?)\s*([kmg]?)", re.IGNORECASE)
_SIZES = {"": 1, "k": 10**3, "m": 10**6, "g": 10**9}


@dataclass(frozen=True)
class StepWish:
    """What was asked for on the command line.

    Attributes:
        problem: id of a CMDP, or module:problem.
        budget: environment steps.
        strategy: a name; None: the default.
        preset: recipe; None: the default.
        seed: root of all randomness.
        engine: of the simulation; None: the fastest there is.
        score: what an episode of traffic is worth; None: the default.
        timesteps: of a whole training; None: the preset's.
        episodes: likewise, where those are counted.
        eval_episodes: of a policy on a target; None: the default.
        tensorboard: folder for training scalars.
        artifacts: folder or URL of the policies.
        workers: database in which others train the study; None: it is trained here.
        accept_changes: go on although own functions have changed since the study was begun.
    """

    problem: str
    budget: int
    strategy: str | None
    preset: str | None
    seed: int
    engine: str | None
    score: str | None
    timesteps: int | None
    episodes: int | None
    eval_episodes: int | None
    tensorboard: Path | None
    artifacts: str | None
    workers: str | None = None
    accept_changes: bool = False


def steps_of(text: str) -> int:
    """Environment steps as people write them: 300K, 20M, 1.5e6.

    Raises:
        InvalidInput: it is no number of steps.
    """
    found = _NUMBER.fullmatch(text.strip().replace("_", "").replace(",", ""))
    number = round(float(found[1]) * _SIZES[found[2].lower()]) if found else 0
    if number < 1:
        raise InvalidInput(
            f"--steps takes a number of environment steps, such as 300K, 20M or 1500000, got "
            f"{text!r}"
        )
    return number


def check_steps(steps: str | None, others: Sequence[str]) -> None:
    """Refuse options that belong to the other way of counting.

    Raises:
        InvalidInput: a strategy without steps, or an option that means nothing with them.
    """
    if steps is None:
        raise InvalidInput("--strategy decides how steps are spent; say how many with --steps")
    if others:
        raise InvalidInput(
            f"with --steps a strategy decides what is trained, so {' and '.join(others)} "
            f"{'means' if len(others) == 1 else 'mean'} nothing; leave that out, or leave --steps "
            "out to count trainings"
        )


def run_steps(
    wish: StepWish,
    place: Path | None,
    *,
    new: bool,
    failures: int,
    timeout: float | None,
    as_json: bool,
) -> None:
    """Make the study or go on with it, spend its steps, and sum up."""
    check_limits(LEASE, timeout)
    cmdp = resolve_cmdp(wish.problem, engine=wish.engine, score=wish.score)
    strategy = strategy_named(wish.strategy or DEFAULT)  # before a study is set aside
    given = {
        "timesteps": wish.timesteps, "episodes": wish.episodes, "tensorboard": wish.tensorboard,
    }  # fmt: skip
    overrides = {name: value for name, value in given.items() if value is not None}
    trainer = cmdp.trainer_for(wish.preset, **overrides)
    name = f"{cmdp.id}-{wish.preset or cmdp.default_preset}-steps-seed{wish.seed}"
    folder = place or Path("runs") / name
    artifacts, url = wish.artifacts, wish.workers
    if url is not None:
        check_master(url, new=new, parallel=1, tensorboard=wish.tensorboard)
        artifacts = artifacts_for(url, artifacts, folder)
    if new:
        set_aside(folder)
    if url is None:
        check_folder(folder)
    study = create_step_study(
        cmdp,
        preset=wish.preset,
        trainer=trainer,
        budget=wish.budget,
        strategy=strategy,
        episodes=wish.eval_episodes,
        seed=wish.seed,
        storage=folder / "study.db" if url is None else url,
        artifacts=artifacts,
        name=study_in(folder) if url is None else folder.resolve().name,
        load_if_exists=True,
    )
    _announce(study, trainer, folder)
    if url is not None:
        start = command(
            url, study.name, wish.problem, engine=wish.engine, score=wish.score, artifacts=artifacts
        )
        follow(study, start)
    with StepProgress(console) as live:
        study.run(
            progress=False,
            callbacks=[live],
            stop_after_failures=failures,
            timeout=timeout,
            accept_changes=wish.accept_changes,
        )
    _finish(study, trainer, folder, as_json=as_json)


def _announce(study: StepStudy, trainer: Trainer, folder: Path) -> None:
    spec, spent = study.spec, study.state.spent
    marks, unit = [counted(length) for length in spec.lengths], "steps"
    if trainer.counts == "episodes" and (whole := trainer.whole) is not None:
        marks = [str(round(in_units(mark, trainer, spec) * whole)) for mark in spec.lengths]
        unit = f"episodes of up to {spec.horizon} steps"
    going_on = f", going on after {counted(spent)}" if spent and not study.is_finished else ""
    console.print(
        f"{spec.problem}: {study.space!r}, {counted(spec.budget)} steps for trainings of "
        f"{', '.join(marks)} {unit}, study in {folder}{going_on}",
        markup=False,
        highlight=False,
        soft_wrap=True,
    )


def _finish(study: StepStudy, trainer: Trainer, folder: Path, *, as_json: bool) -> None:
    """Save the portfolio and a picture, then print the summary."""
    summary, files, notes = study.summary(), {}, []
    if study.state.policies:
        portfolio = study.portfolio(trainer)
        try:
            portfolio.save(folder / "portfolio", overwrite=True, allow_missing=True)
            files["portfolio"] = str(folder / "portfolio")
            files["policy map"] = str(save(policy_map(portfolio), folder / "policy-map.png"))
        except (MissingExtra, StorageError) as error:
            notes.append(f"no portfolio or picture: {error}")
    if as_json:
        print_json({**summary.to_json(), "study": str(folder), "files": files, "notes": notes})
        return
    screen = printer()
    show_steps(screen, summary, study.space)
    for line in [*notes, *(f"{what}: {path}" for what, path in files.items())]:
        screen.print(line, style="dim", markup=False, highlight=False, soft_wrap=True)
