"""`mbtl run`: the main job.

Train what the strategy picks, evaluate everywhere, save the portfolio.
"""

from __future__ import annotations

import contextlib
import re
import shlex
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from mbtl.cli.common import JsonFlag, console, option, print_json, printer
from mbtl.cli.folders import DATABASE, check_folder, renamed, set_aside, study_in
from mbtl.cli.master import artifacts_for, check_master, command, follow
from mbtl.cli.progress import LiveProgress
from mbtl.cli.worker import check_evaluated
from mbtl.errors import InvalidInput, MissingExtra, StorageError, TrainingFailed, written
from mbtl.files import MALFORMED, read_json
from mbtl.objective import Objective
from mbtl.plot import curve, policy_map, save
from mbtl.portfolio.archive import MANIFEST
from mbtl.problems import resolve_cmdp
from mbtl.report import reference_curves, summarise_study
from mbtl.report.text import show_summary
from mbtl.study import Evaluation, Failures, Steps, Stopping, Study, Workers, ask, create_study
from mbtl.study.study import run as run_study
from mbtl.trainers.contract import Trainer

NOTHING_LEFT = 0.005
"""Gain in V of all trainings left together that is not worth one of them."""


_recipe = partial(option, "Recipe and evaluation")
_stop = partial(option, "Aim and end")
_failed = partial(option, "Failed trainings")
_work = partial(option, "Workers and files")


def run(
    problem: Annotated[
        str,
        typer.Argument(
            metavar="CMDP", help="Id of a CMDP (`mbtl cmdps`), or module:problem of your own."
        ),
    ],
    preset: Annotated[str | None, option(None, "Recipe; `mbtl cmdps CMDP` lists them.")] = None,
    budget: Annotated[
        int | None, option(None, "Units: whole trainings on one context; default: the preset's.")
    ] = None,
    steps: Annotated[
        str | None, option(None, "Pay in environment steps, all in: 20M.", metavar="NUMBER")
    ] = None,
    strategy: Annotated[
        str, option(None, "auto, mbtl (the paper's), specialists, one-policy, my.py:Mine, ...")
    ] = "auto",
    seed: Annotated[int, option(None, "Root of all randomness.")] = 0,
    study: Annotated[
        Path | None, option(None, "Folder; default: runs/<cmdp>-<preset>-seed<seed>.")
    ] = None,
    new: Annotated[bool, option(None, "Set an existing study aside.", "--new")] = False,
    parallel: Annotated[int, option(None, "Trainings at a time.")] = 1,
    as_json: JsonFlag = False,
    timesteps: Annotated[int | None, _recipe("Steps per training.")] = None,
    episodes: Annotated[int | None, _recipe("Episodes per training, if so counted.")] = None,
    eval_episodes: Annotated[int | None, _recipe("Episodes per context and policy.")] = None,
    eval_targets: Annotated[int | None, _recipe("Evaluate policies on so many contexts.")] = None,
    engine: Annotated[
        str | None, _recipe("jax, gymnasium, sumo, sumo-jax; default: fastest.")
    ] = None,
    score: Annotated[str | None, _recipe("Of traffic: paper, or the CMDP's own.")] = None,
    risk: Annotated[float, _stop("V: mean of this worst share of contexts.")] = 1.0,
    stop_value: Annotated[float | None, _stop("End when V reaches this.")] = None,
    whole_budget: Annotated[bool, _stop("End only when all is spent.", "--all")] = False,
    no_report: Annotated[bool, _stop("No fresh episodes at the end.", "--no-report")] = False,
    report_all: Annotated[bool, _stop("Those on all contexts there are.", "--report-all")] = False,
    stop_after_failures: Annotated[int, _failed("End after so many in a row.")] = 3,
    retries: Annotated[int, _failed("Begin a failed one again so often.")] = 0,
    retry_failed: Annotated[bool, _failed("Train those again.", "--retry-failed")] = False,
    timeout: Annotated[float | None, _failed("Seconds of a training at most.")] = None,
    no_rehearsal: Annotated[bool, _failed("No trial evaluation before.", "--no-rehearsal")] = False,
    accept_changes: Annotated[bool, _failed("Your functions changed.", "--accept-changes")] = False,
    workers: Annotated[
        str | None, _work("Wait here while `mbtl worker`s train.", metavar="URL")
    ] = None,
    artifacts: Annotated[str | None, _work("Folder or URL of the policies.")] = None,
) -> None:
    """Train policies on the contexts that pay most, and serve all contexts with the best of them.

    Interrupt it at any time; the same command goes on where it was.

    \b
    Example: mbtl run cartpole-length --budget 6 --seed 1
    Paid in steps: mbtl run cartpole-length --steps 2M
    The paper's run: mbtl run cartpole-length --preset paper --strategy mbtl
    On a cluster: mbtl run cartpole-length --workers postgresql+psycopg://me@db/studies
    """  # noqa: D301 - the command line's own mark of lines that stay
    if steps is not None and budget is not None:
        raise InvalidInput(
            "a study pays in environment steps (--steps) or in trainings (--budget), got both; "
            "leave one out"
        )
    if report_all and (no_report or risk < 1.0):
        raise InvalidInput(
            "--report-all plays the fresh episodes on all contexts, got --no-report, or a --risk "
            "below 1, which has none; leave one out"
        )
    pay = budget if steps is None else Steps(steps_of(steps))
    switches = {"engine": engine, "score": score}
    cmdp = resolve_cmdp(problem, **switches)
    if timesteps is not None and cmdp.preset(preset).episodes is not None:
        raise InvalidInput(
            f"trainings of {cmdp.id!r} last a number of episodes, got --timesteps {timesteps}; use "
            "--episodes"
        )
    lengths: dict[str, Any] = {"timesteps": timesteps, "episodes": episodes}
    lengths["eval_episodes"] = eval_episodes
    cmdp = cmdp.recipe(preset, **{k: v for k, v in lengths.items() if v is not None})
    pay_how = "-steps" if steps is not None else ""
    recipe = cmdp.facts().settings["preset"]
    folder = study or Path("runs") / f"{cmdp.id}-{recipe}{pay_how}-seed{seed}"
    alone = Workers(parallel, timeout=timeout)
    failing = Failures(stop_after_failures, retries=retries,
                       retry_failed=retry_failed and workers is None,
                       rehearse=not no_rehearsal)  # fmt: skip
    if workers is not None:
        check_master(workers, new=new, parallel=parallel)
        artifacts = artifacts_for(workers, artifacts, folder)
    own = workers is None or Path(workers).resolve() == (folder / DATABASE).resolve()
    make = partial(
        create_study,
        cmdp,
        budget=pay,
        strategy=strategy,
        objective=Objective(risk=risk),
        evaluation=Evaluation(eval_targets),
        stopping=Stopping(
            stop_value, left=None if whole_budget or cmdp.bounds is None else NOTHING_LEFT
        ),
        seed=seed,
        artifacts=artifacts,
    )
    if new:
        make()  # what is refused must not set a study aside
        set_aside(folder)
    if workers is None:
        check_folder(folder)
    running = make(
        storage=folder / DATABASE if workers is None else workers,
        name=study_in(folder) if own else folder.resolve().name,
        load_if_exists=True,
    )
    _announce(running, folder)
    trainer, ended = cmdp.facts().trainer, None
    assert trainer is not None
    if workers is not None:
        given = {**switches, "artifacts": artifacts}
        start = command(workers, running.name, problem, strategy, **given)
        running.equip(trainer, accept_changes=accept_changes)  # workers hear of other code at once
        follow(running, start, retry_failed=retry_failed)
    with LiveProgress(running, console) as live:
        try:
            run_study(
                running,
                trainer,
                workers=alone,
                failures=failing,
                callbacks=[live],
                accept_changes=accept_changes,
                report="all" if report_all else not no_report,
            )
        except TrainingFailed as error:
            if not running.state.rows:
                raise
            ended = error  # the policies that there are serve all the same
    if running.is_finished and not (running.state.rows or running.state.failures):
        raise TrainingFailed(f"nothing was trained: {running.stop_reason}")
    _finish(running, trainer, folder, as_json=as_json)
    if ended is not None:
        raise ended
    check_evaluated(running)


_NUMBER = re.compile(r"(\d+(?:\.\d+)?(?:e\d+)?)\s*([kmg]?)", re.IGNORECASE)
_SIZES = {"": 1, "k": 10**3, "m": 10**6, "g": 10**9}


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


def _announce(study: Study, folder: Path) -> None:
    spec = study.spec
    going_on = ""
    if study.state.rows and not study.is_finished:
        going_on = f", going on after {study.state.spent_words(answered=True)}"
    console.say(f"{spec.problem}: {study.space!r}, {spec.size}, study in {folder}{going_on}")


def _keep_tuned(place: Path) -> None:
    """Set a portfolio aside that has policies beside those of the study (`mbtl adapt`)."""
    tuned = False
    with contextlib.suppress(OSError, *MALFORMED):
        made = read_json((place / MANIFEST).read_text("utf-8"))
        tuned = bool(made["metadata"].get("adapted"))
    if tuned:
        with written(place):
            renamed(place)


def _finish(study: Study, trainer: Trainer, folder: Path, *, as_json: bool) -> None:
    """Save the portfolio and pictures, then print the summary."""
    summary = summarise_study(study)
    files: dict[str, str] = {}
    notes: list[str] = []
    if under_way := len(ask.others(study.state, study.watch(), study.worker)):
        notes.append(
            f"{under_way} other {'process works' if under_way == 1 else 'processes work'} on this "
            "study, so more may come; the same command shows it later"
        )
    if study.state.failures:
        count = len(study.state.failures)
        notes.append(
            f"{count} {'training' if count == 1 else 'trainings'} failed: `mbtl study show "
            f"{shlex.quote(str(folder))}` says why, --retry-failed trains there again"
        )
    if study.state.rows:
        portfolio = study.portfolio(trainer)
        if portfolio.policies_missing:
            notes.append(
                f"of {len(portfolio.policies_missing)} policies the portfolio holds returns and "
                "routes only: without save and load functions, or --artifacts of workers, they end "
                "with the process that made them"
            )
        try:
            _keep_tuned(folder / "portfolio")
            portfolio.save(folder / "portfolio", overwrite=True, allow_missing=True)
            files["portfolio"] = str(folder / "portfolio")
        except StorageError as error:
            notes.append(f"no portfolio: {error}")
        if (curves := reference_curves(study)) is not None:
            notes.append(curves.said)
        try:
            drawn = curve(study, baselines={} if curves is None else curves.baselines)
            files["curve"] = str(save(drawn, folder / "curve.png"))
            files["policy map"] = str(save(policy_map(study), folder / "policy-map.png"))
        except (MissingExtra, StorageError) as error:
            notes.append(f"no pictures: {error}")
    if as_json:
        print_json({**summary.to_json(), "study": str(folder), "files": files, "notes": notes})
        return
    screen = printer()
    show_summary(screen, summary, study.space)
    for line in [*notes, *(f"{what}: {path}" for what, path in files.items())]:
        screen.say(line, "dim")
