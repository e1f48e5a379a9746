"""What changing the policy within an episode is worth where the context is not told.

    python benchmarks/hidden_within_episode.py [--cmdps cartpole-length,...] [--policies FOLDER]

Per CMDP five specialists at equidistant sources are trained by the quick preset without seeing the
context (and kept in FOLDER). They are played in every fourth context: `portfolio.signs`. Then they
serve contexts in the middle between those, for three episodes each in fresh seeds, the same for
everyone; policies change in the running simulator. Shares are of the way from the best single
policy (0) to the one that would be chosen with the context told (1), with their standard errors
over contexts. The columns:

    between      the policy changes between episodes only: `adaptive()`, episodes 1, 2, 3
    rewards      and within them, by the rewards of each part: episodes 1, 2, 3
    features     and by mean, deviation and mean change of each number observed in a part
    looks first  features, episode 1; its first part is played by the policy that promises most with
                 what it shows in that part

`taken over` asks whether a policy that takes over earns what it does alone: the best single policy
plays a third of each episode, then the told one the rest; what that earned from then on, and what
it earned in those steps when it had played from the start, in performance.

On two busy cores a pendulum or cartpole takes three minutes, a cheetah or walker fifteen, half of
them for training.
"""

from __future__ import annotations

import measure  # noqa: F401  first: threads

import argparse  # isort: skip
import copy
import time
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from mbtl.contexts import ContextSpace
from mbtl.portfolio import Adaptive, MLPPolicy, Portfolio, Signs
from mbtl.problems import CMDP, get_cmdp
from mbtl.seeds import Purpose, episode_seeds, evaluation_seeds

CMDPS = (
    "pendulum-length,pendulum-mass,cartpole-length,cheetah-friction,cheetah-stiffness,"
    "walker-friction"
)
SPECIALISTS, EVERY, SERVED, LONG = 5, 4, 3, 1000
RECORDED, SERIES = {True: 3, False: 5}, {True: 1, False: 4}
"""Episodes recorded of each policy in each context, and times that each context is served: where
episodes are long, or not."""
LITTLE = 0.01
"""Below a gain of so much performance a share is noise."""
PARTS = (10, 20, 50)


def features(observations: np.ndarray, actions: np.ndarray) -> np.ndarray:
    """Mean, deviation and mean change of each number."""
    change = np.abs(np.diff(observations, axis=0)).mean(axis=0)
    return np.concatenate([observations.mean(axis=0), observations.std(axis=0), change])


def specialists(cmdp: CMDP, folder: Path | None) -> tuple[list[int], list[MLPPolicy]]:
    """Sources and policies; those in the folder are not trained again."""
    sources = [cmdp.space.n * (2 * i + 1) // (2 * SPECIALISTS) for i in range(SPECIALISTS)]
    trainer, found = cmdp.trainer_for("quick"), []
    for source in sources:
        place = None if folder is None else folder / f"{cmdp.id}-{source}"
        if place is not None and place.exists():
            found.append(MLPPolicy.load(place))
            continue
        policy = trainer.train([cmdp.space.context(source)], source).policy
        print(f"  {cmdp.id}: trained {source}", flush=True)
        if place is not None:
            place.mkdir(parents=True)
            policy.save(place)
        found.append(policy)
    return sources, found


@dataclass
class Looking(Adaptive):
    """Plays the first part of the first episode for what it shows, too."""

    first: int = 0

    @property
    def next(self) -> int:
        """As ever, but for the first part."""
        return super().next if self.played or self._part else self.first


def first_to_look(serving: Adaptive) -> int:
    """Who promises most of a first part and, after what it shows on average, of those to come."""
    signs = serving.signs
    assert signs is not None
    worth = signs.mean[:, :, 0, 0] @ serving.chances
    for k, x in np.ndindex(signs.mean.shape[:2]):
        after = copy.copy(serving)
        after._playing = k
        after._weigh(signs, signs.mean[k, x, 0])
        worth[k] += serving.chances[x] * (signs.to_go[:, :, 1] @ after.chances).max()
    return int(worth.argmax())


def play(env: Any, act: Callable[[int], Any], seed: int, tell: Any = None) -> np.ndarray:
    """The rewards of an episode; `act` says which policy acts in a step."""
    observation, _ = env.reset(seed=seed)
    rewards, over = list[float](), False
    while not over:
        action, _ = act(len(rewards)).predict(observation)
        seen, reward, terminated, truncated, _ = env.step(action)
        if tell is not None:
            tell(observation, action, reward)
        rewards.append(float(reward))
        observation, over = seen, terminated or truncated
    return np.array(rewards)


@dataclass
class Trial:
    """A portfolio in held-out contexts."""

    cmdp: CMDP
    served: Portfolio
    contexts: list[Any]
    seeds: list[list[int]]

    def alone(self, k: int) -> list[list[np.ndarray]]:
        """Rewards of one policy in all episodes."""
        policy = self.served.policy(k)
        return [[play(env, lambda _: policy, seed) for seed in some] for env, some in self.each()]

    def each(self) -> list[tuple[Any, list[int]]]:
        """Environments and seeds of their episodes."""
        return [(self.cmdp.make_env(c), s) for c, s in zip(self.contexts, self.seeds, strict=True)]

    def adaptive(self, begin: Callable[[], Adaptive], episodes: int = SERVED) -> np.ndarray:
        """(contexts, episodes) returns."""
        found = []
        for env, some in self.each():
            serving = begin()
            tell = None if serving.signs is None else serving.step
            for seed in some[:episodes]:
                now = serving.policy
                act = (lambda _: now) if tell is None else (lambda _: serving.policy)  # noqa: B023
                found.append(play(env, act, seed, tell).sum())
                serving.observe(found[-1])
        return np.reshape(found, (len(self.contexts), -1))


def rewards_only(signs: Signs) -> Signs:
    """The same without features."""
    return Signs(signs.every, signs.mean[..., :1], signs.deviation[..., :1])


def measured(id: str, folder: Path | None) -> None:
    """Print the rows of a CMDP."""
    began = time.perf_counter()

    def note(text: str) -> None:
        print(f"  {id}: {text}, {time.perf_counter() - began:.0f} s", flush=True)

    cmdp = get_cmdp(id, visibility="hidden")
    sources, policies = specialists(cmdp, folder)
    (axis,) = cmdp.space.axes
    listed = range(0, cmdp.space.n, EVERY)
    space = ContextSpace.grid({axis: [cmdp.space.contexts[i][axis.name] for i in listed]})
    middle = [cmdp.space.contexts[i] for i in range(EVERY // 2, cmdp.space.n, EVERY)]
    is_long = (cmdp.horizon or LONG) >= LONG
    held, recorded = middle * SERIES[is_long], RECORDED[is_long]
    near = [int(np.abs(np.array(listed) - s).argmin()) for s in sources]
    trainer, numbers = cmdp.trainer_for("quick", eval_episodes=recorded), range(space.n)
    rows = [
        trainer.evaluate(p, list(space.contexts), evaluation_seeds(1, 0, numbers)) for p in policies
    ]
    returns = np.array([np.reshape(row, (space.n, -1)) for row in rows])
    served = Portfolio(
        space, tuple(near), returns.mean(axis=2), cmdp.normalisation, list(returns),
        in_memory=dict(enumerate(policies)),
    )  # fmt: skip
    fresh = evaluation_seeds(2, 0, range(len(held)), Purpose.REPORT)
    trial = Trial(cmdp, served, held, episode_seeds(fresh, len(held), SERVED))
    alone = [trial.alone(k) for k in range(len(policies))]
    value = served.bounds.normalise(np.array([[[e.sum() for e in c] for c in k] for k in alone]))
    best = int(served.performance.mean(axis=1).argmax())
    told = [served.explain(context).policy for context in held]
    single, high = value[best], value[told, range(len(held))]
    low, gain = single.mean(), high.mean() - single.mean()
    note("policies played alone")

    def cell(found: np.ndarray) -> str:
        """Shares per episode; where there is little to gain, V beyond that of the best single."""
        more = served.bounds.normalise(found) - single[:, : found.shape[1]]
        mean, error = more.mean(axis=0), more.std(axis=0) / np.sqrt(len(more))
        if gain < LITTLE:
            return ", ".join(f"V {v:+.3f} ± {e:.3f}" for v, e in zip(mean, error, strict=True))
        shares = zip(mean / gain, error / gain, strict=True)
        return ", ".join(f"{share:.2f} ± {e:.2f}" for share, e in shares)

    third = [cmdp.horizon // 3] * 2 if cmdp.horizon else [0, 0]
    now, before = list[float](), list[float]()
    for c, (env, some) in enumerate(trial.each()):
        if told[c] == best:
            continue
        for e, seed in enumerate(some):
            pair = (served.policy(best), served.policy(told[c]))
            swapped = play(env, lambda t: pair[t >= third[0]], seed)  # noqa: B023
            if len(swapped) > third[0]:  # else it had ended
                now.append(swapped[third[0] :].sum())
                before.append(alone[told[c]][c][e][third[0] :].sum())
    span = served.bounds.high - served.bounds.low
    takeover = f"{np.mean(now) / span:.3f} for {np.mean(before) / span:.3f}" if now else "-"

    between = cell(trial.adaptive(lambda: served.adaptive(episodes=SERVED)))
    note("served between episodes")
    for every in PARTS:
        signs = served.signs(
            cmdp.make_env, every=every, episodes=recorded, features=features, seed=1
        )
        note(f"recorded parts of {every}")
        cells = [
            cell(trial.adaptive(lambda: served.adaptive(signs=rewards_only(signs)))),  # noqa: B023
            cell(trial.adaptive(lambda: served.adaptive(signs=signs))),  # noqa: B023
        ]
        plain = served.adaptive(signs=signs)
        given = {f.name: getattr(plain, f.name) for f in fields(plain) if f.init}
        given["first"] = first_to_look(plain)
        cells.append(cell(trial.adaptive(lambda: Looking(**given), episodes=1)))  # noqa: B023
        note(f"served in parts of {every}")
        print(
            f"| {id} | {low:.3f} | {low + gain:.3f} | {every} | {between} | {' | '.join(cells)} "
            f"| {takeover} |",
            flush=True,
        )


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cmdps", default=CMDPS)
    parser.add_argument("--policies", type=Path)
    given = parser.parse_args()
    print(
        "| CMDP | best single | told | part | between | rewards | features | looks first "
        "| taken over |\n|---|---|---|---|---|---|---|---|---|"
    )
    for id in given.cmdps.split(","):
        measured(id, given.policies)


if __name__ == "__main__":
    main()
