"""The states of a walker after its first action, which the twin in jax looks up, from Box2D's.

Box2D's walker is put together with its legs in the ground, and mends that in its first step.
Policies are compared by `twin_transfer.py --cmdp walker-gravity --policies FOLDER`.

    python evidence/walker_twin.py --write
"""

from __future__ import annotations

import argparse
from itertools import product

import numpy as np

from mbtl.zoo.cmdps.locomotion.walker import (
    FLAT,
    HEIGHT,
    N_MOTORS,
    PATCHES,
    ROUGH,
    STEP,
    Constants,
    Walker,
    advance,
)
from mbtl.zoo.worlds.walker.walker import FILE

NOMINAL = Constants(10.0, 2.5, 30.0)
STRENGTHS = 5
SCALES = (5, 10, 15, 20, 30, 40, 50, 60, 80, 100)
GRAVITIES, FRICTIONS = (0.2, 2, 5, 10, 20), (0.1, 0.5, 2.5, 10)


def starts() -> dict[str, np.ndarray]:
    """What `walker.FILE` holds."""
    actions = np.array(list(product(np.linspace(-1.0, 1.0, STRENGTHS), repeat=N_MOTORS)))

    def after(**own: float) -> np.ndarray:
        return np.array([begun(NOMINAL._replace(**own), action)[1] for action in actions])

    nominal = after()
    found = {"by_scale": np.array([after(scale=s) for s in SCALES])}
    found["made"] = np.array([begun(NOMINAL._replace(scale=s), actions[0])[0] for s in SCALES])
    for axis, values in (("gravity", GRAVITIES), ("friction", FRICTIONS)):
        found[f"by_{axis}"] = np.array([after(**{axis: v}) - nominal for v in values])
        found[axis] = np.array(values)
    found["scale"] = np.array(SCALES)
    return {name: values.astype(np.float16) for name, values in found.items()}


def begun(context: Constants, action: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A walker without a push before and after its first action."""
    walker, rows = Walker(context, np.full(ROUGH + PATCHES + 1, 0.5)), []
    for motors in (np.zeros(N_MOTORS), action):
        advance([walker], np.asarray(motors, np.float32)[None])
        bodies = walker.bodies
        angles = [body.angle for body in bodies]
        moving = [(*tuple(body.linearVelocity), body.angularVelocity) for body in bodies]
        feet = [walker.contact[2], walker.contact[4]]
        place = bodies[0].position
        at = [place.x - STEP * FLAT / 2.0, place.y - HEIGHT, *np.float32(angles)]
        rows.append(np.array([*at, *np.float32(moving).ravel(), *feet]))
    walker.close()
    return rows[0][:7], rows[1]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", action="store_true", help="the file that the twin reads")
    write, found, kept = parser.parse_args().write, starts(), np.load(FILE)
    for name, values in found.items():
        print(f"{name}: {np.abs(values.astype(float) - kept[name]).max():.2g} from the kept one")
    if write:
        np.savez_compressed(FILE, **found)


if __name__ == "__main__":
    main()
