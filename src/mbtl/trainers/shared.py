"""One policy for all controlled cars, trained by Stable-Baselines3.

Stable-Baselines3 steps a fixed number of environments; each of ours is a slot (see `slots`), so an
agent's life is an episode and every algorithm runs unchanged:

    env = SharedVecEnv([partial(Eco, {"green": 20.0})] * 2, processes=True)
    model = PPO("MlpPolicy", env, **env.rollout_buffer)

On-policy algorithms keep the transitions of free slots out of learning with that buffer:
not in the loss, the advantages' normalisation, the entropy or the minibatches. Without it, and in
replay buffers, a free slot is a one-step episode with reward 0, whose observation no agent has.

Where all agents have the same reward, what one does is worth what the *team* earns until the
simulation ends, also after that agent has left: credited with its own life only, an agent that
drives on is paid less than one that stays and sees others arrive. `SharedVecEnv(credit="team")`
and its buffer do that; the ramp needs it.

Steps that Stable-Baselines3 counts are those of slots, taken or free. Observations must not be
normalised by its wrapper, which would count free slots and hide them; rewards neither.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Literal, get_args

import numpy as np

from mbtl.envs.slots import Slots, SlotStep, is_blank
from mbtl.errors import InvalidInput, check_known, needs

with needs("stable-baselines3", "train"):
    from stable_baselines3.common.buffers import RolloutBuffer
    from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecEnvWrapper


Credit = Literal["own", "team"]
"""Whose rewards an action is worth: the agent's until it leaves, or the team's until the end."""


class SharedVecEnv(VecEnvWrapper):  # type: ignore[misc]  # stable_baselines3 is untyped for our checker
    """The slots of one or several simulations as one vectorised environment.

    Row `i * slots + k` is slot k of simulation i. `infos` of the agent's last step have "episode",
    its return and length; one info has `mbtl.envs.rollout.ENDED` when a simulation has ended.

    Attributes:
        slots: per simulation.
    """

    def __init__(
        self,
        make_teams: Sequence[Callable[[], Any]],
        *,
        slots: int | None = None,
        processes: bool = False,
        credit: Credit = "own",
    ) -> None:
        """Make the simulations; none runs before `reset`.

        Args:
            make_teams: each makes one PettingZoo parallel environment.
            slots: agents per simulation at once; missing: the environments' `most_agents`.
            processes: one process per simulation. libsumo is then used in all of them; in one
                process only the first simulation has it.
            credit: "own": an episode of a slot ends when its agent leaves. "team": when the
                simulation ends; only with its `rollout_buffer`, as others would take the next agent
                of the slot for the same.

        Raises:
            InvalidInput: no simulation, or no number of slots.
            UnknownName: another credit.
        """
        check_known("credit", credit, get_args(Credit))
        if not make_teams:
            raise InvalidInput("a shared policy needs at least one simulation, got none")
        makers = [partial(Slots, make, slots) for make in make_teams]
        venv = SubprocVecEnv(makers) if processes else DummyVecEnv(makers)
        single = [
            venv.get_attr(f"single_{kind}_space", [0])[0] for kind in ("observation", "action")
        ]
        super().__init__(venv, *single)
        self.slots = int(venv.observation_space.shape[0])
        self.num_envs = venv.num_envs * self.slots
        self._credit = credit
        self.reset_infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]

    @property
    def rollout_buffer(self) -> dict[str, Any]:
        """Keyword arguments of an on-policy algorithm: the buffer that goes with these slots."""
        if self._credit == "own":
            return {"rollout_buffer_class": SharedRolloutBuffer}
        kwargs = {"slots": self.slots}
        return {"rollout_buffer_class": TeamRolloutBuffer, "rollout_buffer_kwargs": kwargs}

    def reset(self) -> Any:
        """(n, d) observations of all slots."""
        return self._flat(self.venv.reset())

    def step_async(self, actions: Any) -> None:
        """(n, ...) actions; those of free slots are ignored."""
        actions = np.asarray(actions)
        self.venv.step_async(actions.reshape(-1, self.slots, *actions.shape[1:]))

    def step_wait(self) -> tuple[Any, Any, Any, list[dict[str, Any]]]:
        """(observations, rewards, dones, infos) of all slots."""
        seen, _, _, infos = self.venv.step_wait()
        steps, own = [info["slots"] for info in infos], self._credit == "own"
        dones = [step.dones if own else np.full(self.slots, step.ended) for step in steps]
        return (
            self._flat(seen),
            np.concatenate([step.rewards for step in steps]),
            np.concatenate(dones),
            [info for step in steps for info in self._infos(step)],
        )

    def env_is_wrapped(self, wrapper_class: type[Any], indices: Any = None) -> list[bool]:
        """Lives of agents are reported as a monitor does, but none is wrapped."""
        return [False] * len(list(self._get_indices(indices)))

    def _infos(self, step: SlotStep) -> list[dict[str, Any]]:
        """An episode of the team that time cuts off goes on as its last agents see it.

        Those that left within its last decision have earned their share of that, too: their slots
        are shown, in turn, what the others see.
        """
        if self._credit == "own" or not step.ended:
            return step.infos
        cut = "TimeLimit.truncated"
        last = [info["terminal_observation"] for info in step.infos if info.get(cut)]
        if not last:
            return step.infos
        return [
            info
            if info.get(cut)
            else {**info, "terminal_observation": last[k % len(last)], cut: True}
            for k, info in enumerate(step.infos)
        ]

    def _flat(self, seen: Any) -> Any:
        return seen.reshape(self.num_envs, *seen.shape[2:])


class SharedRolloutBuffer(RolloutBuffer):  # type: ignore[misc]  # as above
    """A rollout buffer that gives agents' transitions only; free slots are dropped.

    Advantages are computed before, slot by slot: lives are contiguous and end with `done`, so they
    are those of an agent that is alone.
    """

    _full_size: tuple[int, int]
    rewards: Any
    values: Any

    def reset(self) -> None:
        """Empty it, at its full size again."""
        if hasattr(self, "_full_size"):
            self.buffer_size, self.n_envs = self._full_size
        self._full_size = self.buffer_size, self.n_envs
        super().reset()

    def compute_returns_and_advantage(self, last_values: Any, dones: Any) -> None:
        """As the base class does; then keep the rows in which an agent acted."""
        self._estimate(last_values, dones)
        taken = ~is_blank(self.swap_and_flatten(self.observations))
        for name in ("observations", "actions", "values", "log_probs", "advantages", "returns"):
            setattr(self, name, self.swap_and_flatten(getattr(self, name))[taken])
        self.buffer_size, self.n_envs = int(taken.sum()), 1
        self.generator_ready = True  # the rows are flat already

    def _estimate(self, last_values: Any, dones: Any) -> None:
        """Returns and advantages of all slots."""
        super().compute_returns_and_advantage(last_values, dones)


class TeamRolloutBuffer(SharedRolloutBuffer):
    """A `SharedRolloutBuffer` for `SharedVecEnv(credit="team")`.

    The team's value is the mean of the values that its agents see, its reward the mean of theirs.
    From these come the (lambda-)returns G_t of a simulation, the same for all who acted at t, and
    an agent's advantage G_t - V(what it saw). What follows a rollout that ends within a simulation
    is worth what the slots see that were taken in its last step.
    """

    def __init__(self, *args: Any, slots: int, **kwargs: Any) -> None:
        """As the base class; `slots` are those of one simulation."""
        self._slots = slots
        super().__init__(*args, **kwargs)

    def _estimate(self, last_values: Any, dones: Any) -> None:
        taken = self._by_team(~is_blank(self.observations))
        own = self.values
        self.rewards, self.values = self._mean(self.rewards, taken), self._mean(own, taken)
        last = self._mean(last_values.cpu().numpy().reshape(-1), taken[-1])
        super()._estimate(last_values.new_tensor(last), dones)
        self.values, self.advantages = own, self.returns - own

    def _mean(self, x: Any, taken: Any) -> Any:
        """Of each simulation over the slots taken, in all of its slots; (..., n)."""
        mean = np.where(taken, self._by_team(x), 0.0).sum(axis=-1) / taken.sum(axis=-1)
        return np.repeat(mean, self._slots, axis=-1).astype(np.float32)

    def _by_team(self, x: Any) -> Any:
        """(..., n) -> (..., simulations, slots)."""
        return np.reshape(x, (*x.shape[:-1], -1, self._slots))
