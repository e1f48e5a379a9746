"""K policies, each trained on the set of contexts that it serves best, against all-in steps.

    .venv/bin/python evidence/step_clusters.py --cmdp pendulum-length --visibility hidden

Expectation-maximisation over tasks: K policies begin on K equal stretches of the axis. Then, again
and again, each is evaluated on some contexts, each context goes to the policy that serves it best,
and each policy learns on, from its own networks, on the contexts it has got; one that got none
takes those that are served worst. Prints V after every round on fresh episodes, with the routes of
an evaluation that is charged, beside the steps of all that: training, assigning, routing.

Notation (shapes): K policies, N contexts, T of them evaluated, C per set, E episodes.
"""

from __future__ import annotations

import measure

import argparse  # isort: skip
import json
import math
from typing import Any

import numpy as np

from mbtl.problems import get_cmdp
from mbtl.seeds import MATRIX_TRIAL, Purpose, episode_seeds, evaluation_seeds, training_seed
from mbtl.zoo.benchmark.steps import HORIZONS, ONE_PER_STEP

TOGETHER, TARGETS = 20, 25
ASSIGN, ROUTE, FRESH = 2, 10, 10
"""Episodes per context of an assignment, of the routes at the end, and of the report."""

Array = np.ndarray


class Clusters:
    """K policies and what they have cost."""

    def __init__(self, cmdp_id: str, visibility: str, k: int, seed: int, steps: int) -> None:
        """Nothing is trained yet; `steps` are of one policy in one round."""
        self.cmdp = get_cmdp(cmdp_id, visibility=visibility)
        self.trainer: Any = self.cmdp.trainer_for("full")
        self.contexts = self.cmdp.space.contexts
        self.k, self.seed, self.steps = k, seed, steps
        self.family = cmdp_id.split("-")[0]
        self.spent, self.weights = 0.0, None
        n = len(self.contexts)
        self.targets = np.linspace(0, n - 1, TARGETS).round().astype(int)
        self.nearest = np.abs(np.arange(n)[:, None] - self.targets).argmin(axis=1)
        self.members = np.array_split(np.arange(n), k)

    def learn(self, round_: int) -> None:
        """Every policy goes on in its own set."""
        import mbtl.engine.learners as engine

        order = np.arange(TOGETHER) * 13 % TOGETHER  # neighbours in time are apart on the axis
        sets = [m[np.linspace(0, len(m) - 1, TOGETHER).round().astype(int)][order]
                for m in self.members]  # fmt: skip
        world, flat = self._problem(np.concatenate(sets))
        params = type(flat)(*(x.reshape(self.k, TOGETHER, *x.shape[1:]) for x in flat))
        recipe = engine.MultiTaskRecipe("ppo", self.trainer.learner)
        lanes = [training_seed(self.seed, MATRIX_TRIAL + round_, j) for j in range(self.k)]
        training = engine.train(
            world, recipe, lanes, params, self.steps,
            checkpoint_every=self.steps, checkpoint_episodes=TOGETHER, weights=self.weights,
        )  # fmt: skip
        self.world, self.weights = world, training.state.weights
        done = math.ceil(self.steps / recipe.update_length) * recipe.update_length
        self.spent += self.k * done

    def _problem(self, contexts: Array) -> tuple[Any, Any]:
        """The world and parameters; where nothing is shown, a feature that is always zero."""
        world, params = self.trainer.problem([self.contexts[i] for i in contexts])
        if not params.visible.shape[1]:
            params = params._replace(visible=np.zeros((len(contexts), 1), np.float32))
        return world, params

    def returns(self, contexts: Array, purpose: Purpose, episodes: int) -> Array:
        """(K, contexts) mean performance, and what it costs."""
        import mbtl.engine.learners as engine

        _, params = self._problem(contexts)
        n = len(params.visible)
        play = evaluation_seeds(self.seed, MATRIX_TRIAL, range(n), purpose)
        numbers = episode_seeds(play, n, episodes)
        found = engine.evaluate(self.world, engine.actor_of(self.weights), params, numbers)
        longest = HORIZONS[self.family]
        each = np.clip(found, 1, longest) if self.family in ONE_PER_STEP else longest
        self.price = float(np.broadcast_to(each, found.shape).sum())
        assert self.cmdp.normalisation is not None
        return np.asarray(self.cmdp.normalisation.normalise(found).mean(axis=2))

    def assign(self) -> None:
        """Each context goes to the policy that serves it best."""
        rows = self.returns(self.targets, Purpose.CHECKPOINT, ASSIGN)[:, self.nearest]
        self.spent += self.price
        owner, best = rows.argmax(axis=0), rows.max(axis=0)
        worst = np.sort(best.argsort()[:TOGETHER])
        self.members = [
            np.flatnonzero(owner == j) if (owner == j).any() else worst for j in range(self.k)
        ]

    def value(self) -> tuple[float, float]:
        """V on fresh episodes if it ended here, and the steps that it would have cost."""
        seen = self.returns(self.targets, Purpose.EVALUATION, ROUTE)[:, self.nearest]
        price = self.price
        n = len(self.contexts)
        fresh = self.returns(np.arange(n), Purpose.REPORT, FRESH)
        return float(fresh[seen.argmax(axis=0), np.arange(n)].mean()), self.spent + price


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cmdp", default="pendulum-length")
    parser.add_argument("--visibility", default="hidden")
    parser.add_argument("--policies", type=int, default=4)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--steps", type=int, default=250_000, help="per policy and round")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    made = Clusters(args.cmdp, args.visibility, args.policies, args.seed, args.steps)
    for round_ in range(args.rounds):
        made.learn(round_)
        value, spent = made.value()
        sizes = [len(m) for m in made.members]
        print(json.dumps({"round": round_, "steps": spent, "V": round(value, 4), "sets": sizes}),
              flush=True)  # fmt: skip
        made.assign()
    measure.note(f"{args.cmdp}: {args.policies} policies, {args.rounds} rounds")


if __name__ == "__main__":
    main()
