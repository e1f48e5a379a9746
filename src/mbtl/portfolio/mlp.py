"""Small dense policies in plain numpy: no training library to run them, no pickle to save them.

Notation (shapes): B observations, o numbers each, m network outputs.
    observation  (*shape) or (B, *shape), prod(shape) = o
    outputs      (B, m)   logits or values of discrete actions, or a mean per action dimension

Weights are kept in float32, as trained, and multiplied in float64, so that the rounding of a batch
(which depends on its size) disappears when the action is rounded to float32.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mbtl.arrays import Array
from mbtl.errors import InvalidInput, StorageError
from mbtl.files import MALFORMED, read_arrays, read_json

FORMAT = 2
"""Of the folder; a newer one is not read."""
WEIGHTS_FILE = "weights.npz"
RECORD_FILE = "policy.json"

Activation = Literal["tanh", "relu", "mish"]

_ACTIVATIONS: dict[str, Callable[[Array], Array]] = {
    "tanh": np.tanh,
    "relu": lambda x: np.maximum(x, 0.0),
    "mish": lambda x: x * np.tanh(np.logaddexp(0.0, x)),  # x tanh(softplus(x)), Misra 2019
}


@dataclass(frozen=True, eq=False)
class Scaling:
    """Standardised observations, by statistics that do not change: clip((x - mean) / scale).

    Attributes:
        mean: as long as an observation has numbers; float64.
        scale: likewise, > 0.
        clip: largest absolute value that is shown.
    """

    mean: Array
    scale: Array
    clip: float = 10.0

    def __call__(self, observations: ArrayLike) -> Array32:
        """(..., shape) observations as the network sees them, float32."""
        x = (np.asarray(observations) - self.mean) / self.scale
        scaled: Array32 = np.clip(x, -self.clip, self.clip).astype(np.float32)
        return scaled


@dataclass(frozen=True, eq=False, repr=False)
class MLPPolicy:
    """A dense network with one activation between its layers and a head for the action.

    Attributes:
        weights: per layer (n_out, n_in) float32.
        biases: per layer (n_out,) float32.
        activation: "tanh", "relu" or "mish", after every layer but the last.
        observation_shape: shape of one observation.
        head: what the outputs mean.
        scaling: of observations before the first layer; None: as they are.

    Raises:
        InvalidInput: layers do not fit each other, the observation or the head.
    """

    weights: tuple[Array32, ...]
    biases: tuple[Array32, ...]
    activation: Activation
    observation_shape: tuple[int, ...]
    head: DiscreteHead | BoxHead
    scaling: Scaling | None = None

    @property
    def row_by_row(self) -> bool:
        """Whether an action does not depend on its batch: the largest of some sums does not."""
        return isinstance(self.head, DiscreteHead)

    def __repr__(self) -> str:
        widths = [int(np.prod(self.observation_shape)), *(len(bias) for bias in self.biases)]
        layers = " -> ".join(map(str, widths))
        return f"MLPPolicy({layers}, {self.activation}, {type(self.head).__name__})"

    def __post_init__(self) -> None:
        if self.activation not in _ACTIVATIONS:
            known = ", ".join(_ACTIVATIONS)
            raise InvalidInput(f"activation must be one of {known}, got {self.activation!r}")
        widths = [int(np.prod(self.observation_shape))] + [len(b) for b in self.biases]
        expected = [(n_out, n_in) for n_in, n_out in itertools.pairwise(widths)]
        shapes = [w.shape for w in self.weights]
        if not shapes or shapes != expected or widths[-1] != self.head.n_outputs:
            raise InvalidInput(
                f"layers must lead from {widths[0]} inputs to {self.head.n_outputs} outputs with "
                f"biases of {widths[1:]}, got weights of shape {shapes}"
            )

    @cached_property
    def _layers(self) -> list[tuple[Array, Array]]:
        pairs = zip(self.weights, self.biases, strict=True)
        return [(w.T.astype(np.float64), b.astype(np.float64)) for w, b in pairs]

    def outputs(self, observations: ArrayLike) -> Array:
        """(B, *observation_shape) -> (B, m) raw network outputs."""
        seen = observations if self.scaling is None else self.scaling(observations)
        x = np.asarray(seen, dtype=np.float32).astype(np.float64)
        x = x.reshape(len(x), -1)
        last = len(self._layers) - 1
        for i, (weight, bias) in enumerate(self._layers):
            x = x @ weight + bias
            if i < last:
                x = _ACTIVATIONS[self.activation](x)
        return x

    def predict(
        self,
        observation: ArrayLike,
        deterministic: bool = True,
        rng: np.random.Generator | None = None,
    ) -> tuple[NDArray[Any], None]:
        """Action for one observation or a batch; the pair has the form Stable-Baselines3 uses.

        Args:
            observation: `observation_shape`, or (B, *observation_shape).
            deterministic: most likely action; else a sample, which needs `rng`.
            rng: generator for the samples.

        Returns:
            (actions, None): actions without a batch axis for one observation.

        Raises:
            InvalidInput: wrong shape, sampling without `rng`, or a policy without a distribution.
        """
        if not deterministic and rng is None:
            raise InvalidInput(
                "sampled actions need a random generator; pass rng=np.random.default_rng(seed)"
            )
        array = np.asarray(observation)
        single = array.shape == self.observation_shape
        if not single and array.shape[1:] != self.observation_shape:
            raise InvalidInput(
                f"observations must have shape {self.observation_shape}, alone or as a batch, "
                f"got {array.shape}"
            )
        actions = self.head.act(
            self.outputs(array[None] if single else array), None if deterministic else rng
        )
        return (np.asarray(actions[0]) if single else actions), None

    def save(self, folder: Path) -> None:
        """Write `weights.npz` and `policy.json` into `folder`, which must exist."""
        arrays: dict[str, NDArray[Any]] = {f"weight_{i}": w for i, w in enumerate(self.weights)}
        arrays |= {f"bias_{i}": b for i, b in enumerate(self.biases)}
        if isinstance(self.head, BoxHead):
            arrays |= {"low": self.head.low, "high": self.head.high}
            if self.head.log_std is not None:
                arrays["log_std"] = self.head.log_std
        if self.scaling is not None:
            arrays |= {"scaling_mean": self.scaling.mean, "scaling_scale": self.scaling.scale}
        np.savez(folder / WEIGHTS_FILE, **arrays)  # type: ignore[arg-type]
        record = {
            "kind": "mbtl mlp policy",
            "format": FORMAT,
            "activation": self.activation,
            "layers": len(self.weights),
            "observation_shape": list(self.observation_shape),
            "head": head_record(self.head),
            **({} if self.scaling is None else {"clip": self.scaling.clip}),
        }
        (folder / RECORD_FILE).write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")

    @classmethod
    def load(cls, folder: Path) -> MLPPolicy:
        """Read back what `save` wrote; executes nothing.

        Raises:
            StorageError: the files are missing, damaged, or of a newer format.
        """
        try:
            record = read_json((folder / RECORD_FILE).read_text(encoding="utf-8"))
            if record["format"] > FORMAT:
                raise StorageError(
                    f"policy formats up to {FORMAT} are known, got {record['format']} in {folder}; "
                    "install a newer mbtl"
                )
            with (folder / WEIGHTS_FILE).open("rb") as file:
                arrays = read_arrays(file)
            if not all(array.dtype.kind in "fiu" for array in arrays.values()):
                raise ValueError("weights that are no real numbers")
            layers = range(record["layers"])
            return cls(
                weights=tuple(arrays[f"weight_{i}"] for i in layers),
                biases=tuple(arrays[f"bias_{i}"] for i in layers),
                activation=record["activation"],
                observation_shape=tuple(record["observation_shape"]),
                head=read_head(record["head"], arrays),
                scaling=_scaling(record, arrays),
            )
        except (*MALFORMED, OSError) as error:
            raise StorageError(
                f"{folder} must hold a whole {RECORD_FILE} and {WEIGHTS_FILE}, got {error!r}; "
                "save the policy again"
            ) from error


def _scaling(record: Any, arrays: Any) -> Scaling | None:
    if "clip" not in record:
        return None
    mean, scale = arrays["scaling_mean"], arrays["scaling_scale"]
    shape = tuple(record["observation_shape"])
    if mean.shape != shape or scale.shape != shape or not (scale > 0.0).all():
        raise ValueError(f"statistics of observations of shape {shape} must have it and be > 0")
    return Scaling(mean, scale, float(record["clip"]))


def is_mlp_folder(files: Sequence[str]) -> bool:
    """True when a folder with these file names holds a saved `MLPPolicy`."""
    return RECORD_FILE in files and WEIGHTS_FILE in files


# ---- what the outputs mean -----------------------------------------------------------------------


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
        return {"kind": "box", "squash": head.squash, "whole": head.whole}
    return {"kind": "discrete", **asdict(head)}


def read_head(record: Mapping[str, Any], arrays: Mapping[str, Array32]) -> DiscreteHead | BoxHead:
    """Rebuild a head from `head_record` and its arrays; KeyError or ValueError when damaged."""
    if record["kind"] == "box":
        low, high, log_std = arrays["low"], arrays["high"], arrays.get("log_std")
        if low.shape != high.shape or (log_std is not None and log_std.shape != (low.size,)):
            raise ValueError(f"bounds of a box must have one shape, got {low.shape}, {high.shape}")
        whole = str(record["whole"])
        if whole and np.dtype(whole).kind not in "iu":
            raise ValueError(f"whole actions must be of an integer type, got {whole!r}")
        return BoxHead(low, high, bool(record["squash"]), log_std, whole)
    if record["kind"] == "discrete":
        sizes = tuple(record["sizes"])
        if not (sizes and all(type(size) is int and size > 0 for size in sizes)):
            raise ValueError(f"sizes must be whole numbers > 0, got {sizes}")
        start = tuple(record["start"])
        if start and (len(start) != len(sizes) or not all(type(s) is int for s in start)):
            raise ValueError(f"first options must be as many whole numbers as sizes, got {start}")
        return DiscreteHead(sizes, bool(record["scalar"]), bool(record["samples"]), start)
    raise ValueError(f"unknown action head {record['kind']!r}")


def _not_a_distribution() -> InvalidInput:
    return InvalidInput(
        "this policy holds no action distribution to sample; use deterministic=True"
    )
