"""`mbtl play`: a policy at work in one context, in its simulator; in sumo-gui or as a film."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any

import typer

from mbtl.cli.common import JsonFlag, LongWork, console, print_json, printer
from mbtl.contexts import Context
from mbtl.errors import InvalidInput, StorageError, missing_extra
from mbtl.portfolio import Portfolio, load_portfolio
from mbtl.portfolio.archive import MANIFEST
from mbtl.problems import CMDP, cmdp_ids, get_cmdp
from mbtl.problems.loading import plugin_ids
from mbtl.seeds import action_seed, episode_seeds, evaluation_seeds
from mbtl.zoo.cli.film import Watched, save_film
from mbtl.zoo.cli.shared import Score
from mbtl.zoo.cmdps.engines import EnvFactory, resolved
from mbtl.zoo.cmdps.registry import engines_of


def play(
    target: Annotated[
        str,
        typer.Argument(
            help="Folder of a portfolio (runs/.../portfolio), whose policies choose; or the id of "
            "a CMDP, where choices are drawn at random."
        ),
    ],
    at: Annotated[
        list[str] | None,
        typer.Option(help="Context, NAME=VALUE; repeat for more. Default: the nominal one."),
    ] = None,
    episodes: Annotated[int, typer.Option(help="Episodes to play.")] = 1,
    seed: Annotated[int, typer.Option(help="Seed of the episodes.")] = 0,
    gui: Annotated[
        bool, typer.Option("--gui", help="Show it in sumo-gui, where there is a screen.")
    ] = False,
    score: Score = None,
    film: Annotated[
        Path | None, typer.Option(help="Save the first episode as this GIF, 30 s at most.")
    ] = None,
    trust: Annotated[
        bool,
        typer.Option("--trust", help="Read policies that can run code, of a maker you trust."),
    ] = False,
    json: JsonFlag = False,
) -> None:
    """Play episodes of a CMDP in its simulator and print what they are worth.

    The same episodes are played without a policy, too, where the system goes on by itself. A film
    is of the first episode.

    Example: mbtl play runs/ring-acc-quick-seed0/portfolio --at hold=5 --film ring.gif
    """
    if episodes < 1:
        raise InvalidInput(f"--episodes must be >= 1, got {episodes}")
    from mbtl.envs import rollout
    from mbtl.envs.references import ByItself, ways_of
    from mbtl.report.reference import REFERENCE_NAMES
    from mbtl.trainers.sb3_learning import actor_for

    if film is not None:
        _check_film(film)
    portfolio = None if target in cmdp_ids() else _portfolio(target, trust)
    made = {} if portfolio is None else _record(portfolio.metadata, "settings")
    switches = _record(made, "switches") | ({} if score is None else {"score": score})
    cmdp = _cmdp(target if portfolio is None else str(portfolio.cmdp), switches)
    nominal = dict(cmdp.nominal or {})
    context = {**nominal, **_parsed(at or [])}
    nominal_part = {axis: context[axis] for axis in nominal}
    assert isinstance(cmdp.make_env, EnvFactory)
    shown = _shown(cmdp, gui, film is not None)
    make_env = replace(cmdp.make_env, options={**cmdp.make_env.options, **shown})
    log, status = LongWork(console), console.status("playing")

    def says(words: str) -> None:
        status.update(words)
        log.say(words)

    env = Watched(make_env(context), film is not None, says, cmdp.metrics)
    if portfolio is None:
        actor, why = rollout.Actor(_AtRandom(env, seed)), "choices at random"
    else:  # other features than the axes are nobody's business but the simulator's
        choice = portfolio.explain(nominal_part)
        sampled = _record(made, "recipe").get("acting") == "sampled"
        actor, why = actor_for(portfolio.policy(choice.policy), sampled=sampled), choice.explanation
    own = evaluation_seeds(seed, 0, [_place(cmdp, nominal_part)])
    (seeds,) = episode_seeds(own, 1, episodes)
    # to the end: a score that is known is no reason to look away
    counted = None if cmdp.score is None else replace(cmdp.score, foretold=None, strata=None)
    pictures = 0
    takes = {"choices at random" if portfolio is None else "guided": env}
    with status:
        for way in () if gui else ways_of(env):
            told = partial(_aloud, says, f"{REFERENCE_NAMES.get(way, way)}: ")
            alone = ByItself(make_env(context), way)
            takes[REFERENCE_NAMES.get(way, way)] = Watched(
                alone, film is not None, told, cmdp.metrics
            )
        for take in takes.values():
            (scores,) = rollout.play(
                [rollout.Job(partial(_same, take), seeds, counted)], actor, max_envs=1
            )
            take.scores = scores.tolist()
        if film is not None:
            name = f"{cmdp.id} at {cmdp.space.describe(nominal_part)}"
            filmed = dict([*takes.items()][:1] + [*takes.items()][-1:])  # and the best baseline
            pictures = save_film(
                film, name, filmed, lambda k, n: says(f"drawing picture {k} of {n} of {film}")
            )
    found = {name: take.scores for name, take in takes.items()}
    beside = {name: _measured(take) for name, take in takes.items()}
    if json:
        print_json(
            {"cmdp": cmdp.id, "context": context, "policy": why, "scores": env.scores,
             "unit": env.unit, "all": found,
             "measures": {n: {m: v for m, (v, _) in each.items()} for n, each in beside.items()}}
        )  # fmt: skip
        return
    out = printer()
    out.print(f"{cmdp.id} at {cmdp.space.describe(context)}; {why}", markup=False, highlight=False)
    for name, worth in found.items():
        of = "score" if name == next(iter(found)) else f"{name}: score"
        unit = "" if env.unit == "return" else f" {env.unit}"
        values = " ".join(f"{score:.4g}" for score in worth)
        rest = "".join(f"; {value:.4g} {what}" for value, what in beside[name].values())
        out.print(f"{of}: {values}{unit}{rest}", markup=False, highlight=False)
    if film is not None:
        out.print(f"{pictures} pictures: {film}", markup=False, highlight=False)


def _place(cmdp: CMDP, context: Context) -> int:
    """Its index, so that a target is seen in the episodes in which a study evaluates on it.

    Anywhere else they are nobody's.
    """
    try:
        return cmdp.space.index(context)
    except InvalidInput:
        return cmdp.space.n


def _same(take: Watched) -> Watched:
    return take


def _aloud(says: Callable[[str], None], who: str, where: str) -> None:
    says(f"{who}{where}")


def _measured(take: Watched) -> dict[str, tuple[float, str]]:
    """What stands beside the score, mean over the episodes, and its unit, by name."""
    each = [take.measures(k) for k in range(len(take.ends))]
    first = each[0] if each else {}
    return {
        name: (sum(one[name][0] for one in each) / len(each), unit)
        for name, (_, unit) in first.items()
    }


class _AtRandom:
    """Choices drawn from the action space, whatever is seen."""

    def __init__(self, env: Any, seed: int) -> None:
        space = env.action_space
        self._space = space("") if callable(space) else space
        self._space.seed(action_seed(seed))

    def predict(self, observation: Any, deterministic: bool = True) -> tuple[Any, None]:
        return [self._space.sample() for _ in observation], None


def _record(record: Mapping[str, Any], key: str) -> dict[str, Any]:
    """A part of what a study noted; a portfolio may come from elsewhere and hold anything there."""
    part = record.get(key)
    return part if isinstance(part, dict) else {}


def _shown(cmdp: CMDP, gui: bool, film: bool) -> dict[str, Any]:
    """Options of the environment with which it can be seen."""
    if gui and cmdp.settings["engine"] != "sumo":
        raise InvalidInput(f"--gui is for traffic, which SUMO simulates, got {cmdp.id!r}")
    assert isinstance(cmdp.make_env, EnvFactory)
    kind: Any = resolved(cmdp.make_env.entry_point)
    if film and "rgb_array" not in kind.metadata["render_modes"]:
        raise InvalidInput(f"--film needs a CMDP that can be drawn, which {cmdp.id!r} cannot")
    return {**({"render_mode": "rgb_array"} if film else {}), **({"gui": True} if gui else {})}


def _cmdp(name: str, switches: Mapping[str, Any]) -> CMDP:
    """A CMDP in its simulator, with the switches of the study that a portfolio is of."""
    try:
        return get_cmdp(name, **{**switches, "engine": engines_of(name)[0]})
    except TypeError as error:
        raise StorageError(
            f"a portfolio must name switches of {name!r}, got {dict(switches)!r}; save it again"
        ) from error


def _portfolio(folder: str, trust: bool) -> Portfolio:
    if not (Path(folder) / MANIFEST).is_file():
        if folder in (others := plugin_ids()):
            raise InvalidInput(
                f"play takes CMDPs of our own, got {folder!r} of the package {others[folder]!r}; "
                f"step its environment, `mbtl.get_cmdp({folder!r}).make_env(context)`, if any"
            )
        raise InvalidInput(
            f"play takes the folder of a portfolio or the id of a CMDP, got {folder!r}, which is "
            "neither; `mbtl cmdps` lists the ids"
        )
    portfolio = load_portfolio(folder, trust=trust)
    if portfolio.cmdp not in cmdp_ids():
        raise InvalidInput(
            f"play takes portfolios of our own CMDPs, got one of {portfolio.cmdp!r}; step your own "
            "environment with `load_portfolio(folder).policy_for(context)`"
        )
    return portfolio


def _parsed(values: Sequence[str]) -> Mapping[str, float]:
    found = {}
    for text in values:
        name, _, value = text.partition("=")
        try:
            found[name] = float(value)
        except ValueError:
            raise InvalidInput(f"--at is written NAME=VALUE, got {text!r}") from None
    return found


def _check_film(file: Path) -> None:
    """Before anything is simulated."""
    if find_spec("PIL") is None:
        raise missing_extra("pillow", "plots")
    if file.suffix.lower() != ".gif":
        raise InvalidInput(f"--film is the name of a GIF, got {str(file)!r}; end it with .gif")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InvalidInput(f"--film needs a folder to write to, got {error}") from error
