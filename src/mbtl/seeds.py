"""The seed tree: every random number in a study hangs from one root seed.

A training seed depends on (root seed, trial, source) and never on the pick number, so one source
gives one policy in whatever order sources are picked, after a resume, and in a transfer matrix.
Where they are not the usual ones, the set of contexts, what a training began from and the try
count, too. A training that goes on keeps the seed of its beginning.
An evaluation seed depends on (root seed, trial, purpose, target), never on the policy, so what two
policies differ by is no luck. Each target has its own: where all of them shared their episodes, a
lucky one would be lucky everywhere, and a mean over targets, such as V, would not make it smaller.
Seeds of different purposes are disjoint by construction: the purpose is the top four bits.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from enum import IntEnum
from functools import lru_cache
from typing import Any

import numpy as np

from mbtl.errors import InvalidInput

__all__ = [
    "MATRIX_TRIAL",
    "PER_TARGET",
    "Purpose",
    "action_seed",
    "checkpoint_seeds",
    "derive_seed",
    "episode_seed",
    "episode_seeds",
    "evaluation_seeds",
    "seeds_in",
    "selection_rng",
    "training_seed",
]

_HASH_BITS = 28  # purpose (4 bits) + hash (28 bits) fit the 32-bit seeds that RL libraries accept


MATRIX_TRIAL = 0
"""Trial of transfer matrices and their baselines: seed s is the root of a study's seed tree."""

PER_TARGET = "per target"
"""What the provenance of a matrix says of its evaluation seeds; older ones say nothing, and all
targets shared theirs."""


class Purpose(IntEnum):
    """What a seed is for; two purposes never share a seed."""

    TRAINING = 0
    EVALUATION = 1
    """Rows that the selector sees; the same episodes for every policy."""
    REPORT = 2
    """Fresh episodes for the V that people are told."""
    CHECKPOINT = 3
    """Periodic evaluations that choose the best checkpoint of one training."""
    SELECTION = 4
    """Random choices of a selector."""
    ACTION = 5
    """Random actions, whose seed is derived from that of the episode or training they belong to."""


def derive_seed(root: int, purpose: Purpose, *path: int) -> int:
    """Hash (root, purpose, path) to a 32-bit seed.

    Args:
        root: the study's seed, >= 0.
        purpose: keeps the seeds of different uses apart.
        path: further non-negative keys, e.g. trial and source index.

    Returns:
        An integer in [purpose * 2**28, (purpose + 1) * 2**28).

    Raises:
        InvalidInput: a key is negative.
    """
    if root < 0 or any(key < 0 for key in path):
        raise InvalidInput(f"seeds and their keys must be >= 0, got root {root} and path {path}")
    state = np.random.SeedSequence(entropy=root, spawn_key=(int(purpose), *path)).generate_state(1)
    return (int(purpose) << _HASH_BITS) | (int(state[0]) >> (32 - _HASH_BITS))


def training_seed(
    root: int, trial: int, source: int | Sequence[int], retry: int = 0, lineage: Sequence[int] = ()
) -> int:
    """Seed of a training in `trial`; independent of the pick number.

    Args:
        root: the study's seed.
        trial: repetition of the same problem.
        source: index of the context trained on; or those of several.
        retry: how often it failed and was begun again: with its seed it might fail again.
        lineage: what the policy it begins from was made of, as numbers >= 0; none: from scratch.
    """
    contexts = (source,) if isinstance(source, int | np.integer) else tuple(source)
    if len(contexts) == 1 and not lineage:
        again = (0, retry) if retry else ()
        return derive_seed(root, Purpose.TRAINING, trial, *contexts, *again)
    path = (len(contexts), *contexts, *lineage)
    return derive_seed(root, Purpose.TRAINING, trial, contexts[0], 1, retry, *path)


def evaluation_seeds(
    root: int, trial: int, targets: Iterable[int], purpose: Purpose = Purpose.EVALUATION
) -> list[int]:
    """Seed of the evaluations on each of these targets (indices), the same for every policy."""
    return [derive_seed(root, purpose, trial, target) for target in targets]


def episode_seed(evaluation: int, episode: int) -> int:
    """Seed of one episode of an evaluation: the same for every policy.

    Args:
        evaluation: seed of the target, from `evaluation_seeds` (or any seed >= 0 of a user's own).
        episode: 0-based number of the episode.

    Returns:
        A seed of the evaluation's own purpose; `Purpose.EVALUATION` for a seed that has none.
    """
    top = evaluation >> _HASH_BITS
    known = Purpose.TRAINING < top < Purpose.ACTION
    return derive_seed(evaluation, Purpose(top) if known else Purpose.EVALUATION, episode)


def episode_seeds(evaluations: Sequence[int] | int, targets: int, episodes: int) -> list[list[int]]:
    """Seeds of all episodes on all targets, (targets, episodes); see `episode_seed`.

    Args:
        evaluations: one seed per target; a single number stands for one each that follow from it
            and from the place in the list, where no study hands any out.
        targets: number of them.
        episodes: of each.

    Raises:
        InvalidInput: there is not one seed per target.
    """
    if isinstance(evaluations, int | np.integer):
        evaluations = evaluation_seeds(int(evaluations), 0, range(targets))
    if not hasattr(evaluations, "__len__") or len(evaluations) != targets:
        raise InvalidInput(
            f"an evaluation takes one seed per context, here {targets}, got {evaluations!r}; a "
            "study hands them out (`study.evaluation_seeds()`), elsewhere one number will do"
        )
    return [list(_episodes_of(seed, episodes)) for seed in evaluations]


@lru_cache(maxsize=10_000)  # every policy is evaluated with them again
def _episodes_of(evaluation: int, episodes: int) -> tuple[int, ...]:
    return tuple(episode_seed(evaluation, e) for e in range(episodes))


def seeds_in(records: Iterable[Mapping[str, Any]]) -> str | None:
    """What the provenance of a file says of its evaluation seeds; None: nothing is known."""
    built = [record for record in records if "recipe" in record]
    kinds = {str(record.get("evaluation_seeds", "common to all targets")) for record in built}
    return ", or ".join(sorted(kinds)) or None


def checkpoint_seeds(training: int, episodes: int) -> list[int]:
    """Seeds of the episodes by which a training judges itself, the same at every checkpoint."""
    return [derive_seed(training, Purpose.CHECKPOINT, e) for e in range(episodes)]


def action_seed(seed: int) -> int:
    """Seed of random actions where `seed` is that of the environment.

    Gymnasium makes its generators from a seed as `np.random.default_rng` does, so that one seed for
    both would make the noise of the actions the numbers that the environment draws.
    """
    return derive_seed(seed, Purpose.ACTION)


def selection_rng(root: int, trial: int, pick: int) -> np.random.Generator:
    """Generator for the selector's own random choices at its `pick`-th proposal (0-based)."""
    return np.random.default_rng(derive_seed(root, Purpose.SELECTION, trial, pick))
