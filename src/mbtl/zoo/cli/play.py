"""`mbtl play`: a policy at work in one context, in its simulator; in sumo-gui or as a film."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping
from csv import DictWriter
from dataclasses import replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any

import typer

from mbtl.cli.adapt import context_of
from mbtl.cli.common import JsonFlag, LongWork, console, print_json, printer
from mbtl.contexts import Context
from mbtl.errors import InvalidInput, StorageError, missing_extra
from mbtl.portfolio import Portfolio, load_portfolio
from mbtl.portfolio.archive import MANIFEST
from mbtl.problems import CMDP, cmdp_ids, get_cmdp
from mbtl.problems.loading import resolve_cmdp
from mbtl.score import RANDOM_ACTIONS
from mbtl.seeds import action_seed, episode_seeds, evaluation_seeds
from mbtl.zoo.cli.film import Watched, save_film
from mbtl.zoo.cli.shared import Score
from mbtl.zoo.cmdps.engines import EnvFactory, resolved
from mbtl.zoo.cmdps.registry import engines_of


def play(
    target: Annotated[
        str,
        typer.Argument(
            help="Folder of a portfolio (runs/.../portfolio), whose policies choose; or a CMDP, "
            "by id or my_file.py:problem, where choices are drawn at random."
        ),
    ],
    problem: Annotated[
        str | None,
        typer.Option(help="my_file.py:problem, where the portfolio is of a problem of yours."),
    ] = None,
    at: Annotated[
        list[str] | None,
        typer.Option(help="Context, NAME=VALUE; repeat for more. Default: nominal, or the middle."),
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
    csv: Annotated[
        Path | None, typer.Option(help="Save every decision in this table: seen, done, reward.")
    ] = None,
    trust: Annotated[
        bool, typer.Option("--trust", help="Read policies that can run code, of a maker you trust.")
    ] = False,
    as_json: JsonFlag = False,
) -> None:
    """Play episodes of a CMDP in its simulator and print what they are worth.

    The same episodes are played by the baselines of the problem and without a policy, too, where
    the system goes on by itself. A film is of the first episode.

    Example: mbtl play runs/ring-acc-quick-seed0/portfolio --at hold=5 --film ring.gif
    """
    if episodes < 1:
        raise InvalidInput(f"--episodes must be >= 1, got {episodes}")
    from mbtl.envs import rollout
    from mbtl.trainers.sb3_learning import actor_for

    if film is not None:
        _check_film(film)
    portfolio, cmdp, made = _opened(target, problem, score, trust)
    nominal = dict(cmdp.nominal or cmdp.space.middle)
    context = {**nominal, **context_of(at or [], cmdp.space)}
    nominal_part = {axis: context[axis] for axis in nominal}
    if not isinstance(cmdp.make_env, EnvFactory):  # which checks by itself
        cmdp.space.encode(context)
    make_env = _maker(cmdp, gui, film is not None)
    log, status = LongWork(console), console.status("playing")

    def says(words: str) -> None:
        status.update(words)
        log.say(words)

    def watched(env: Any, name: str) -> Watched:
        unit = None if cmdp.score is None or not cmdp.score.unit else cmdp.score.unit
        tell = partial(_aloud, says, f"{name}: " if name else "")
        return Watched(env, film is not None, tell, cmdp.metrics, unit, noting=csv is not None)

    first = watched(make_env(context), "")
    _check_drawn(cmdp, first, film)
    random = rollout.Actor(_AtRandom(first, seed))
    name, actor, why = "choices at random", random, "choices at random"
    if portfolio is not None:  # other features than the axes are nobody's business
        choice = portfolio.explain(nominal_part)
        sampled = _record(made, "recipe").get("acting") == "sampled"
        actor = actor_for(portfolio.policy(choice.policy), sampled=sampled)
        name, why = "guided", choice.explanation
    takes, actors = {name: first}, {name: actor}
    if not gui:
        for other, env, acts in _beside(cmdp, first.env, partial(make_env, context), actor, random):
            takes[other], actors[other] = watched(env, other), acts
    own = evaluation_seeds(seed, 0, [_place(cmdp, nominal_part)])
    (seeds,) = episode_seeds(own, 1, episodes)
    # to the end: a score that is known is no reason to look away
    counted = None if cmdp.score is None else replace(cmdp.score, foretold=None, strata=None)
    pictures = 0
    with status:
        for name, take in takes.items():
            job = rollout.Job(partial(_same, take), seeds, counted)
            (scores,) = rollout.play([job], actors[name], max_envs=1)
            take.scores = scores.tolist()
        if film is not None:
            name = f"{cmdp.id} at {cmdp.space.describe(nominal_part)}"
            filmed = dict([*takes.items()][:1] + [*takes.items()][-1:])  # and the best baseline
            pictures = save_film(
                film, name, filmed, lambda k, n: says(f"drawing picture {k} of {n} of {film}")
            )
        if csv is not None:
            _write(csv, takes)
    files = {f"{pictures} pictures": film, "every decision": csv}
    _tell(cmdp, context, why, takes, {what: file for what, file in files.items() if file}, as_json)


def _tell(
    cmdp: CMDP,
    context: Context,
    why: str,
    takes: Mapping[str, Watched],
    files: Mapping[str, Path],
    as_json: bool,
) -> None:
    """Print what was played."""
    first = next(iter(takes))
    unit = takes[first].unit
    beside = {name: _measured(take) for name, take in takes.items()}
    if as_json:
        print_json(
            {"cmdp": cmdp.id, "context": context, "policy": why, "scores": takes[first].scores,
             "unit": unit, "all": {name: take.scores for name, take in takes.items()},
             "measures": {n: {m: v for m, (v, _) in each.items()} for n, each in beside.items()}}
        )  # fmt: skip
        return
    out = printer()
    out.print(f"{cmdp.id} at {cmdp.space.describe(context)}; {why}", markup=False, highlight=False)
    for name, take in takes.items():
        values = " ".join(f"{score:.4g}" for score in take.scores)
        rest = "".join(
            f"; {what} {value:.4g} {of}".rstrip() for what, (value, of) in beside[name].items()
        )
        said = f"{name}: score {values}{'' if unit == 'return' else f' {unit}'}{rest}"
        out.print(said, markup=False, highlight=False)
    for what, file in files.items():
        out.print(f"{what}: {file}", markup=False, highlight=False)


def _beside(
    cmdp: CMDP, first: Any, make: Callable[[], Any], actor: Any, random: Any
) -> Iterator[tuple[str, Any, Any]]:
    """What else is played: name, environment, and who acts in it."""
    from mbtl.envs.references import ByItself, ways_of
    from mbtl.report.reference import REFERENCE_NAMES
    from mbtl.trainers.sb3_learning import actor_for

    for way in ways_of(first):
        yield REFERENCE_NAMES.get(way, way), ByItself(make(), way), actor
    for name, baseline in cmdp.baselines.items():
        if baseline == RANDOM_ACTIONS:
            if actor is not random:
                yield name, make(), random
        elif not isinstance(baseline, str):  # a way is there already
            yield name, make(), actor_for(baseline)


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


def _opened(
    target: str, problem: str | None, score: str | None, trust: bool
) -> tuple[Portfolio | None, CMDP, dict[str, Any]]:
    """What is played: the portfolio, if any, its problem, and what its study noted."""
    switches = {} if score is None else {"score": score}
    if not (Path(target) / MANIFEST).is_file():
        if ":" in target:
            return None, resolve_cmdp(target, **switches), {}
        if target in cmdp_ids():
            return None, _in_simulator(target, switches), {}
        raise InvalidInput(
            "play takes the folder of a portfolio, the id of a CMDP, or my_file.py:problem, got "
            f"{target!r}, which is neither; `mbtl cmdps` lists the ids"
        )
    if problem is not None:
        cmdp = resolve_cmdp(problem, **switches)
        portfolio = load_portfolio(target, trust=trust, load=cmdp.trainer.load)
        return portfolio, cmdp, _record(portfolio.metadata, "settings")
    portfolio = load_portfolio(target, trust=trust)
    made, id = _record(portfolio.metadata, "settings"), str(portfolio.cmdp)
    if id in cmdp_ids():
        return portfolio, _in_simulator(id, _record(made, "switches") | switches), made
    raise InvalidInput(
        f"a portfolio of your own problem is played in it, got one of {id!r}; add --problem "
        "my_file.py:problem"
    )


def _in_simulator(name: str, switches: Mapping[str, Any]) -> CMDP:
    """A CMDP of ours in its simulator, with the switches of the study that a portfolio is of."""
    try:
        return get_cmdp(name, **{**switches, "engine": engines_of(name)[0]})
    except TypeError as error:
        raise StorageError(
            f"a portfolio must name switches of {name!r}, got {dict(switches)!r}; save it again"
        ) from error


def _maker(cmdp: CMDP, gui: bool, film: bool) -> Callable[[Context], Any]:
    """Context -> environment, one that can be seen if that is asked for."""
    make_env = cmdp.make_env
    if gui and cmdp.settings.get("engine") != "sumo":
        raise InvalidInput(f"--gui is for traffic, which SUMO simulates, got {cmdp.id!r}")
    if make_env is None:
        raise InvalidInput(
            f"play steps an environment, and {cmdp.id!r} is made of functions; give it "
            "make_env=..., too"
        )
    if isinstance(make_env, EnvFactory):
        kind: Any = resolved(make_env.entry_point)
        if film and "rgb_array" not in kind.metadata["render_modes"]:
            raise InvalidInput(f"--film needs a CMDP that can be drawn, which {cmdp.id!r} cannot")
        seen = {**({"render_mode": "rgb_array"} if film else {}), **({"gui": True} if gui else {})}
        return replace(make_env, options={**make_env.options, **seen})
    inner = getattr(make_env, "make_env", make_env)  # of one that shows the context
    drawn = film and "render_mode" in inspect.signature(inner).parameters
    made: Callable[..., Any] = make_env
    return partial(made, render_mode="rgb_array") if drawn else made


def _check_drawn(cmdp: CMDP, env: Watched, film: Path | None) -> None:
    if film is not None and getattr(env.env, "render_mode", None) != "rgb_array":
        raise InvalidInput(
            f"--film needs environments with render_mode='rgb_array', got one of {cmdp.id!r} with "
            f"{getattr(env.env, 'render_mode', None)!r}; let make_env take render_mode=None, or "
            "see the numbers: --csv FILE"
        )


def _write(file: Path, takes: Mapping[str, Watched]) -> None:
    """Every decision of all takes as a table."""
    rows = [{"who": name, **row} for name, take in takes.items() for row in take.rows]
    heads = list(dict.fromkeys(head for row in rows for head in row))
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with file.open("w", newline="", encoding="utf-8") as out:
            table = DictWriter(out, heads, restval="")
            table.writeheader()
            table.writerows(rows)
    except OSError as error:
        raise InvalidInput(f"--csv needs a file that can be written, got {error}") from error


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
