"""How near the walker in jax is to Box2D's: from step to step, and in whole episodes.

    python evidence/walker_twin.py [--part steps returns start] [--episodes 40]

`steps` takes states of Box2D's walker under Gymnasium's own gait with noise, moves each by one step
in both, and prints by how much angles and angular speeds of the five bodies differ then, for steps
without contact, with one piece of ground touched and with more. `returns` plays random actions, no
torque and the action of standing still in several contexts, in both. `start` prints how far off the
state is that is looked up for a first action; `--write` makes the table from Box2D's walkers first.
Policies are compared by `twin_transfer.py --cmdp walker-gravity --policies FOLDER`.
"""

from __future__ import annotations

import measure  # noqa: F401  first: threads

import argparse  # isort: skip
import importlib
from itertools import product
from typing import Any

import numpy as np

import mbtl.engine.worlds as worlds

import jax  # isort: skip  # after mbtl, which sets its flags
import jax.numpy as jnp  # isort: skip

from mbtl.zoo.cmdps.locomotion.walker import (
    FLAT,
    FPS,
    HEIGHT,
    N_MOTORS,
    PATCHES,
    ROUGH,
    STEP,
    Constants,
    Walker,
    advance,
    heights,
    luck,
)
from mbtl.zoo.worlds.walker import BipedalWalker, WalkerParams, WalkerState
from mbtl.zoo.worlds.walker import walker as twin
from mbtl.zoo.worlds.walker.walker import moved

NOMINAL = Constants(10.0, 2.5, 30.0)
CONTEXTS = [
    NOMINAL,
    *(NOMINAL._replace(gravity=g) for g in (2.0, 20.0)),
    *(NOMINAL._replace(friction=f) for f in (0.1, 10.0)),
    *(NOMINAL._replace(scale=s) for s in (10.0, 90.0)),
]
STRENGTHS = 5
SCALES = (5, 10, 15, 20, 30, 40, 50, 60, 80, 100)
GRAVITIES, FRICTIONS = (0.2, 2, 5, 10, 20), (0.1, 0.5, 2.5, 10)
STILL = np.zeros((1, N_MOTORS), np.float32)
ENV = BipedalWalker()
WORLD = worlds.Solo(ENV)


def params(context: Constants, n: int | None = None) -> WalkerParams:
    """Of one walker, or of n."""
    values = [jnp.float32(x) for x in context]
    if n is None:
        return WalkerParams(*values, jnp.zeros(0))
    return WalkerParams(*(jnp.full(n, x) for x in values), jnp.zeros((n, 0)))


def made(context: Constants, rng: np.random.Generator) -> tuple[Walker, Any]:
    """Box2D's walker at the start of an episode, and its ground."""
    luck = rng.random(ROUGH + PATCHES + 1)
    walker = Walker(context, luck)
    return walker, jnp.asarray(heights(luck, context.scale), jnp.float32)


def pose(walker: Walker) -> tuple[Any, Any, Any]:
    """Centre of the hull, angles, and speeds of the bodies."""
    bodies = walker.bodies
    moving = [(*tuple(body.linearVelocity), body.angularVelocity) for body in bodies]
    angles = [body.angle for body in bodies]
    return tuple(np.array(x, np.float32) for x in (tuple(bodies[0].worldCenter), angles, moving))  # type: ignore[return-value]


def steps(episodes: int) -> None:
    """Prints differences after one step."""
    from gymnasium.envs.box2d.bipedal_walker import BipedalWalkerHeuristics

    own = params(NOMINAL)
    step = jax.jit(
        lambda state, action: moved(
            state, jnp.sign(action) * twin.SPEEDS, twin.TORQUE * jnp.abs(action), own
        )
    )
    rng, found = np.random.default_rng(0), {0: [], 1: [], 2: []}  # type: ignore[var-annotated]
    for _ in range(episodes):
        walker, ground = made(NOMINAL, rng)
        gait, (seen, _, _) = BipedalWalkerHeuristics(), advance([walker], STILL)
        gait.a = np.zeros(N_MOTORS)
        memory = jnp.zeros(4, jnp.int32), jnp.zeros((4, 4), bool), jnp.zeros(2, bool)
        for number in range(300):
            action = gait.step_heuristic(seen[0]) + rng.normal(0.0, 0.3, N_MOTORS)
            action = np.clip(action, -1.0, 1.0).astype(np.float32)
            new = step(WalkerState(*pose(walker), ground, *memory), action)
            memory = new.first, new.touching, memory[2]
            seen, _, over = advance([walker], action[None])
            if over[0]:
                break
            if number > 2:
                _, angles, moving = pose(walker)
                angle = np.abs(new.angles - angles).max()
                turning = np.abs(np.asarray(new.moving)[:, 2] - moving[:, 2]).max()
                found[min(int(new.touching.sum()), 2)].append((angle, turning))
    print("pieces touched   steps   angles [rad]: 50 % 90 % of steps   angular speeds [rad/s]")
    for touched, name in enumerate(("none", "one", "more")):
        errors = np.array(found[touched])
        half, most = np.quantile(errors, [0.5, 0.9], axis=0)
        print(
            f"{name:14} {len(errors):7}   below {half[0]:.5f}, {most[0]:.4f}"
            f"                below {half[1]:.5f}, {most[1]:.3f}"
        )


def returns(episodes: int) -> None:
    """Prints mean returns without a policy."""
    acts = {"random": None, "no torque": np.zeros(4), "unguided": np.array(ENV.idle)}

    @jax.jit
    def play(noise: Any, keys: Any, own: WalkerParams, act: Any, luck: Any) -> Any:
        def one(state: Any, key: Any) -> Any:
            drawn = jax.random.uniform(key, (len(noise), 1, 4), minval=-1.0, maxval=1.0)
            action = jnp.where(luck, drawn, jnp.broadcast_to(act, drawn.shape))
            return WORLD.step(state, action, own).state, None

        return jax.lax.scan(one, WORLD.start(noise, own), keys)[0].total

    print("actions     gravity friction scale   twin            Box2D")
    for name, act in acts.items():
        for context in CONTEXTS:
            rng = np.random.default_rng(0)
            noise = jnp.asarray(rng.random((episodes, 2)), jnp.float32)
            keys = jax.random.split(jax.random.key(0), ENV.horizon)
            fixed = jnp.zeros(4) if act is None else jnp.asarray(act)
            ours = np.asarray(play(noise, keys, params(context, episodes), fixed, act is None))
            theirs = np.zeros(episodes)
            for episode in range(episodes):
                walker, _ = made(context, rng)
                advance([walker], STILL)
                for _ in range(ENV.horizon):
                    action = rng.uniform(-1.0, 1.0, 4) if act is None else act
                    _, reward, over = advance([walker], action[None].astype(np.float32))
                    theirs[episode] += reward[0]
                    if over[0]:
                        break
                walker.close()
            means = "   ".join(
                f"{x.mean():6.1f} +- {x.std() / len(x) ** 0.5:4.1f}" for x in (ours, theirs)
            )
            print(
                f"{name:11} {context[0]:7g} {context[1]:8g} {context[2]:5g}   {means}", flush=True
            )


def start(write: bool) -> None:
    """Writes the states after the first action; prints how far others are from these."""
    actions = np.array(list(product(np.linspace(-1.0, 1.0, STRENGTHS), repeat=N_MOTORS)))

    def after(**own: float) -> np.ndarray:
        return np.array([begun(NOMINAL._replace(**own), action)[1] for action in actions])

    if write:
        nominal = after()
        found = {"by_scale": np.array([after(scale=s) for s in SCALES])}
        found["made"] = np.array([begun(NOMINAL._replace(scale=s), actions[0])[0] for s in SCALES])
        for axis, values in (("gravity", GRAVITIES), ("friction", FRICTIONS)):
            found[f"by_{axis}"] = np.array([after(**{axis: v}) - nominal for v in values])
            found[axis] = np.array(values)
        found["scale"] = np.array(SCALES)
        small = {name: values.astype(np.float16) for name, values in found.items()}
        np.savez_compressed(twin.FILE, **small)  # type: ignore[arg-type]
        importlib.reload(twin)
    rng = np.random.default_rng(0)
    look_up = jax.jit(twin.after)
    print("after a first action: errors of angles and angular speeds; 50 %, 90 % of 200 actions")
    size = 200, N_MOTORS
    drawn = {
        "drawn evenly": rng.uniform(-1.0, 1.0, size),
        "normal, cut off at 1": np.clip(rng.normal(0.0, 1.0, size), -1.0, 1.0),
        "full strength": rng.choice([-1.0, 1.0], size),
    }
    for name, some in drawn.items():
        errors = []
        for context, action in product(CONTEXTS, some):
            rounding = rng.random(N_MOTORS)
            ours, truth = look_up(action, rounding, *context), begun(context, action)[1]
            apart = (
                np.asarray(ours.angles) - truth[2:7],
                np.asarray(ours.moving)[:, 2] - truth[7:22].reshape(5, 3)[:, 2],
            )
            errors.append([np.abs(x).max() for x in apart])
        half, most = np.quantile(errors, [0.5, 0.9], axis=0)
        print(f"{name:22} {half[0]:.3f}, {most[0]:.3f} rad   {half[1]:.2f}, {most[1]:.2f} rad/s")
    begin(200, rng)


def begin(episodes: int, rng: np.random.Generator) -> None:
    """Prints how first steps differ: an action of full strength, then actions drawn evenly."""
    initial, step = (jax.jit(f) for f in (ENV.initial, ENV.step))
    own = params(NOMINAL)
    seen = np.zeros((4, episodes, 2, 3))  # of twin and Box2D: feet that are down, rise in m/s
    for episode in range(episodes):
        noise = rng.random(2)
        walker, state = Walker(NOMINAL, luck(noise)), initial(jnp.asarray(noise, jnp.float32), own)
        advance([walker], STILL)
        for number in range(len(seen)):
            action = rng.uniform(-1.0, 1.0, N_MOTORS).astype(np.float32)
            action = action if number else np.sign(action)
            state = step(state, jnp.asarray(action), own).state
            advance([walker], action[None])
            rise = walker.bodies[0].linearVelocity.y
            theirs = [walker.contact[2], walker.contact[4], rise]
            seen[number, episode] = [*np.asarray(state.feet), state.moving[0, 1]], theirs
        walker.close()
    feet = (seen[:, :, 0, :2] == seen[:, :, 1, :2]).mean(axis=(1, 2))
    rising = np.abs(seen[:, :, 0, 2] - seen[:, :, 1, 2]).mean(axis=1)
    for number, (same, off) in enumerate(zip(feet, rising, strict=True), 1):
        print(
            f"action {number}: of {same:.0%} of feet both say whether they are down; "
            f"the hull rises {off:.3f} m/s faster or slower"
        )


def begun(context: Constants, action: Any) -> tuple[np.ndarray, np.ndarray]:
    """Rows of `walker.npz`: a walker without a push before and after its first action."""
    walker, rows = Walker(context, np.full(ROUGH + PATCHES + 1, 0.5)), []
    for motors in (np.zeros(N_MOTORS), action):
        advance([walker], np.asarray(motors, np.float32)[None])
        _, angles, moving = pose(walker)
        place = walker.bodies[0].position
        feet = [walker.contact[2], walker.contact[4]]
        at = [place.x - STEP * FLAT / 2.0, place.y - HEIGHT, *angles]
        rows.append(np.array([*at, *moving.ravel(), *feet]))
    walker.close()
    return rows[0][:7], rows[1]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parts = ("steps", "returns", "start")
    parser.add_argument("--part", nargs="+", choices=parts, default=list(parts))
    parser.add_argument("--episodes", type=int, default=40)
    parser.add_argument("--write", action="store_true", help="the starts that the world reads")
    args = parser.parse_args()
    print(f"steps of {1000 / FPS:g} ms")
    if "steps" in args.part:
        steps(args.episodes)
    if "returns" in args.part:
        returns(args.episodes)
    if "start" in args.part:
        start(args.write)


if __name__ == "__main__":
    main()
