"""The synthetic families of SD-MBTL by their parts, in the order of its tables.

    J(x, y) = 500 + f(x) + g(y) - h(x - y) + noise Z(x, y),    Z ~ N(0, 1), independent

The catalogue has every member by id (`synthetic:3d-const-lin-nd-eta5@100`); this spells the parts
out. Z is of the same distribution as published but other numbers: there one stream per trial
fills the N x N matrix row by row, here each row has a stream of its own, so that rows can be asked
for alone. Bounds of the 3d set are those over all its seeds, as published: ask for all 100
even to run a few of them.
"""

from __future__ import annotations

from typing import Literal

from mbtl.errors import InvalidInput
from mbtl.zoo.benchmark.shipped import PREFIX, synthetic_ids, synthetic_world
from mbtl.zoo.benchmark.synthetic import SyntheticWorld

Quality = Literal["constant", "linear"]
Difficulty = Literal["none", "linear"]

_SHORT = {"constant": "const", "none": "none", "linear": "lin"}
_OURS = "minor"  # the catalogue's own h, which the publication leaves out


def sd_world(
    dims: int = 3,
    *,
    f: Quality = "constant",
    g: Difficulty = "none",
    h: str = "l1",
    noise: float = 5.0,
    n_seeds: int | None = None,
) -> SyntheticWorld:
    """One world of the 3d (N = 512), 5d (3125) or 7d (16,384) set.

    Args:
        dims: number of axes.
        f: source quality; the 7d set has only "constant".
        g: target difficulty.
        h: dissimilarity: "l1", a distance; "nd" (5d: "nd1", "nd2"), directional on most axes.
        noise: standard deviation of Z's term, units of return (published: 0, 5, 15, 30 in 3d).
        n_seeds: published 100 in 3d, 5 else; 3 when missing, or 1 without noise.

    Raises:
        InvalidInput: f or g is not one of these, or several seeds are asked for without noise.
        UnknownName: the set has no such world.
    """
    for name, given, known in (("f", f, ("constant", "linear")), ("g", g, ("none", "linear"))):
        if given not in known:
            raise InvalidInput(f"{name} must be one of {known}, got {given!r}")
    seeds = "" if n_seeds is None else f"@{n_seeds}"
    return synthetic_world(f"{PREFIX}{dims}d-{_SHORT[f]}-{_SHORT[g]}-{h}-eta{noise:g}{seeds}")


def sd_worlds(
    dims: int = 3, *, noise: float = 5.0, n_seeds: int | None = None
) -> list[SyntheticWorld]:
    """Every published combination of f, g and h in one set.

    Raises:
        InvalidInput: there is no set of so many axes, or several seeds are asked for without noise.
    """
    variants = dict.fromkeys(
        name.rsplit("-eta", 1)[0]
        for name in synthetic_ids()
        if name.startswith(f"{PREFIX}{dims}d-") and f"-{_OURS}-" not in name
    )
    if not variants or dims == 1:
        raise InvalidInput(f"the sets of SD-MBTL have 3, 5 or 7 axes, got {dims}")
    seeds = "" if n_seeds is None else f"@{n_seeds}"
    return [synthetic_world(f"{variant}-eta{noise:g}{seeds}") for variant in variants]
