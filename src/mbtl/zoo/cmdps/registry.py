"""Our CMDPs by id."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mbtl.errors import InvalidInput, check_known
from mbtl.problems.cmdp import CMDP, Preset
from mbtl.trainers.contract import Trainer
from mbtl.zoo.cmdps.engines import ENGINES, EnvFactory, JaxProblem, TwinProblem, jax_is_installed
from mbtl.zoo.cmdps.families import FAMILIES, VARIANTS
from mbtl.zoo.cmdps.family import Family, TwinFamily, Variant

_CHOICES: Mapping[str, tuple[str, ...]] = {
    "physics": ("intended", "reference"),
    "visibility": ("hidden", "multiplier", "raw"),
    "grid": ("code", "paper"),
    "time limit": ("truncation", "terminal"),
    "obs": ("fresh", "stale"),
    "engine": ENGINES,
}


def cmdp_ids() -> list[str]:
    """Ids that `get_cmdp` takes."""
    return list(VARIANTS)


def engines_of(id: str) -> list[str]:
    """Where a CMDP is simulated; each has presets of its own."""
    _, family = _entry(id)
    others = {"jax": family.jax is not None, "sumo-jax": bool(family.in_processes)}
    return [family.simulator, *(engine for engine, there in others.items() if there)]


def gym_id(id: str) -> str:
    """Gymnasium id of a CMDP, e.g. "mbtl/cartpole-length-v0"."""
    variant, _ = _entry(id)
    return f"mbtl/{id}-v{variant.version}"


def visibility_on_all(id: str) -> str:
    """What of the context one policy for all contexts sees: the multiplier, but no hold (7.4)."""
    return _entry(id)[1].visibility_on_all


def paper_bounds(id: str) -> tuple[float, float] | None:
    """Returns of performance 0 and 1 in the paper, where ours are not enough to say."""
    return _entry(id)[1].paper_bounds


def preset_on_all(id: str) -> str:
    """Whose steps one policy for all contexts has: those of the matrix to compare it with."""
    return _entry(id)[1].preset_on_all


def env_factory(
    id: str,
    *,
    physics: str = "intended",
    visibility: str | None = None,
    time_limit: str = "truncation",
    obs: str = "fresh",
    score: str | None = None,
    grid: str = "code",
) -> EnvFactory:
    """The environment factory of a CMDP; arguments as in `get_cmdp`."""
    variant, family = _entry(id)
    family = family.scored(score)
    if visibility is None:
        visibility = family.visibility if variant.visibility is None else variant.visibility
    switches = {"physics": physics, "obs": obs}
    for kind, name in {
        "visibility": visibility, "time limit": time_limit, "grid": grid, **switches
    }.items():  # fmt: skip
        _check_choice(kind, name)
    options = {
        "unit": variant.unit("code"),
        "visibility": visibility,
        "time_limit": time_limit,
        "horizon": family.horizon,
        **{name: switches[name] for name in family.switches},
        **({"score": score or next(iter(family.scores))} if family.scores else {}),
    }
    return EnvFactory(family.entry_point, options, tuple(variant.levels(grid)))


def get_cmdp(
    id: str,
    *,
    physics: str = "intended",
    visibility: str | None = None,
    grid: str = "code",
    time_limit: str = "truncation",
    obs: str = "fresh",
    score: str | None = None,
    engine: str | None = None,
) -> CMDP:
    """One of our CMDPs.

    Args:
        id: e.g. "cartpole-length"; `cmdp_ids()` lists all of ours.
        physics: "intended": contexts act as the paper says. "reference": as in the released code,
            whose CartPole freezes derived masses (spec, section 1); Pendulum is the same in both.
        visibility: what of the context the policy sees: "hidden", "multiplier" or "raw"; None: the
            CMDP's default: "multiplier"; in ring, ramp, signal and eco-inflow "hidden", as in the
            reference (spec, 3, 6.2 and 11).
        grid: "code": contexts of the released scripts. "paper": of the paper's text. The same for
            CartPole and Pendulum.
        time_limit: how the horizon is reported, "truncation" or "terminal" (the reference).
        obs: what an advised driver sees (ring, ramp): "fresh", the state at the decision, or
            "stale", that of one hold before, as in the reference.
        score: what an episode is worth. None: in eco-driving "everyone", the mean speed of all
            cars, those waiting to enter included; of signals "delay", seconds per car. "paper": the
            paper's, which does not see who waits outside. Of the others there is one only.
        engine: "jax" (vectorised, needs the extra), or Stable-Baselines3 in the simulator of the
            family, "gymnasium" or "sumo", or "sumo-jax", the learners of jax in SUMO; None: jax
            where it is installed and this CMDP has it. The presets are those of the engine.

    Raises:
        UnknownName: no CMDP has this id, or a switch has no such setting.
        InvalidInput: this CMDP is not simulated in that engine.
    """
    variant, family = _entry(id)
    family = family.scored(score)
    if engine is None:
        engine = "jax" if family.jax is not None and jax_is_installed() else family.simulator
    _check_choice("engine", engine)
    make_env = env_factory(
        id,
        physics=physics,
        visibility=visibility,
        time_limit=time_limit,
        obs=obs,
        score=score,
        grid=grid,
    )
    presets, trainer = _training(id, family, engine, make_env)
    return CMDP(
        id,
        variant.space(grid),
        trainer,
        bounds=family.bounds,
        floor=family.floor,
        best_return=family.best_return,
        theta=family.theta if variant.theta is None else variant.theta,
        version=variant.version,
        make_env=make_env,
        score=family.score,
        nominal=variant.nominal,
        unit=variant.unit(grid),
        horizon=family.horizon,
        check_steps=family.check_steps,
        family=variant.family,
        presets=presets,
        settings={
            "physics": physics,
            "visibility": make_env.options["visibility"],
            "grid": grid,
            "time_limit": time_limit,
            "engine": engine,
            **({"obs": obs} if "obs" in family.switches else {}),
            **({"score": make_env.options["score"]} if family.scores else {}),
        },
        description=variant.description,
        metrics=family.metrics,
    )


def _entry(id: str) -> tuple[Variant, Family]:
    check_known("CMDP", id, VARIANTS, hint="`mbtl cmdps` lists all.")
    variant = VARIANTS[id]
    return variant, FAMILIES[variant.family]


def _check_choice(kind: str, name: str) -> None:
    check_known(kind, name, _CHOICES[kind])


def _training(
    id: str, family: Family, engine: str, make_env: EnvFactory
) -> tuple[Mapping[str, Preset], Trainer]:
    """Recipes of the engine, and the trainer of the first of them."""
    if engine == family.simulator:
        from mbtl.trainers import SB3Trainer

        default = next(iter(family.presets.values()))
        # a process has room for one simulation in libsumo: evaluate one at a time, train elsewhere
        alone: dict[str, Any] = {"n_eval_envs": 1, "processes": True} if engine == "sumo" else {}
        ours: dict[str, Any] = {"score": family.score, "apart": False, **alone}
        return family.presets, SB3Trainer(make_env, **ours, **default.options())
    if engine not in engines_of(id):
        there = " and ".join(engines_of(id))
        raise InvalidInput(f"{id!r} is simulated in {there}, got engine={engine!r}")
    from mbtl.engine import SceneProblem, WorldTrainer

    if engine == "sumo-jax":
        default = next(iter(family.in_processes.values()))
        scenes = SceneProblem(make_env, make_env.options["time_limit"], family.score)
        return family.in_processes, WorldTrainer(scenes, **default.options())
    record = family.jax
    assert record is not None  # `engines_of` says so
    default = next(iter(record.presets.values()))
    problem: JaxProblem | TwinProblem
    if isinstance(record, TwinFamily):
        problem = TwinProblem(record.problem, make_env, record.options)
    else:
        problem = JaxProblem(record.environment, make_env, record.on_host)
    return record.presets, WorldTrainer(problem, **default.options())
