"""What every CMDP with an environment owes: subclass `CMDPContract` and give a `cmdp` fixture."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from mbtl.contexts import Context, ContextSpace
from mbtl.envs.recording import draw_actions
from mbtl.problems import CMDP, check_cmdp


class CMDPContract:
    """Tests that hold for any CMDP that has a `make_env`.

    Attributes:
        smoke: options that make a training as short as it can be.
        steps: random actions of a look at observations.

    Example:
        >>> class TestMine(CMDPContract):
        ...     @pytest.fixture
        ...     def cmdp(self):
        ...         return my_cmdp
    """

    smoke: ClassVar[Mapping[str, Any]] = {"timesteps": 64, "eval_episodes": 2}
    steps: ClassVar[int] = 300

    def test_passes_the_check(self, cmdp: CMDP) -> None:
        """Axes act, contexts do not leak, resets are deterministic, numbers are finite."""
        check_cmdp(cmdp).raise_if_failed()

    def test_space_survives_json(self, cmdp: CMDP) -> None:
        """The contexts come back from their record, in the same order."""
        assert ContextSpace.from_json(cmdp.space.to_json()) == cmdp.space

    def test_observations_are_in_the_space(self, cmdp: CMDP) -> None:
        """At the first, a middle and the last context, with the dtype that the space declares."""
        for context in _some(cmdp):
            env = _make(cmdp, context)
            for observation in _observations(env, self.steps):
                assert env.observation_space.contains(observation), (context, observation)
            env.close()

    def test_rewards_and_ends_have_plain_types(self, cmdp: CMDP) -> None:
        """Float-like rewards and true booleans, as Gymnasium asks."""
        env = _make(cmdp, cmdp.space.context(0))
        env.reset(seed=0)
        _, reward, terminated, truncated, info = env.step(env.action_space.sample())
        assert np.isscalar(reward)
        assert isinstance(terminated, bool)
        assert isinstance(truncated, bool)
        assert isinstance(info, dict)

    def test_a_context_survives_the_environment(self, cmdp: CMDP) -> None:
        """The factory does not change the context it is given."""
        context = cmdp.space.context(0)
        _make(cmdp, context).close()
        assert context == cmdp.space.context(0)

    def test_every_preset_makes_a_trainer(self, cmdp: CMDP) -> None:
        """No recipe asks for an option that the trainer does not have."""
        for name, preset in cmdp.presets.items():
            trainer = cmdp.trainer_for(name)
            for option, value in preset.options().items():
                assert getattr(trainer, option) == value

    def test_trains_and_transfers(self, cmdp: CMDP) -> None:
        """A few real steps, then returns on three contexts; the same seeds give the same row."""
        trainer, targets = cmdp.trainer_for(**self.smoke), _some(cmdp)
        rows = [
            trainer.evaluate(
                trainer.train([targets[1]], seed=3).policy, targets, range(len(targets))
            )
            for _ in range(2)
        ]
        assert len(rows[0]) == len(targets)
        assert np.isfinite(rows[0]).all()
        np.testing.assert_array_equal(rows[0], rows[1])


def _some(cmdp: CMDP) -> list[Context]:
    return [cmdp.space.context(i) for i in (0, cmdp.space.n // 2, cmdp.space.n - 1)]


def _make(cmdp: CMDP, context: Context) -> Any:
    assert cmdp.make_env is not None, "this contract is for CMDPs with an environment"
    from mbtl.envs.slots import as_one  # needs Gymnasium, as the environment does

    return as_one(cmdp.make_env(context))


def _observations(env: Any, steps: int) -> list[Any]:
    seen = [env.reset(seed=0)[0]]
    for action in draw_actions(env.action_space, steps, seed=0):
        observation, _, terminated, truncated, _ = env.step(action)
        seen.append(observation)
        if terminated or truncated:
            seen.append(env.reset()[0])
    return seen
