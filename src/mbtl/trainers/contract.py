"""The trainer contract: how a study gets a policy for a context and its returns elsewhere.

A user gives two functions (`FunctionTrainer`) or an environment factory and an algorithm
(`mbtl.trainers.SB3Trainer`). Contexts are mappings axis name -> value. Nothing here knows an RL
library.
"""

from __future__ import annotations

import hashlib
import inspect
import json
import operator
from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field
from difflib import get_close_matches
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal, Protocol, runtime_checkable

import numpy as np

from mbtl.arrays import Array
from mbtl.contexts import Context
from mbtl.episodes import checked_returns, completed
from mbtl.errors import InvalidInput, TrainingFailed, unknown_name
from mbtl.faults import FAULTS, located, reason_of
from mbtl.plain import floats, is_finite, short
from mbtl.score import SCORE
from mbtl.settings import described, described_code

__all__ = [  # beside what `mbtl.trainers` shows
    "check_asked",
    "check_settings",
    "checked_returns",
    "completed",
    "even_groups",
    "recipe_of",
    "refusal",
]


@dataclass(frozen=True)
class Progress:
    """One report from inside a training.

    Attributes:
        step: environment steps done, or episodes.
        total: as many are planned.
        metrics: latest scalars, e.g. {"episode_return": 231.0}.
        unit: what is counted, "steps" or "episodes".
    """

    step: int
    total: int
    metrics: Mapping[str, float] = field(default_factory=dict)
    unit: str = "steps"


OnProgress = Callable[[Progress], None]


Ability = Literal["sets", "start", "length", "state", "inherit", "resume"]
"""What a trainer may be able to do.

- "sets": train one policy on several contexts.
- "start": begin with the weights of a policy.
- "length": train for any length.
- "state": hand out the state of a training of a given length, and go on from it exactly.
- "inherit": begin on other contexts with that state, too: with all that the policy's training had
  learnt beside the policy. The seed tells: a training that goes on has that of its beginning.
- "resume": keep that state now and then in a whole training, too, so that another worker can go on.
"""

DEEDS: Mapping[Ability, str] = {
    "sets": "train one policy on several contexts",
    "start": "begin with the weights of a policy",
    "length": "train for a length that is chosen",
    "state": "go on from the state of a training",
    "inherit": "begin with the state of another training",
    "resume": "go on with a training that was interrupted",
}
"""Each of them in words."""


@dataclass(frozen=True)
class Trained:
    """Where a training has come to.

    Attributes:
        policy: with its latest weights; of a whole training those that the recipe says, which may
            be the best.
        steps: environment steps of the training so far, those in which it evaluated itself too,
            its parents' not; None: unknown.
    """

    policy: Any
    steps: int | None = None


class Trainer(Protocol):
    """Trains, evaluates, saves and loads policies of one CMDP.

    A length is a number of *units*: 1.0 is one whole training, as long as the recipe says. A class
    that derives from this one can do nothing beyond whole trainings on one context from scratch,
    unless it says so.
    """

    @property
    def policy_format(self) -> str:
        """How saved policies are read: "sb3", "mlp", or "custom" (needs this trainer's `load`)."""
        return "custom"

    @property
    def takes(self) -> frozenset[Ability]:
        """What it can do; it may say `why_not(ability) -> str`, a clause that ends in the fix."""
        return frozenset()

    @property
    def whole(self) -> int | None:
        """Environment steps, or episodes, of one unit; None: unknown."""
        return None

    @property
    def counts(self) -> Literal["steps", "episodes"]:
        """What `whole` counts."""
        return "steps"

    def train(
        self,
        contexts: Sequence[Context],
        seed: int,
        *,
        start: Any = None,
        length: float | None = None,
        done: float = 0.0,
        state: Path | None = None,
        on_progress: OnProgress | None = None,
    ) -> Trained:
        """Train one policy; the same seed and arguments give the same policy.

        Args:
            contexts: to train on; of several each episode may be in another one.
            seed: of the training.
            start: a policy of this trainer to begin with (its weights only); None: from scratch.
            length: units of the training in all when this returns, rounded up to what the algorithm
                learns from; schedules (learning rate, exploration) follow the whole training. None:
                a whole training.
            done: units that this training has had already, where it goes on with its own latest
                policy as `start`; 0 where the policy is another training's.
            state: file or folder of the training's state. Where it is there, the training goes on
                from it, and `start` and `done` do not matter. With "state" it is there when a
                training of a given `length` returns; with "resume" it is saved now and then.
            on_progress: told now and then.

        Raises:
            InvalidInput: it is asked for what it does not take.
        """
        ...

    def evaluate(self, policy: Any, contexts: Sequence[Context], seeds: Sequence[int]) -> Array:
        """Undiscounted returns without adaptation, (n_targets,) or (n_targets, n_episodes).

        There is one seed per context. The same seed means the same episodes for every policy, and
        in whatever company the context is evaluated.
        """
        ...

    def save(self, policy: Any, folder: Path) -> bool:
        """Write `policy` into the empty `folder`; False when this trainer cannot save.

        Such a trainer says so before it trains, too, by an attribute `saves` that is False.
        """
        ...

    def load(self, folder: Path) -> Any:
        """Read back what `save` wrote."""
        ...


def refusal(trainer: Trainer, ability: Ability) -> str | None:
    """Why a trainer cannot do something, as the clause of a message; None: it can."""
    if ability in trainer.takes:
        return None
    why = getattr(trainer, "why_not", "its `takes` does not name {!r}".format)(ability)
    return f"{type(trainer).__name__} cannot {DEEDS[ability]}: {why}"


def check_asked(
    trainer: Trainer, contexts: Sequence[Context], start: Any = None, length: float | None = None
) -> None:
    """Refuse to train as it is asked for.

    Raises:
        InvalidInput: there are no contexts, or not a list, the length is not above 0, or the
            trainer does not take this.
    """
    if isinstance(contexts, Mapping):
        raise InvalidInput(
            f"a training takes a list of contexts, got one by itself, {dict(contexts)}; write "
            "train([context], seed)"
        )
    if not contexts:
        raise InvalidInput("a training takes at least one context, got none")
    if length is not None and not (is_finite(length) and length > 0.0):
        raise InvalidInput(f"a training is longer than 0 units, got length={short(length)}")
    asked: dict[Ability, bool] = {
        "sets": len(contexts) > 1,
        "start": start is not None,
        "length": length is not None,
    }
    for ability, wanted in asked.items():
        if wanted and (why := refusal(trainer, ability)):
            raise InvalidInput(why)


@runtime_checkable
class RehearsingTrainer(Trainer, Protocol):
    """A trainer that can show, before anything is trained, that evaluation works."""

    def untrained(self, context: Context) -> Any:
        """A policy as `train` gives it, but not trained: in seconds, whatever its returns."""
        ...


@runtime_checkable
class CountingTrainer(Trainer, Protocol):
    """A trainer that knows how many steps the episodes of an evaluation had."""

    def evaluate_steps(
        self, policy: Any, contexts: Sequence[Context], seeds: Sequence[int]
    ) -> tuple[Array, Array]:
        """As `evaluate`, and the steps of each episode, both (n_targets, n_episodes)."""
        ...


@runtime_checkable
class ManyTrainer(Protocol):
    """A trainer that trains and evaluates many policies at once, e.g. in one compiled program."""

    @property
    def lanes(self) -> int:
        """Policies that are best trained together on this machine."""
        ...

    def train_many(
        self,
        contexts: Sequence[Context],
        seeds: Sequence[int],
        *,
        keep: Sequence[str] = ...,
        state: Path | None = None,
        on_progress: OnProgress | None = None,
    ) -> dict[str, list[Any]]:
        """One policy per (context, seed), for each name of `keep`: "best", "final".

        `state` is a file for the state of an interrupted training, to go on from; the caller
        removes it once the policies are safe.
        """
        ...

    def evaluate_many(
        self, policies: Sequence[Any], contexts: Sequence[Context], seeds: Sequence[int]
    ) -> Array:
        """(P, n_targets, n_episodes) returns; each context's episodes are the same for all."""
        ...


def even_groups(count: int, most: int) -> list[int]:
    """Sizes of groups that are trained together: as many in each, but fewer in the last one."""
    return [min(most, count - first) for first in range(0, count, most)]


@runtime_checkable
class MeasuringTrainer(Protocol):
    """A trainer that can tell more of an episode than its score, and play it without a policy."""

    def ways(self, contexts: Sequence[Context]) -> tuple[str, ...]:
        """How its system goes without any policy of ours.

        "random_actions"; "unguided", the system without a controller, where there is one; and the
        system's own controllers.
        """
        ...

    def measure(
        self, policy: Any, contexts: Sequence[Context], seeds: Sequence[int], names: Sequence[str]
    ) -> dict[str, Array]:
        """(n_targets, n_episodes) each: "score", as of `evaluate`, and what is told by these names.

        The policy may be one of `ways`, and a controller: a function of an observation that returns
        an action. A measure is NaN in an episode that does not tell it.
        """
        ...


def reference_rows(
    trainer: MeasuringTrainer, contexts: Sequence[Context], seeds: Sequence[int]
) -> dict[str, Array]:
    """(n_targets, n_episodes) returns without any policy, by way, in the episodes of `evaluate`."""
    ways = trainer.ways(contexts)
    return {way: trainer.measure(way, contexts, seeds, ())[SCORE] for way in ways}


@dataclass(frozen=True)
class FunctionTrainer(Trainer):
    """A trainer from plain functions, each of which is given what its signature takes.

        train(context, seed) -> policy                                 # specialists, whole
        train(contexts, seed, *, start=None, length=None) -> policy    # everything
        evaluate(policy, contexts, seeds) -> returns, or a mapping of them by name

    `contexts` is a list of one or more, `start` a copy of a policy to begin with, `length` how much
    more to train, in units of a whole training (None: a whole one), and `on_progress` is told a
    `Progress` now and then. They go by their names, which `**kwargs` does not have. Going on
    begins with the latest policy: what that does not hold, such as the state of an optimiser,
    begins anew.

    Every context has a seed of its own, the same for every policy: luck that all contexts share
    would not average out in V. Where `evaluate` names its third argument `seed` it is called once
    per context, `evaluate(policy, [context], seed)`; where it takes no seed it is given none.

    Attributes:
        train_fn: as above.
        evaluate_fn: policy, contexts, seeds -> returns, (n_targets,) or (n_targets, n_episodes).
        save_fn: policy, folder -> None; without it policies are kept in memory only.
        load_fn: folder -> policy.
        score: which name of a mapping is what an episode is worth.
    """

    train_fn: Callable[..., Any]
    evaluate_fn: Callable[..., Any]
    save_fn: Callable[[Any, Path], None] | None = None
    load_fn: Callable[[Path], Any] | None = None
    policy_format: str = "custom"
    score: str | None = None

    def __post_init__(self) -> None:
        for name, function in (("train", self.train_fn), ("evaluate", self.evaluate_fn)):
            if not callable(function):
                raise InvalidInput(f"{name} must be a function, got {short(function)}; give one")
        if (self.save_fn is None) != (self.load_fn is None):
            raise InvalidInput(
                "save and load come together, got only one of them; give both or neither"
            )
        luck, named = _with_luck(_luck_of(self.evaluate_fn), None)
        rule = "evaluate(policy, contexts, seeds)"
        _check_call("evaluate", self.evaluate_fn, (None, None, *luck), named, rule)
        rule, given = f"train(context, seed) or {_ANYTHING}", _parameters(self.train_fn)
        named = {name: None for name in given if name in _NAMED}
        _check_call("train", self.train_fn, (None, None), named, rule, offered=_NAMED)

    @property
    def saves(self) -> bool:
        """Whether policies can be saved."""
        return self.save_fn is not None

    @property
    def functions(self) -> dict[str, Any]:
        """Where a user's own code is (`code_of`)."""
        return {"train": self.train_fn, "evaluate": self.evaluate_fn}

    @property
    def takes(self) -> frozenset[Ability]:
        """By the names of what `train_fn` takes."""
        named = _parameters(self.train_fn)
        able: dict[Ability, bool] = {
            "sets": named[:1] == ["contexts"],
            "start": "start" in named,
            "length": "length" in named,
        }
        return frozenset(ability for ability, can in able.items() if can)

    def why_not(self, ability: Ability) -> str:
        """What the function would have to take."""
        if ability in ("state", "resume"):
            return "a function goes on from its latest policy; give a trainer with a state"
        given = f"({', '.join(_parameters(self.train_fn))})"
        return f"its function is train{given}; give {_ANYTHING}"

    def train(
        self,
        contexts: Sequence[Context],
        seed: int,
        *,
        start: Any = None,
        length: float | None = None,
        done: float = 0.0,
        state: Path | None = None,
        on_progress: OnProgress | None = None,
    ) -> Trained:
        """Call `train_fn` with what it takes, for what is missing of `length`.

        Raises:
            TrainingFailed: it gave nothing, or `start` cannot be copied.
        """
        check_asked(self, contexts, start, length)
        if length is not None and start is not None and length <= done:
            return Trained(start)
        values = (
            None if start is None else self._copied(start),
            None if length is None else length - done,
            on_progress,
        )
        given = dict(zip(_NAMED, values, strict=True))
        named = {name: given[name] for name in _parameters(self.train_fn) if name in given}
        on = list(contexts) if "sets" in self.takes else contexts[0]
        if (policy := self.train_fn(on, seed, **named)) is None:
            raise TrainingFailed("train gave None, where it must return a policy; does it return?")
        return Trained(policy)

    def _copied(self, policy: Any) -> Any:
        """What a function may go on training in its place: as it would be read back, if it can."""
        if self.save_fn is None:
            try:
                return deepcopy(policy)
            except FAULTS as error:
                raise TrainingFailed(
                    "a training begins with a copy of a policy, and this one cannot be copied "
                    f"({reason_of(error)}); give save and load functions"
                ) from error
        with TemporaryDirectory() as folder:
            self.save(policy, Path(folder))
            return self.load(Path(folder))

    def evaluate(self, policy: Any, contexts: Sequence[Context], seeds: Sequence[int]) -> Array:
        """Call `evaluate_fn` with what it takes.

        Raises:
            TrainingFailed: called context by context, it gave other numbers of episodes, or it
                gave a mapping without the score.
        """
        return self._told(policy, contexts, seeds)[SCORE]

    def ways(self, contexts: Sequence[Context]) -> tuple[str, ...]:
        """None: functions know policies alone."""
        return ()

    def measure(
        self, policy: Any, contexts: Sequence[Context], seeds: Sequence[int], names: Sequence[str]
    ) -> dict[str, Array]:
        """What `evaluate_fn` tells where it returns a mapping."""
        told, n = self._told(policy, contexts, seeds), len(contexts)
        score = checked_returns(told[SCORE], n)
        own = {name: np.reshape(told[name], (n, -1)) for name in names if name in told}
        return {SCORE: score, **own}

    def _told(
        self, policy: Any, contexts: Sequence[Context], seeds: Sequence[int]
    ) -> dict[str, Array]:
        """All that `evaluate_fn` returns, by name."""
        takes = _luck_of(self.evaluate_fn)

        def returns(some: Sequence[Context], luck: Any) -> dict[str, Any]:
            by_place, by_name = _with_luck(takes, luck)
            with located(some[0] if len(some) == 1 else None):
                return self._named(self.evaluate_fn(policy, some, *by_place, **by_name))

        if takes is None or takes.name != "seed":
            found = returns(contexts, seeds)
            checked_returns(found[SCORE], len(contexts), contexts, gaps=True)
            return {name: floats(rows) for name, rows in found.items()}
        each = [returns([c], seed) for c, seed in zip(contexts, seeds, strict=True)]
        for context, told in zip(contexts, each, strict=True):
            told[SCORE] = checked_returns(told[SCORE], 1, [context])
        if len(lengths := {told[SCORE].shape[1] for told in each}) > 1:
            raise TrainingFailed(
                "every context must have as many episodes as the others, got "
                f"{min(lengths)} to {max(lengths)}; return as many each time"
            )
        return {name: np.vstack([np.reshape(t[name], (1, -1)) for t in each]) for name in each[0]}

    def _named(self, found: Any) -> dict[str, Any]:
        if not isinstance(found, Mapping):
            return {SCORE: found}
        if self.score not in found:
            raise TrainingFailed(
                f"of what evaluate returns by name one is the score, got {self.score!r} of "
                f"{sorted(map(str, found))}; name it, score=mbtl.Score(...)"
            )
        return {**found, SCORE: found[self.score]}

    def save(self, policy: Any, folder: Path) -> bool:
        """Call `save_fn` if there is one."""
        if self.save_fn is None:
            return False
        self.save_fn(policy, folder)
        return True

    def load(self, folder: Path) -> Any:
        """Call `load_fn`."""
        if self.load_fn is None:
            raise TrainingFailed(
                "these policies were kept in memory only; give the problem save and load functions"
            )
        return self.load_fn(folder)


_ANYTHING = "train(contexts, seed, *, start=None, length=None)"
"""The function that can do all that a function can."""
_NAMED = ("start", "length", "on_progress")
"""What a training is given by name."""


def _signature(function: Callable[..., Any]) -> inspect.Signature | None:
    """None of what is written in C."""
    try:
        return inspect.signature(function)
    except (TypeError, ValueError):
        return None


def _check_call(
    what: str,
    function: Callable[..., Any],
    given: Sequence[Any],
    named: Mapping[str, Any],
    rule: str,
    *,
    offered: Sequence[str] = (),
) -> None:
    """Refuse a function that cannot be called so, or misspells a name that it is offered."""
    if (signature := _signature(function)) is None:
        return
    got = f"got {what}{signature}"
    try:
        signature.bind(*given, **named)
    except TypeError as error:
        raise InvalidInput(f"{what} must be a function {rule}, {got} ({error})") from None
    for one in signature.parameters.values():
        meant = get_close_matches(one.name, {*offered} - {*signature.parameters}, 1, 0.8)
        if meant and one.kind is one.KEYWORD_ONLY and one.default is None:
            raise InvalidInput(f"{what} must be a function {rule}, {got}; write {meant[0]!r}")


def _parameters(function: Callable[..., Any]) -> list[str]:
    """Names of what a function takes; none of what is written in C."""
    signature = _signature(function)
    return [] if signature is None else list(signature.parameters)


_SEEDS = inspect.Parameter("seeds", inspect.Parameter.POSITIONAL_ONLY)


def _luck_of(evaluate: Callable[..., Any]) -> inspect.Parameter | None:
    """The parameter of an evaluation that takes seeds, if any: by its name, or the third one.

    Not a third one with a default of its own, such as `episodes=10`.
    """
    if (signature := _signature(evaluate)) is None:
        return _SEEDS
    known = list(signature.parameters.values())
    named = [p for p in known if p.name in ("seed", "seeds")]
    third = [p for p in known[2:3] if p.default is p.empty and p.kind is not p.VAR_KEYWORD]
    takes = next(iter(named + third), None)
    if takes is None or takes.kind is takes.VAR_POSITIONAL:
        return _SEEDS if any(p.kind is p.VAR_POSITIONAL for p in known) else None
    return takes


def _with_luck(takes: inspect.Parameter | None, luck: Any) -> tuple[list[Any], dict[str, Any]]:
    """What an evaluation is given of it, by place and by name: see `_luck_of`."""
    if takes is None:
        return [], {}
    by_place = takes.kind is takes.POSITIONAL_ONLY
    return ([luck], {}) if by_place else ([], {takes.name: luck})


def checked_targets(targets: Sequence[int] | None, n: int) -> list[int]:
    """Indices of the contexts that returns are of; all `n` for None.

    Raises:
        InvalidInput: none, a repeated one, or one that is not in 0..n-1.
    """
    if targets is None:
        return list(range(n))
    try:
        indices = [operator.index(target) for target in targets]
    except TypeError:  # no whole numbers
        indices = []
    distinct = len(set(indices)) == len(indices) > 0
    if not distinct or min(indices) < 0 or max(indices) >= n:
        raise InvalidInput(
            f"targets are one or more distinct context indices from 0 to {n - 1}, got {targets}"
        )
    return indices


def check_settings(trainer: Any, counts: Sequence[str], optional: Sequence[str]) -> None:
    """Refuse settings of a trainer of ours that mean nothing.

    Args:
        trainer: with `timesteps`, `episodes`, `checkpoint` and `acting`.
        counts: names of whole numbers >= 1.
        optional: of those that may also be None.

    Raises:
        InvalidInput: a number is not positive, not exactly one of `timesteps` and `episodes` is
            given, or `checkpoint` is neither "final" nor "best".
        UnknownName: no such way to act.
    """
    if (trainer.timesteps is None) == (trainer.episodes is None):
        raise InvalidInput(
            "a training lasts a number of timesteps or of episodes, got "
            f"timesteps={trainer.timesteps} and episodes={trainer.episodes}; give one of them"
        )
    for name in (*counts, *optional):
        number = getattr(trainer, name)
        if number is None and name in optional:
            continue
        if not (isinstance(number, int) and number >= 1):
            raise InvalidInput(f"{name} must be a whole number >= 1, got {number!r}")
    if trainer.checkpoint not in ("final", "best"):
        raise InvalidInput(f"checkpoint must be 'final' or 'best', got {trainer.checkpoint!r}")
    if trainer.acting not in ("sampled", "mean"):
        raise unknown_name("way to act", str(trainer.acting), ("sampled", "mean"))


def recipe_of(trainer: Trainer) -> dict[str, Any]:
    """What decides the policies of a trainer, by value: two studies of one recipe may be compared.

    A trainer with a `recipe` attribute says it itself; of others only the type is known.
    """
    recipe = getattr(trainer, "recipe", None) or {"trainer": type(trainer).__name__}
    found: dict[str, Any] = described(recipe)
    return found


def recipe_digest(equipment: Mapping[str, Any]) -> str:
    """Sixteen letters and digits that tell recipes apart."""
    text = json.dumps(equipment, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def equipment_of(trainer: Trainer) -> dict[str, Any]:
    """Recipe and policy format, as they read back from a log."""
    return {"recipe": recipe_of(trainer), "policy_format": trainer.policy_format}


def code_of(trainer: Trainer) -> dict[str, Any]:
    """The user's own code by what it does ("train", "make_env", ...), as it reads back from a log.

    A trainer with an attribute `functions` names it; of others it is their class.
    """
    named: Mapping[str, Any] = getattr(trainer, "functions", {"trainer": type(trainer)})
    return {name: code for name, one in named.items() if (code := described_code(one)) is not None}
