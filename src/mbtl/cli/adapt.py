"""`mbtl adapt`: tune the policy that serves one target, and keep it where it is better."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from mbtl.cli.common import JsonFlag, LongWork, console, print_json, printer
from mbtl.cli.run import steps_of
from mbtl.contexts import Context, ContextSpace
from mbtl.errors import InvalidInput
from mbtl.portfolio import Portfolio, load_portfolio
from mbtl.problems import CMDP, get_cmdp, resolve_cmdp
from mbtl.problems.adapting import adapt as adapted_to
from mbtl.problems.adapting import with_adapted


def adapt(
    portfolio: Annotated[Path, typer.Argument(help="Folder of a portfolio, runs/.../portfolio.")],
    to: Annotated[list[str], typer.Option(help="The target, NAME=VALUE; repeat for each axis.")],
    problem: Annotated[
        str | None, typer.Option(help="my_file.py:problem, where it is of a problem of yours.")
    ] = None,
    steps: Annotated[
        str | None, typer.Option(help="Environment steps to train, as 200K; default: one training.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder to write; default: the portfolio itself.")
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of the training and of the episodes.")] = 0,
    trust: Annotated[
        bool, typer.Option("--trust", help="Read policies that can run code, of a maker you trust.")
    ] = False,
    as_json: JsonFlag = False,
) -> None:
    """Tune the policy that serves a target for it; the portfolio gets it if it is better there.

    Both are played in the same fresh episodes of the target, which may lie between the contexts.

    Example: mbtl adapt runs/my-pendulum-default-seed0/portfolio --to gravity=7.3 --steps 200K
    --problem my_problem.py:problem --trust
    """
    known = load_portfolio(portfolio, trust=trust)
    cmdp = _problem_of(known, problem)
    if known.policy_format != "mlp" and not trust:
        raise InvalidInput(
            f"policies of the format {known.policy_format!r} can run code when they are read, got "
            "no --trust; give it if you trust who made them"
        )
    target, log = context_of(to, cmdp.space), LongWork(console)
    trainer = cmdp.facts().trainer
    assert trainer is not None
    length = 1.0
    if steps is not None:
        if trainer.whole is None or trainer.counts != "steps":
            what = "nothing" if trainer.whole is None else trainer.counts
            raise InvalidInput(
                f"--steps is for trainers that count them, got one that counts {what}; leave it "
                "out for one whole training"
            )
        length = steps_of(steps) / trainer.whole
    with console.status("training"):
        found = adapted_to(
            known, cmdp, target, length=length, seed=seed,
            on_progress=lambda told: log.say(f"{told.step:,} of {told.total:,} {told.unit}"),
        )  # fmt: skip
    place = portfolio if out is None else out
    if found.is_better:
        with_adapted(known, cmdp, found, place, say=log.say)
    if as_json:
        record: dict[str, Any] = {"target": target, "before": found.before.tolist()}
        record |= {"after": found.after.tolist(), "lead": found.lead, "margin": found.margin}
        print_json({**record, "written": str(place) if found.is_better else None})
        return
    kept = f"Nothing was kept, and {portfolio} is as it was."
    if found.is_better:
        kept = f"It is policy {len(known) + 1} of {place}."
    printer().print(f"{found.explanation} {kept}", markup=False, highlight=False)


def context_of(values: list[str], space: ContextSpace) -> Context:
    """NAME=VALUE as people type them; what is no number is a choice.

    Raises:
        InvalidInput: a text without a name or a value.
        ContextMismatch: a value that its axis does not take.
    """
    found: Context = {}
    for text in values:
        name, _, value = text.partition("=")
        if not (name and value):
            raise InvalidInput(f"a context is written NAME=VALUE, got {text!r}")
        try:
            found[name] = float(value)
        except ValueError:
            found[name] = value
    own = {axis.name: axis.own([found[axis.name]])[0] for axis in space.axes if axis.name in found}
    return {**found, **own}


def _problem_of(portfolio: Portfolio, given: str | None) -> CMDP:
    """The CMDP, with the recipe of the study that made the portfolio."""
    made = portfolio.metadata.get("settings")
    made = made if isinstance(made, dict) else {}
    if given is not None:
        cmdp = resolve_cmdp(given)
    else:
        switches = made.get("switches")
        cmdp = get_cmdp(str(portfolio.cmdp), **(switches if isinstance(switches, dict) else {}))
    preset = made.get("preset")
    return cmdp.recipe(preset if preset in cmdp.presets else None)
