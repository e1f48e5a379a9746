"""What MBTL's policies do in traffic beside what they are scored by.

    .venv/bin/python evidence/beside_the_score.py [CMDP ...] [--seed 0] [--budget 15]
        [--episodes 20] [--policies FOLDER]

A score can be gained by harm that it does not see: a ramp is fast when few cars enter. So the
contexts that `mbtl` picks in a shipped matrix are trained in the twin again, with the seeds of that
matrix, and each context is served by the policy that is best in one set of episodes. Played in
another set, these policies, each context's own where it was picked, and traffic that nobody advises
are compared by measures of the twin: means over contexts, the lowest and the highest context
where the fifteen serve, and in how many they are below unguided traffic. `--policies` keeps trained
policies, and takes those that are there.

example: taskset -c 0 python evidence/beside_the_score.py ramp-acc --policies runs/fifteen
"""

from __future__ import annotations

import measure  # noqa: F401  first: threads

import argparse  # isort: skip
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import mbtl.engine.learners  # noqa: F401  isort: skip  # first: flags of jax
import jax
import jax.numpy as jnp
import numpy as np

from mbtl.engine.learners.episodic.episodes import Actor, go_on, import_actor
from mbtl.engine.worlds.world import context_of, in_a_row, of_simulations
from mbtl.problems import get_cmdp
from mbtl.seeds import MATRIX_TRIAL, Purpose, episode_seeds, evaluation_seeds, training_seed
from mbtl.zoo.benchmark import compare, load_matrix

MEASURES = {
    "ramp": {
        "score": "m/s", "throughput": "cars/h", "dropped": "share dropped", "collided": "collided",
    },
    "eco": {"score": "m/s", "co2": "g CO2", "stops": "stops", "throughput": "cars/h"},
}  # fmt: skip
"""By family: names in the twin and their units."""


Means = dict[str, Any]
"""By measure, (P, C) means over episodes."""


@partial(jax.jit, static_argnums=(0, 1, 2))
def _measures(
    world: Any, activation: Any, how: Any, actor: Any, seeds: Any, params: Any, decisions: Any
) -> Any:
    """By measure, (P, E): episodes of P policies in one context."""
    every = of_simulations(params, seeds.shape[1])
    state = world.start(world.draws(seeds).reshape(-1), every)
    end = go_on(world, activation, how, actor, seeds, every, state, 0, decisions)
    return {name: x.reshape(seeds.shape) for name, x in world.measures(end).items()}


def played(
    trainer: Any, policies: Sequence[Any], contexts: Sequence[Any], seeds: Sequence[int]
) -> Means:
    """The episodes of an evaluation with these seeds; without policies traffic is unguided."""
    world, params = trainer.problem(contexts)
    activation, how, actor = "tanh", "none", Actor((), jnp.zeros((1, 1)))
    if policies:
        activation, how = policies[0].activation, trainer.acting
        actor = import_actor(list(policies))
    own = np.array(episode_seeds(seeds, len(contexts), trainer.eval_episodes), np.uint32)
    found = []
    for c in range(len(contexts)):
        where = context_of(params, c)
        decisions = world.decisions(in_a_row(where))
        mine = np.tile(own[c], (len(actor.log_std), 1))
        found.append(_measures(world, activation, how, actor, mine, where, decisions))
    return {
        name: np.stack([np.asarray(one[name]).mean(axis=1) for one in found], axis=1)
        for name in found[0]
    }


def picks_of(id: str, seed: int, budget: int) -> list[int]:
    """Contexts that `mbtl` picks in a seed of the shipped matrix."""
    runs = compare(["mbtl"], [load_matrix(id)], budget, seeds=1).results
    return sorted(next(run.sources for run in runs if run.matrix_seed == seed))


def trained(trainer: Any, contexts: Sequence[Any], picks: list[int], seed: int, kept: Any) -> Any:
    """A policy per pick: those that are not there yet are trained together."""
    folders = {pick: kept / f"source-{pick:05d}" for pick in picks} if kept else {}
    found = {k: trainer.load(folder) for k, folder in folders.items() if folder.is_dir()}
    missing, keep = [pick for pick in picks if pick not in found], trainer.checkpoint
    sizes = trainer.groups([contexts[pick] for pick in missing], trainer.lanes) if missing else []
    for size in sizes:
        some, missing = missing[:size], missing[size:]
        seeds = [training_seed(seed, MATRIX_TRIAL, pick) for pick in some]
        lessons = [contexts[pick] for pick in some]
        policies = trainer.train_many(lessons, seeds, keep=(keep,))[keep]
        for pick, policy in zip(some, policies, strict=True):
            found[pick] = policy
            if kept:
                folders[pick].mkdir(parents=True)
                trainer.save(policy, folders[pick])
        print(f"{len(found)} of {len(picks)} trained", flush=True)
    return [found[pick] for pick in picks]


def lines(id: str, seed: int, budget: int, episodes: int, kept: Path | None) -> list[str]:
    """Of a Markdown table."""
    cmdp = get_cmdp(id, engine="jax")
    trainer: Any = replace(cmdp.trainer, eval_episodes=episodes)
    contexts, picks = cmdp.space.contexts, picks_of(id, seed, budget)
    policies = trained(trainer, contexts, picks, seed, kept and kept / f"{id}-seed{seed}")
    first, second = (
        evaluation_seeds(seed, MATRIX_TRIAL, range(len(contexts)), purpose)
        for purpose in (Purpose.EVALUATION, Purpose.REPORT)
    )
    serving = played(trainer, policies, contexts, first)["score"].argmax(axis=0)
    guided, alone = (played(trainer, some, contexts, second) for some in (policies, []))
    found = []
    for name, unit in MEASURES[id.split("-")[0]].items():
        served = guided[name][serving, np.arange(len(contexts))]
        own, unguided = guided[name][np.arange(len(picks)), picks], alone[name][0]
        cells = [f"{x.mean():.4g}" for x in (unguided, own, served)]
        cells += [f"{served.min():.4g} to {served.max():.4g}", str((served < unguided).sum())]
        found.append(f"| {id} | {unit} | {' | '.join(cells)} |")
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("ids", nargs="*", default=["ramp-acc", "ramp-vel"])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--budget", type=int, default=15)
    parser.add_argument("--episodes", type=int, default=20)
    parser.add_argument("--policies", type=Path)
    args = parser.parse_args()
    heads = "unguided", "own, where picked", "served", "by context", "contexts below unguided"
    print(f"| CMDP | | {' | '.join(heads)} |\n|{'---|' * 7}", flush=True)
    for id in args.ids:
        for line in lines(id, args.seed, args.budget, args.episodes, args.policies):
            print(line, flush=True)


if __name__ == "__main__":
    main()
