"""Simulators in processes of their own as a world; nothing of them or of jax is imported before."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar, Literal

from mbtl.contexts import Context
from mbtl.errors import InvalidInput
from mbtl.score import Score


@dataclass(frozen=True)
class SceneProblem:
    """contexts -> world of simulators in processes (`mbtl.engine.world_trainer.Problem`).

    Attributes:
        make_env: context -> environment, of a function of a module or a record; a Gymnasium one, or
            a PettingZoo parallel one that has `most_agents`. It has `episode_steps`, and what it
            shows of the context is in its observations.
        time_limit: how learning sees the end of an episode.
        score: what an episode is worth; None: the sum of its rewards.
    """

    make_env: Callable[[Context], Any]
    time_limit: Literal["truncation", "terminal"] = "truncation"
    score: Score | None = None

    storable: ClassVar[bool] = False
    """A simulator lives in one process, so no file holds the state of a training."""
    lanes: ClassVar[int] = 1
    """Policies trained together: their episodes run at the same time."""

    def __call__(self, contexts: Sequence[Context]) -> tuple[Any, Any]:
        """The world, and the parameters of `contexts` with one leading axis.

        Raises:
            InvalidInput: there are no contexts, their numbers have different names, or the
                environments cannot be made elsewhere.
            MissingExtra: jax or the simulator is not installed.
        """
        from gymnasium.spaces import Discrete

        from mbtl.engine import worlds
        from mbtl.engine.scene import EnvScene
        from mbtl.engine.worlds.processes import Processes

        names = {tuple(sorted(context)) for context in contexts}
        if len(names) != 1:
            raise InvalidInput(
                f"simulators in processes take contexts with the same names, got {sorted(names)}"
            )
        (features,) = names
        envs = [self.make_env(context) for context in contexts]
        seen, act, places = envs[0].observation_space, envs[0].action_space, 1
        if hasattr(envs[0], "possible_agents"):
            seen, act, places = seen(""), act(""), envs[0].most_agents
        world = Processes.of(
            partial(EnvScene, self.make_env, places, self.score),
            action=worlds.Discrete(int(act.n))
            if isinstance(act, Discrete)
            else worlds.Box(tuple(act.low.tolist()), tuple(act.high.tolist())),
            agents=places,
            n_features=int(seen.shape[0]),
            features=features,
            time_limit=self.time_limit,
            drives=hasattr(envs[0], "drive"),
        )
        pairs = zip(contexts, envs, strict=True)
        constants = [{**context, "decisions": env.episode_steps} for context, env in pairs]
        for env in envs:
            env.close()
        return world, worlds.stack_params(world, constants)
