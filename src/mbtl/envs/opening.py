"""Opening environments: what is refused at once, and who needs a process of its own.

An environment is trusted to be new, to remember nothing of others, and to run beside others in one
process. Each is looked at before two are open at once: some simulators that are asked for a second
simulation fail, some silently share the first, and some never return.
"""

from __future__ import annotations

import re
import sys
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from mbtl.contexts import Context
from mbtl.envs.recording import difference, draw_actions, opened, roll, roll_together
from mbtl.envs.rollout import LONGEST_EPISODE, endless, one_instance
from mbtl.envs.slots import as_one
from mbtl.envs.spaces import check_taken, refuse_outside
from mbtl.errors import InvalidInput, MissingExtra, Notice

_TELLING = 10_000
"""Steps of an episode without an end after which that is said."""
_LOOKED_AT = 1000
"""Observations of an episode that must lie in their space, and its last."""
TRIED = 20
"""Steps that show whether two environments in one process disturb each other."""

shared_well: dict[str, Callable[[], bool]] = {}
"""By name of a simulator that lives once per process: whether it is held by somebody who lets the
next environment do without it."""


@dataclass(frozen=True)
class Once:
    """Why environments of one process disturb each other.

    Attributes:
        name: of the simulator, or of the module of the environment with what it raised.
        silent: nothing is raised; what one does changes what the other shows.
    """

    name: str
    silent: bool = False


_known: dict[tuple[int, bool], tuple[Any, Once | None]] = {}
"""Answers of `once_per_process`, by the identity of a factory, which is kept beside, and whether
two contexts were tried."""


def refuse_running_statistics(env: Any) -> None:
    """Refuse an environment that normalises by what it has seen so far.

    A policy would be evaluated with other statistics than those it was trained with.

    Raises:
        InvalidInput: naming the wrapper, and what to use instead.
    """
    layer, seen = env, set()
    while layer is not None and id(layer) not in seen:
        seen.add(id(layer))
        own = getattr(layer, "__dict__", {})
        held = [name for name, value in own.items() if _is_statistic(name, value)]
        frozen = False in (getattr(layer, n, True) for n in ("update_running_mean", "training"))
        if held and not frozen:
            what, option = "observations", "normalize_observations"
            if all(re.search("ret|rew", name.lower()) for name in held):
                what, option = "rewards", "normalize_reward"
            raise InvalidInput(
                "make_env must give environments without running statistics, which differ between "
                f"training and evaluation, got {type(layer).__name__} (its {', '.join(held)}), "
                f"which normalises {what}; take it out and use the trainer's {option}=True, which "
                "keeps them with the policy"
            )
        layer = getattr(layer, "env", None) or getattr(layer, "venv", None)


def _is_statistic(name: str, value: Any) -> bool:
    if isinstance(value, (bool, str)) or value is None:
        return False
    if re.search("running(mean|var|std|stat)", type(value).__name__.replace("_", "").lower()):
        return True
    return bool(re.search(r"(^|_)rms$|running_?(mean|var|std|stat)", name.lower()))


def is_same(one: Any, other: Any) -> bool:
    """Whether two environments are one, whatever wraps them."""
    return one is other or getattr(one, "unwrapped", one) is getattr(other, "unwrapped", other)


def once_per_process(
    make_env: Callable[[Context], Any], contexts: Sequence[Context], *, steps: int = TRIED
) -> Once | None:
    """What keeps two environments from running beside each other in one process; None: nothing.

    A simulator that is known to live once per process is told by its own state, before a second is
    opened. Of others two environments run alone, then in turn: that must give the same, to the last
    bit. One that is not deterministic alone is let pass, as nothing can be told. The answer is kept
    for as long as this process lives.

    Args:
        make_env: context -> environment.
        contexts: of the two that are tried, the first and the last.
        steps: of each rollout.

    Raises:
        InvalidInput: the factory hands out one instance, or running statistics.
    """
    inner = getattr(make_env, "make_env", None) if hasattr(make_env, "contexts") else None
    if inner is not None:  # `Everywhere` draws contexts; the simulators are those of its factory
        return once_per_process(inner, make_env.contexts, steps=steps)  # type: ignore[attr-defined]
    differ = contexts[0] != contexts[-1]
    for key in ((id(make_env), True), (id(make_env), False)):
        if key in _known and (key[1] or not differ or _known[key][1] is not None):
            return _known[key][1]
    found = _tried(make_env, contexts, steps)
    _known[id(make_env), differ] = make_env, found
    if found is not None:
        warnings.warn(
            f"{found.name} lives once per process: every environment gets a process of its own",
            Notice,
            stacklevel=2,
        )
    return found


def _tried(
    make_env: Callable[[Context], Any], contexts: Sequence[Context], steps: int
) -> Once | None:
    makers = [partial(make_env, dict(contexts[i])) for i in (0, -1)]
    with opened(makers[0]) as (env,):
        refuse_running_statistics(env)
        if hasattr(env, "possible_agents") and getattr(env, "most_agents", None) is None:
            env.reset(seed=0)  # a team of unknown size: only its simulator can be told
            return None if (name := _held()) is None else Once(name)
        one = as_one(env)
        actions = draw_actions(one.action_space, steps, 0)
        try:
            alone = roll(one, actions, 0)
        except InvalidInput:
            raise
        except Exception:  # it fails alone, which is said where it is used
            return None
        if (name := _held()) is not None:
            return Once(name)
    with opened(makers[0]) as (env,):
        if difference(alone, roll(as_one(env), actions, 0)) is not None:
            return None
    try:
        with opened(makers[1]) as (other,):
            roll(as_one(other), actions, 0)
    except Exception:  # it, too, fails alone
        return None
    try:
        with opened(*makers) as envs:
            if is_same(*envs):
                raise one_instance()
            together = roll_together([as_one(env) for env in envs], actions, 0)
    except (InvalidInput, MissingExtra):
        raise
    except Exception as error:  # each runs alone, so the other one is the reason
        return Once(f"{_module(env)} ({type(error).__name__}: {error})")
    return None if difference(alone, together[0]) is None else Once(_module(env), silent=True)


def _held() -> str | None:
    """A simulator that is known to live once per process, and runs in this one now."""
    signs = {
        "libsumo": ("libsumo", "isLoaded"),
        "MetaDrive": ("metadrive.engine.engine_utils", "engine_initialized"),
    }
    for name, (module, sign) in signs.items():
        running = getattr(sys.modules.get(module), sign, None)
        if running is not None and running() and not shared_well.get(name, bool)():
            return name
    return None


def _module(env: Any) -> str:
    return type(getattr(env, "unwrapped", env)).__module__


def watched_episode(env: Any, seed: int, *, say: Callable[[str], None] = lambda said: None) -> None:
    """Play one episode of random actions and look at all it shows.

    Args:
        env: as it was made.
        seed: of the episode.
        say: told when an end is long in coming.

    Raises:
        InvalidInput: an observation lies far outside its space, or the spaces are not taken.
        TrainingFailed: the episode does not end within `LONGEST_EPISODE` steps.
    """
    check_taken(env.observation_space, env.action_space)
    env.action_space.seed(seed)
    seen, _ = env.reset(seed=seed)
    for step in range(LONGEST_EPISODE):
        if step < _LOOKED_AT:
            refuse_outside(env.observation_space, seen, step)
        seen, _, terminated, truncated, _ = env.step(env.action_space.sample())
        if terminated or truncated:
            return refuse_outside(env.observation_space, seen, step + 1)
        if step + 1 == _TELLING:
            say(
                f"no episode has ended within {_TELLING:,} steps of random actions; looking on "
                f"until {LONGEST_EPISODE:,}"
            )
    raise endless()
