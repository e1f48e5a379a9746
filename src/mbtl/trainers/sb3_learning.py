"""One training in Stable-Baselines3: what goes wrong gets a name, and only the policy is kept."""

from __future__ import annotations

import contextlib
from typing import Any

from mbtl.contexts import Context
from mbtl.envs.rollout import end
from mbtl.errors import SimulationFailed, TrainingFailed
from mbtl.trainers.adapted import adapted
from mbtl.trainers.watch import Watch

_GONE = (EOFError, BrokenPipeError, ConnectionResetError)
"""What the end of another process looks like from here."""

_FOREVER = 1 << 62
"""Steps of a training that counts its episodes."""


def log_nowhere(model: Any) -> None:
    """Keep the library from making an empty temporary folder for each training."""
    from stable_baselines3.common.logger import Logger

    model.set_logger(Logger(folder=None, output_formats=[]))


def run_name(context: Context, seed: int) -> str:
    """Folder name of a TensorBoard run."""
    parts = (f"{n}={v:.6g}" if isinstance(v, float) else f"{n}={v}" for n, v in context.items())
    name = ",".join(parts) + f",seed={seed}"
    return "".join(c if c.isalnum() or c in "=.,_-" else "_" for c in name)


def learn(model: Any, total: int | None, watch: Watch, name: str, *, anew: bool = True) -> None:
    """Learn, and turn a divergence into an error that names it; not `anew`: go on to the total."""
    left = (_FOREVER if total is None else total) - (0 if anew else int(model.num_timesteps))
    try:
        model.learn(left, callback=watch, tb_log_name=name, reset_num_timesteps=anew)
    except _GONE as error:
        raise SimulationFailed(
            f"a training needs its simulators, got the end of a process ({type(error).__name__}) "
            "that has written its own reason; mend that, or train with processes=False to see it "
            "here"
        ) from error
    except ValueError as error:
        # torch's distributions refuse NaN parameters with a ValueError; any other passes
        if "invalid values" not in str(error) and _finite(model):
            raise
        raise _diverged(model) from error
    if not _finite(model):
        raise _diverged(model)


def close(envs: Any) -> None:
    """Close them; a process that is gone cannot answer, and what ended it is told elsewhere."""
    with contextlib.suppress(*_GONE):
        end(envs)


def _finite(model: Any) -> bool:
    return all(bool(parameter.isfinite().all()) for parameter in model.policy.parameters())


def _diverged(model: Any) -> TrainingFailed:
    return TrainingFailed(
        f"training must keep finite weights and actions, got NaN by step {model.num_timesteps}; "
        "lower the learning rate, or check that observations and rewards are finite"
    )


def lightened(model: Any) -> Any:
    """The policy: of the model, what only training needs is dropped.

    Those are environments (soon to be closed), buffers and open log files.
    """
    policy = adapted(model)
    model.logger.close()
    model.env = model._vec_normalize_env = None
    for name in ("_logger", "_last_obs", "_last_original_obs", "_last_episode_starts"):
        model.__dict__.pop(name, None)
    for name in ("replay_buffer", "rollout_buffer"):
        if hasattr(model, name):
            setattr(model, name, None)
    for module in (model.policy, getattr(model.policy, "actor", None)):
        _forget_last_actions(getattr(module, "action_dist", None))
    return policy


def _forget_last_actions(distribution: Any) -> None:
    """Drop the graph of the last forward pass: torch sends no such tensors to another process."""
    import torch

    for name, part in vars(distribution).items() if distribution is not None else ():
        if isinstance(part, torch.Tensor):
            setattr(distribution, name, part.detach())
        elif isinstance(part, torch.distributions.Distribution) or name == "distribution":
            setattr(distribution, name, None)  # made anew by every forward pass
