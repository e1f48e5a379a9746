"""One thread for small linear algebra.

A pick multiplies many small matrices. Spread over threads that takes several times the processor
time, because threads wait for each other by spinning: `auto` on a shipped matrix took 17 s of two
cores, and 3.6 s of one (`mbtl bench --matrix pendulum-length --selectors auto`, with and without
`OMP_NUM_THREADS=1`).
"""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from functools import cache
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController

MANY = 10_000  # contexts from which threads earn their keep


def threads_for(n: int) -> AbstractContextManager[Any]:
    """Within it, linear algebra over n contexts has as many threads as pay: one, when they are few.

    It counts for the whole process, not for the thread that asks.
    """
    return nullcontext() if n > MANY else _controller().limit(limits=1, user_api="blas")


@cache
def _controller() -> ThreadpoolController:
    import scipy.linalg  # noqa: F401  its libraries are to be among those found
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()
