"""BipedalWalker with gravity, friction and scale as context (cmdp-spec, 4.3).

Gymnasium's BipedalWalker-v3 on Box2D, each instance with constants of its own. In the nominal
context it is that environment, step for step, on the same ground:

    gravity    [m/s^2], 10
    friction   of the ground, 2.5; with a leg, whose own is 0.2, Box2D takes sqrt(0.2 friction)
    scale      30; the smaller, the larger the hull and the rougher the ground
"""

from __future__ import annotations

import functools
import math
import warnings
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any, ClassVar, NamedTuple, Unpack

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray

from mbtl.arrays import Array
from mbtl.canvas import Canvas, Image, Window
from mbtl.contexts import Value
from mbtl.errors import ContextMismatch, InvalidInput
from mbtl.zoo.cmdps.contextual import ContextualEnv, Observation, Settings

# One walker: a Box2D world of its own, whose gravity, ground and hull are those of its context
#
# Bodies: the hull, then thigh and shin of either leg. Joints: hip and knee of either leg.
# What is seen and paid is computed for many walkers together, in numpy: `advance`.
#
# Lengths are those of Gymnasium's BipedalWalker-v3 at scale 30. As in the reference the scale
# divides the hull, the roughness of the ground and what a metre forward is worth; legs, range
# finder and the ground's length stay as they are (cmdp-spec, 4.3).


with warnings.catch_warnings():  # where its own is made an error, the import ends the process
    warnings.simplefilter("ignore")
    import Box2D

FPS = 50
TORQUE = 80.0
SPEEDS = (4.0, 6.0, 4.0, 6.0)
"""Of hips and knees [rad/s], at full speed."""
N_MOTORS, N_FEATURES = 4, 24
STANCE = (-0.2, 0.0, 0.2, 0.0)
"""An action with which it stands still: hips held apart. Without any torque it falls."""

_NOMINAL_SCALE = 30.0
STEP = 14.0 / _NOMINAL_SCALE
"""Length of a piece of ground [m]."""
POINTS = 200
"""Points between the pieces of ground."""
FLAT = 20
"""Pieces of flat ground at the beginning; the walker starts in their middle."""
HEIGHT = 400.0 / _NOMINAL_SCALE / 4.0
"""Of the ground [m], on average."""
END = (POINTS - 10) * STEP
"""Where an episode is won [m]."""
HULL = ((-30.0, 9.0), (6.0, 9.0), (34.0, 1.0), (34.0, -8.0), (-30.0, -8.0))
LEG_WIDTH, LEG_HEIGHT = 8.0 / _NOMINAL_SCALE, 34.0 / _NOMINAL_SCALE
_LEG_DOWN = -8.0 / _NOMINAL_SCALE
_PUSH = 5.0
"""Largest force on the hull in the first step [N]."""
_RANGE = 160.0 / _NOMINAL_SCALE
_RAYS = 10
_NEAR = math.ceil(_RANGE / STEP) + 2
"""Pieces of ground that a ray can meet."""

N_NOISE = 2
"""Uniform random numbers that start an episode; all its luck follows from them, see `luck`."""
ROUGH, PATCHES = POINTS - FLAT - 1, (POINTS - FLAT) // 5 + 1
"""Numbers that slopes and the distances of level pieces take."""

_GROUND, _WALKER = 0x0001, 0x0020
_SPREAD = 0.05
"""Angle of each leg at the start [rad]; hips count from there."""

# What a step measures, see `Walker.push`, and where it is seen.
N_MEASURED = 19
_HULL, _HULL_FACTORS = [0, 5, 12, 13], np.array([1.0, 2.0, 0.3, 0.3])
_PARTS, _ABOVE = [1, 2, 3, 4, 6, 7, 8, 9], [0, 1, 0, 3, 5, 6, 5, 8]
"""Angles and speeds of thigh, shin, thigh, shin, and of what they hang on."""
_BENT = np.array([-_SPREAD, 0.0, _SPREAD, 0.0, 0.0, 0.0, 0.0, 0.0], np.float32)
_OFFSET = np.array([0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0])
_FULL = np.array([1.0, 1.0, 1.0, 1.0, *SPEEDS])
_JOINTS_AT, _FEET, _FEET_AT = [4, 6, 9, 11, 5, 7, 10, 12], [16, 18], [8, 13]
_SPEEDS32 = np.array(SPEEDS, np.float32)
_AHEAD = np.array([math.sin(1.5 * i / 10.0) * _RANGE for i in range(_RAYS)])
_BELOW = np.array([math.cos(1.5 * i / 10.0) * _RANGE for i in range(_RAYS)])


class Constants(NamedTuple):
    """What a context changes."""

    gravity: float
    friction: float
    scale: float


def luck(noise: Array) -> Array:
    """(ROUGH + PATCHES + 1,) uniform numbers: for slopes, distances of level pieces, and the push.

    Args:
        noise: (2,) uniform numbers in [0, 1); what they have beyond 24 bits does not count.
    """
    words = np.floor(np.asarray(noise, np.float32) * np.float32(2**24)).astype(np.uint32)
    return np.random.default_rng(words).random(ROUGH + PATCHES + 1)


def heights(luck: Array, scale: float) -> list[float]:
    """(200,) heights of the ground [m]: a random walk that is drawn back, with level pieces.

    Args:
        luck: uniform numbers; see the function.
        scale: the larger, the smoother.
    """
    slopes, patches = luck[:ROUGH].tolist(), luck[ROUGH:-1].tolist()
    y, slope, left, level, found = HEIGHT, 0.0, FLAT, False, []
    slopes.reverse()
    patches.reverse()
    for i in range(POINTS):
        if not level:
            slope = 0.8 * slope + 0.01 * ((y < HEIGHT) - (y > HEIGHT))
            if i > FLAT:
                slope += (2.0 * slopes.pop() - 1.0) / scale
            y += slope
        level = False
        found.append(y)
        left -= 1
        if left == 0:
            left, level = 5 + int(5.0 * patches.pop()), True
    return found


class Walker:
    """A walker on its ground.

    Attributes:
        scale: of its context.
        world: of Box2D.
        bodies: hull, thigh, shin, thigh, shin.
        ground: (7, 199) float32: of each piece its first point, its extent, its normal and the
            square of its length.
        contact: whether hull, thighs and shins touch the ground; as in Gymnasium a shin that leaves
            one piece of it counts as in the air, and the hull as fallen for ever.
        progress: what the way so far is worth; None before the first step.
    """

    __slots__ = (
        "_joints",
        "_listener",
        "bodies",
        "contact",
        "ground",
        "progress",
        "scale",
        "world",
    )

    def __init__(self, constants: Constants, luck: Array) -> None:
        """At its start.

        Args:
            constants: of its context.
            luck: uniform numbers; see the function.

        Raises:
            ContextMismatch: Box2D cannot have such a hull.
        """
        self.scale = float(constants.scale)
        self.world = Box2D.b2World(gravity=(0.0, -float(constants.gravity)))
        self.ground = self._lay(heights(luck, self.scale), float(constants.friction))
        try:
            self.bodies, self._joints = self._build()
        except (AssertionError, ValueError) as error:
            raise ContextMismatch(
                f"a walker needs a hull that Box2D can compute with, got scale {self.scale:g} "
                f"({error}); the smaller the scale, the larger the hull"
            ) from error
        push = -_PUSH + 2.0 * _PUSH * float(luck[-1])
        self.bodies[0].ApplyForceToCenter((push, 0.0), True)
        self.contact = [False] * len(self.bodies)
        self.progress: float | None = None
        self._listener = _Touch(self.contact)
        self.world.contactListener = self._listener

    def close(self) -> None:
        """Give its memory back now; nothing may be asked any more."""
        self.world.contactListener = None
        self.bodies = self._joints = ()

    def push(self, speeds: Sequence[float], torques: Sequence[float]) -> list[float]:
        """One step of the motors.

        Returns:
            N_MEASURED numbers: angles of the five bodies, their angular speeds, place and speed of
            the hull, and which bodies touch the ground.
        """
        for joint, speed, torque in zip(self._joints, speeds, torques, strict=True):
            joint.motorSpeed = speed
            joint.maxMotorTorque = torque
        self.world.Step(1.0 / FPS, 180, 60)
        bodies = self.bodies
        place, speed = bodies[0].position, bodies[0].linearVelocity
        found = [body.angle for body in bodies]
        found += [body.angularVelocity for body in bodies]
        found += (place.x, place.y, speed.x, speed.y)
        found += self.contact
        return found

    def _lay(self, ys: Sequence[float], friction: float) -> NDArray[np.float32]:
        body, edge = self.world.CreateStaticBody(), Box2D.b2EdgeShape()
        piece = Box2D.b2FixtureDef(shape=edge, friction=friction, categoryBits=_GROUND)
        points = [(i * STEP, y) for i, y in enumerate(ys)]
        for first, second in pairwise(points):
            edge.vertex1, edge.vertex2 = first, second
            piece.shape = edge
            body.CreateFixture(piece)
        ends = np.array(points, np.float32)
        v1, e = ends[:-1], ends[1:] - ends[:-1]
        squared = e[:, 0] * e[:, 0] + e[:, 1] * e[:, 1]
        normal = (
            np.stack([e[:, 1], -e[:, 0]], axis=1) * (np.float32(1.0) / np.sqrt(squared))[:, None]
        )
        return np.ascontiguousarray(np.concatenate([v1, e, normal, squared[:, None]], axis=1).T)

    def _build(self) -> tuple[Any, Any]:
        x, y = STEP * FLAT / 2.0, HEIGHT + 2.0 * LEG_HEIGHT
        hull = self.world.CreateDynamicBody(
            position=(x, y),
            fixtures=_part(tuple((a / self.scale, b / self.scale) for a, b in HULL), 5.0, 0.1),
        )
        hull.userData = 0
        bodies, joints = [hull], []

        def hang(above: Any, down: float, width: float, angle: float, **joint: float) -> Any:
            """A part of a leg below another body; `down` is where they meet on that."""
            body = self.world.CreateDynamicBody(
                position=(x, y - LEG_HEIGHT * (0.5 if above is hull else 1.5) - _LEG_DOWN),
                angle=angle,
                fixtures=_part((width / 2.0, LEG_HEIGHT / 2.0), 1.0),
            )
            body.userData = len(bodies)
            bodies.append(body)
            meets = Box2D.b2RevoluteJointDef(
                bodyA=above,
                bodyB=body,
                localAnchorA=(0.0, down),
                localAnchorB=(0.0, LEG_HEIGHT / 2.0),
                enableMotor=True,
                enableLimit=True,
                maxMotorTorque=TORQUE,
                **joint,
            )
            joints.append(self.world.CreateJoint(meets))
            return body

        for side in (-1, 1):
            angle, hip = side * _SPREAD, {"lowerAngle": -0.8, "upperAngle": 1.1}
            thigh = hang(hull, _LEG_DOWN, LEG_WIDTH, angle, motorSpeed=side, **hip)
            knee = {"lowerAngle": -1.6, "upperAngle": -0.1}
            hang(thigh, -LEG_HEIGHT / 2.0, 0.8 * LEG_WIDTH, angle, motorSpeed=1.0, **knee)
        return bodies, joints


def advance(
    walkers: Sequence[Walker], action: NDArray[np.float32]
) -> tuple[NDArray[np.float32], Array, NDArray[np.bool_]]:
    """One step of each walker.

    Args:
        walkers: n of them.
        action: (n, 4) motors; clipped to +-1. A walker whose action is not a number stays where it
            is, and what it sees and earns is not a number.

    Returns:
        (n, 24) what is seen, (n,) rewards, and (n,) whether it has fallen or is at the end.
    """
    strength = np.minimum(np.abs(action), np.float32(1.0))
    torques, speeds = (np.float32(TORQUE) * strength), _SPEEDS32 * np.sign(action)
    lost = np.logical_not(np.all(np.isfinite(action), axis=1))
    moves = zip(walkers, list(lost), speeds.tolist(), torques.tolist(), strict=True)
    rows = [
        [math.nan] * N_MEASURED if nowhere else walker.push(speed, torque)
        for walker, nowhere, speed, torque in moves
    ]
    now = np.array(rows, np.float32)  # they are of single precision
    scale = np.array([walker.scale for walker in walkers])
    seen = np.empty((len(walkers), N_FEATURES))
    hull = now[:, _HULL] * _HULL_FACTORS
    hull[:, 2] *= 600.0 / scale
    hull[:, 3] *= 400.0 / scale
    hull[:, 1:] /= FPS
    seen[:, :4] = hull
    seen[:, _JOINTS_AT] = (now[:, _PARTS] - now[:, _ABOVE] - _BENT + _OFFSET) / _FULL
    seen[:, _FEET_AT] = now[:, _FEET]
    seen[:, 14:] = _ranges(walkers, now)
    x = now[:, 10].astype(float)
    progress = 130.0 * x / scale - 5.0 * np.abs(hull[:, 0])
    before = np.array([walker.progress for walker in walkers], float)  # None becomes NaN
    gain = np.where(np.isnan(before) & ~lost, 0.0, progress - before)
    for walker, worth in zip(walkers, progress.tolist(), strict=True):
        walker.progress = worth
    reward = gain - 0.00035 * TORQUE * strength.sum(axis=1, dtype=float)
    fallen = (now[:, 14] > 0.0) | (x < 0.0)
    reward[fallen] = -100.0
    seen[lost] = math.nan
    return seen.astype(np.float32), reward, fallen | (x > END) | ~np.isfinite(x)


def _ranges(walkers: Sequence[Walker], now: NDArray[np.float32]) -> NDArray[np.float32]:
    """(n, 10) share of the range finder's reach that is free along each ray.

    In the order of Box2D's operations, in single precision, so that the numbers are its own.
    """
    last = POINTS - 1 - _NEAR
    first = np.fmin(np.fmax(now[:, 10] / STEP - 1.0, 0.0), last).astype(int).tolist()
    near = [walker.ground[:, k : k + _NEAR] for walker, k in zip(walkers, first, strict=True)]
    v1x, v1y, ex, ey, nx, ny, squared = np.stack(near, axis=1)[:, :, None]
    x, y = now[:, 10, None], now[:, 11, None]
    dx = ((x + _AHEAD).astype(np.float32) - x)[..., None]
    dy = ((y - _BELOW).astype(np.float32) - y)[..., None]
    x, y = x[..., None], y[..., None]
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (nx * (v1x - x) + ny * (v1y - y)) / (nx * dx + ny * dy)
        s = ((x + t * dx - v1x) * ex + (y + t * dy - v1y) * ey) / squared
        hit = (t >= 0.0) & (t <= 1.0) & (s >= 0.0) & (s <= 1.0)
    t[~hit] = 1.0
    found: NDArray[np.float32] = t.min(axis=-1)
    return found


@functools.lru_cache(maxsize=4096)
def _part(shape: tuple[Any, ...], density: float, friction: float = 0.2) -> Any:
    """A fixture: a polygon's corners, or half a box's width and height; made once.

    Box2D's Python package never gives back the memory of one.
    """
    corners = isinstance(shape[0], tuple)
    polygon = Box2D.b2PolygonShape(**{"vertices" if corners else "box": shape})
    bits = {"categoryBits": _WALKER, "maskBits": _GROUND}
    return Box2D.b2FixtureDef(
        shape=polygon, density=density, friction=friction, restitution=0.0, **bits
    )


class _Touch(Box2D.b2ContactListener):  # type: ignore[misc]  # it has no types
    """Notes which body touches the ground."""

    def __init__(self, contact: list[bool]) -> None:
        super().__init__()
        self._contact = contact

    def BeginContact(self, contact: Any) -> None:
        self._contact[_who(contact)] = True

    def EndContact(self, contact: Any) -> None:
        who = _who(contact)
        if who:  # a hull that has touched the ground has fallen
            self._contact[who] = False


def _who(contact: Any) -> int:
    """Number of the body; the ground has none."""
    one = contact.fixtureA.body.userData
    number: int = contact.fixtureB.body.userData if one is None else one
    return number


# ---- pictures of a walker on its ground ------------------------------------------------------


WIDTH = 480
"""Pixels."""
_VIEW, _SHAPE = 14.0, 0.6
"""Metres that are shown, at least, and height by width."""
_SKY, _EARTH, _FLAG = (222, 230, 245), (120, 165, 96), (230, 60, 20)
_COLOURS = ((125, 70, 200), (90, 60, 120), (70, 45, 95), (190, 120, 190), (165, 95, 165))
"""Of hull, thigh and shin; thigh and shin of the other leg, which is nearer."""
_ORDER = (1, 2, 0, 3, 4)


def draw(walker: Walker) -> Image:
    """What is around the walker; the view widens with the hull.

    Returns:
        (height, width, 3) uint8.
    """
    parts = [_corners(body) for body in walker.bodies]
    x, y = (float(v) for v in walker.bodies[0].position)
    width = max(_VIEW, 2.0 * float(np.ptp(parts[0], axis=0).max()))
    left, bottom = x - 0.3 * width, y - 0.6 * _SHAPE * width
    window = Window(left, bottom, left + width, bottom + _SHAPE * width)
    canvas = Canvas(window, _SKY, WIDTH)
    first = np.searchsorted(walker.ground[0], (left - STEP, left + width))
    for ax, ay, ex, ey in walker.ground[:4, slice(*first)].T.astype(float):
        below = min(ay, ay + ey, bottom) - 1.0
        piece = [(ax, ay), (ax + ex + 0.01, ay + ey), (ax + ex + 0.01, below), (ax, below)]
        canvas.area(np.array(piece), _EARTH)
    height = float(walker.ground[1, int(END / STEP)])
    canvas.line(np.array([[END, height], [END, height + 2.0]]), canvas.at_least(0.05), _FLAG)
    for number in _ORDER:
        canvas.area(parts[number], _COLOURS[number])
    return canvas.image()


def _corners(body: object) -> Array:
    """(n, 2) of the polygon of a body [m]."""
    (fixture,) = body.fixtures  # type: ignore[attr-defined]  # Box2D has no types
    return np.array([tuple(body.transform * v) for v in fixture.shape.vertices])  # type: ignore[attr-defined]


# ---- the whole -------------------------------------------------------------------------------


def derive(features: Mapping[str, float]) -> Constants:
    """Constants of the world from all of `BipedalWalker.FEATURES`, in single precision."""
    names = ("gravity", "friction", "scale")
    return Constants(*(float(np.float32(features[name])) for name in names))


class BipedalWalker(ContextualEnv):
    """Walk to the far end of slightly uneven ground, with motors in two hips and two knees.

    Observation: hull angle and its speed, forward and upward speed; of either leg hip angle and
    speed, knee angle and speed, and whether its foot is on the ground; ten ranges to the ground
    ahead; then the visible features. Reward: 300 for the whole way, less for a tilted hull and for
    torque; -100 for a fall, which ends the episode.
    """

    HORIZON = 1000  # as in the reference; 1600 in Gymnasium
    FEATURES: ClassVar[Mapping[str, float]] = {
        "gravity": 10.0,  # m/s^2
        "friction": 2.5,
        "scale": 30.0,
    }
    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array"], "render_fps": FPS}

    def __init__(
        self, context: Mapping[str, Value] | None = None, **settings: Unpack[Settings]
    ) -> None:
        """Arguments as in `ContextualEnv`."""
        super().__init__(context, **settings)
        self.constants = derive(self.features)
        self.walker: Walker | None = None
        leg = [math.inf] * 4 + [1.0]
        high = [math.inf] * 4 + leg + leg + [1.0] * 10
        low = [-x if math.isinf(x) else 0.0 for x in high]
        self.observation_space = self._space(low, high)
        self.action_space = Box(-1.0, 1.0, (N_MOTORS,), np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode on new ground, with a push; the first step is without torque."""
        super().reset(seed=seed)
        self.walker = Walker(self.constants, luck(self.np_random.random(N_NOISE)))
        self._left = self.horizon
        seen, _, _ = advance([self.walker], np.zeros((1, N_MOTORS), np.float32))
        return self._shown(seen[0]), {}

    def drive(self) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """One step of standing still, where that goes: the unguided baseline."""
        return self.step(STANCE)

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """One step; actions beyond +-1 act as +-1.

        Raises:
            InvalidInput: no episode is running.
        """
        if self._left <= 0 or self.walker is None:
            raise self._no_episode()
        motors = np.asarray(action, np.float32).reshape(1, N_MOTORS)
        seen, reward, ended = advance([self.walker], motors)
        self._left = 0 if ended[0] else self._left - 1
        terminated, truncated = self._ends(self._left == 0 and not ended[0])
        return self._shown(seen[0]), float(reward[0]), bool(ended[0]) or terminated, truncated, {}

    def render(self) -> Any:
        """A picture of the walker, (height, width, 3); None without the render mode.

        Raises:
            InvalidInput: there is no walker yet.
        """
        if self.render_mode is None:
            return None
        if self.walker is None:
            raise InvalidInput("render() needs an episode, got none; call reset()")

        return draw(self.walker)

    def _shown(self, seen: Observation) -> Observation:
        return np.concatenate([seen, self.visible], dtype=np.float32)
