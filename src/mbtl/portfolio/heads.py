"""Action heads: what the outputs of a policy network mean.

Notation (shapes): B observations, m network outputs; actions are (B, ...).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbtl.arrays import Array
from mbtl.errors import InvalidInput

Array32 = NDArray[np.float32]


@dataclass(frozen=True)
class DiscreteHead:
    """One choice (`sizes` of length 1 and `scalar`) or several independent ones.

    Attributes:
        sizes: number of options of each choice.
        scalar: actions are single integers, not vectors.
        samples: the outputs are logits of a distribution; False for action values, as in DQN.
        start: action of the first option of each choice; none: 0.
    """

    sizes: tuple[int, ...]
    scalar: bool = True
    samples: bool = True
    start: tuple[int, ...] = ()

    @property
    def n_outputs(self) -> int:
        """Sum of the options."""
        return sum(self.sizes)

    def act(self, outputs: Array, rng: np.random.Generator | None) -> NDArray[Any]:
        """Largest output of each choice; with `rng`, a draw from its softmax (Gumbel's trick)."""
        if rng is not None:
            if not self.samples:
                raise _not_a_distribution()
            outputs = outputs + rng.gumbel(size=outputs.shape)
        blocks = np.split(outputs, np.cumsum(self.sizes)[:-1], axis=1)
        choices = np.stack([block.argmax(axis=1) for block in blocks], axis=1)
        if self.start:
            choices = choices + np.array(self.start)
        return choices[:, 0] if self.scalar else choices


@dataclass(frozen=True, eq=False)
class BoxHead:
    """A vector of real numbers within bounds.

    Attributes:
        low: smallest action; its shape is the action's.
        high: largest action, same shape.
        squash: actions are tanh(output) stretched over the box (SAC, TD3); else clipped outputs.
        log_std: (m,) log standard deviation of a Gaussian around the mean; None when unknown.
        whole: integer type of actions that are rounded; "": they are real numbers.
    """

    low: Array32
    high: Array32
    squash: bool = False
    log_std: Array32 | None = None
    whole: str = ""

    @property
    def n_outputs(self) -> int:
        """Number of action dimensions."""
        return int(self.low.size)

    def act(self, outputs: Array, rng: np.random.Generator | None) -> NDArray[Any]:
        """The mean action; with `rng`, a draw from the Gaussian around it."""
        if rng is not None:
            if self.log_std is None:
                raise _not_a_distribution()
            outputs = outputs + np.exp(self.log_std) * rng.standard_normal(outputs.shape)
        outputs = outputs.reshape(-1, *self.low.shape)
        low, high = self.low.astype(np.float64), self.high.astype(np.float64)
        if self.squash:
            outputs = low + 0.5 * (np.tanh(outputs) + 1.0) * (high - low)
        actions = np.clip(outputs, low, high).astype(np.float32)
        return np.rint(actions).astype(self.whole) if self.whole else actions


def head_record(head: DiscreteHead | BoxHead) -> dict[str, Any]:
    """JSON part of a head; the arrays of a `BoxHead` are stored beside it."""
    if isinstance(head, BoxHead):
        rounded = {"whole": head.whole} if head.whole else {}
        return {"kind": "box", "squash": head.squash, **rounded}
    return {
        "kind": "discrete",
        "sizes": list(head.sizes),
        "scalar": head.scalar,
        "samples": head.samples,
        **({"start": list(head.start)} if head.start else {}),
    }


def read_head(record: Mapping[str, Any], arrays: Mapping[str, Array32]) -> DiscreteHead | BoxHead:
    """Rebuild a head from `head_record` and its arrays; KeyError or ValueError when damaged."""
    if record["kind"] == "box":
        low, high, log_std = arrays["low"], arrays["high"], arrays.get("log_std")
        if low.shape != high.shape or (log_std is not None and log_std.shape != (low.size,)):
            raise ValueError(f"bounds of a box must have one shape, got {low.shape}, {high.shape}")
        whole = str(record.get("whole", ""))
        if whole and np.dtype(whole).kind not in "iu":
            raise ValueError(f"whole actions must be of an integer type, got {whole!r}")
        return BoxHead(low, high, bool(record["squash"]), log_std, whole)
    if record["kind"] == "discrete":
        sizes = tuple(record["sizes"])
        if not (sizes and all(type(size) is int and size > 0 for size in sizes)):
            raise ValueError(f"sizes must be whole numbers > 0, got {sizes}")
        start = tuple(record.get("start", ()))
        if start and (len(start) != len(sizes) or not all(type(s) is int for s in start)):
            raise ValueError(f"first options must be as many whole numbers as sizes, got {start}")
        return DiscreteHead(sizes, bool(record["scalar"]), bool(record["samples"]), start)
    raise ValueError(f"unknown action head {record['kind']!r}")


def _not_a_distribution() -> InvalidInput:
    return InvalidInput(
        "this policy holds no action distribution to sample; use deterministic=True"
    )
