"""The symmetry of the traffic signal's crossing, for learning from fewer episodes.

Its four approaches are alike, and so is their demand: what was seen may as well have happened a
quarter of a turn further on. Turning the approaches by one swaps the phases of north-south and
east-west, and each left phase stays one.
"""

from __future__ import annotations

from typing import Any

import torch
from stable_baselines3.common.buffers import ReplayBuffer

from mbtl.zoo.cmdps.traffic.signal import APPROACHES, CELLS

_TURNS = len(APPROACHES)
_PER_APPROACH = 2 * len(CELLS)
_ROWS = _TURNS * _PER_APPROACH


class RotatedReplay(ReplayBuffer):  # type: ignore[misc]  # the library is untyped for our checker
    """A replay buffer whose every sampled row is turned by a random number of approaches.

    Name it in a preset of the signal as `"replay_buffer_class"`. It draws from torch's global
    generator, which the training's seed decides.
    """

    def _get_samples(self, batch_inds: Any, env: Any = None) -> Any:
        rows = super()._get_samples(batch_inds, env)
        turns = torch.randint(_TURNS, (len(batch_inds),)).to(rows.actions.device)
        return rows._replace(
            observations=turned(rows.observations, turns),
            next_observations=turned(rows.next_observations, turns),
            actions=turned_phase(rows.actions, turns[:, None]),
        )


def turned(observations: torch.Tensor, turns: torch.Tensor) -> torch.Tensor:
    """Rows of observations, (n, d), each turned by (n,) approaches; features stay as they are."""
    n = len(observations)
    cells = observations[:, :_ROWS].reshape(n, _TURNS, _PER_APPROACH)
    here = turns.device
    sources = (torch.arange(_TURNS, device=here)[None] - turns[:, None]) % _TURNS
    moved = cells[torch.arange(n, device=here)[:, None], sources].reshape(n, _ROWS)
    return torch.cat([moved, observations[:, _ROWS:]], dim=1)


def turned_phase(phases: torch.Tensor, turns: torch.Tensor) -> torch.Tensor:
    """The phase that serves the turned approaches as `phases` served them."""
    return (phases + 2 * turns) % 4
