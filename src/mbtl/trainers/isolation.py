"""Isolation: the RL library seeds and uses global generators; nobody else should notice."""

from __future__ import annotations

import random
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np


@contextmanager
def isolated(threads: int | None = 1) -> Iterator[None]:
    """Run a block, then put back the global generators (random, numpy, torch) and torch's threads.

    Args:
        threads: torch threads inside the block; small networks are fastest, and reproducible across
            machines of different size, with one. None leaves the number alone.
    """
    import torch

    python_state, torch_state = random.getstate(), torch.get_rng_state()
    numpy_state = np.random.get_state()  # noqa: NPY002 - the library seeds it
    before = torch.get_num_threads()
    if threads is not None:
        torch.set_num_threads(threads)
    try:
        yield
    finally:
        torch.set_num_threads(before)
        torch.set_rng_state(torch_state)
        np.random.set_state(numpy_state)  # noqa: NPY002
        random.setstate(python_state)
