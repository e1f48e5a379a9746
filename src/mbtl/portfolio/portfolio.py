"""Portfolio: trained policies and a router, so that each context gets the policy that serves it.

Notation (shapes): k policies, N listed contexts.
    sources     (k,)     context index each policy was trained on
    returns     (k, N)   mean undiscounted return of each policy on each context, raw units; NaN
                         where a policy was not evaluated
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np

from mbtl.arrays import Array, Indices
from mbtl.contexts import Context, ContextSpace, Value
from mbtl.episodes import Episodes, checked_returns, completed
from mbtl.errors import InvalidInput, StorageError, TrainingFailed, check_known
from mbtl.files import MALFORMED
from mbtl.objective import Bounds
from mbtl.plain import LARGEST, floats, short
from mbtl.portfolio.adaptive import Adaptive, deviations
from mbtl.portfolio.archive import SavedPolicy, load_policy, read_portfolio, write_portfolio
from mbtl.portfolio.mlp import MLPPolicy
from mbtl.portfolio.router import Choice, Forecast, forecast
from mbtl.portfolio.served import Served
from mbtl.portfolio.signs import Features, Signs, played, stacked
from mbtl.routing import Routing, rank
from mbtl.seeds import Purpose, episode_seeds, evaluation_seeds

_OFF = 0.1
"""Share of the bounds' width by which rewards may miss returns, beyond their scatter."""


@dataclass(frozen=True, eq=False, repr=False)
class Portfolio:
    """Policies trained on some contexts of a space, and their measured returns on all of them.

    Attributes:
        space: the listed contexts.
        sources: context index each policy was trained on; a source may occur twice.
        returns: (k, N) raw mean returns; NaN where a policy was not evaluated.
        bounds: normalisation of returns, with the direction that is better.
        episodes: k arrays (N, E_i), the returns of single episodes, of which `returns` are the
            means; none: returns count as exact.
        risk: share of the contexts, the worst of them, that V is the mean of.
        policy_folders: per policy the folder a trainer saved it in; None if it was not saved.
        policy_format: "mlp", "sb3" or "custom", see `mbtl.trainers.Trainer.policy_format`.
        load: folder -> policy; needed for the format "custom", replaces our own loaders otherwise.
        in_memory: position -> policy, for policies that are at hand and need no loading.
        sets: position -> contexts, of policies trained on several; `sources` has their middle one.
        cmdp: id of the CMDP, if there is one.
        metadata: anything JSON-able to keep with the portfolio.
        trust: read policies also from files that can execute code (docs/portfolio-format.md).

    Raises:
        InvalidInput: sources, returns and folders do not fit each other.
    """

    space: ContextSpace
    sources: tuple[int, ...]
    returns: Array
    bounds: Bounds
    episodes: Sequence[Array] = ()
    risk: float = 1.0
    policy_folders: Sequence[Path | None] = ()
    policy_format: str = "custom"
    load: Callable[[Path], Any] | None = None
    in_memory: Mapping[int, Any] = field(default_factory=dict)
    sets: Mapping[int, tuple[int, ...]] = field(default_factory=dict)
    cmdp: str | None = None
    metadata: Mapping[str, Any] = field(default_factory=dict)
    trust: bool = False
    _loaded: dict[int, Any] = field(default_factory=dict, init=False, repr=False)

    def __post_init__(self) -> None:
        returns = floats(self.returns).copy()
        returns.setflags(write=False)
        sources = tuple(int(source) for source in self.sources)
        folders = tuple(self.policy_folders) or (None,) * len(sources)
        episodes = tuple(np.asarray(each, dtype=np.float64) for each in self.episodes)
        sets = {int(i): tuple(int(c) for c in on) for i, on in self.sets.items()}
        own = {"returns": returns, "sources": sources, "episodes": episodes, "sets": sets}
        for name, value in {**own, "policy_folders": folders}.items():
            object.__setattr__(self, name, value)
        self._loaded.update(self.in_memory)
        k, n, shapes = len(sources), self.space.n, [each.shape for each in episodes]
        fit = (
            returns.shape == (k, n)
            and k == len(folders) > 0
            and all(0 <= context < n for some in (sources, *sets.values()) for context in some)
            and all(0 <= policy < k and some for policy, some in sets.items())
            and len(shapes) in (0, k)
            and all(len(shape) == 2 and shape[0] == n and shape[1] > 0 for shape in shapes)
        )
        if not fit:
            raise InvalidInput(
                f"each of one or more policies of a portfolio has a source among {n} contexts, "
                f"returns on all of them and perhaps a set, a folder and episodes, got sources "
                f"{sources}, returns of shape {returns.shape}, sets {sets}, {len(folders)} folders "
                f"and episodes of shapes {shapes}"
            )
        if (np.abs(returns) > LARGEST).any():
            raise InvalidInput(
                f"returns must be within {LARGEST:g}, or NaN where not evaluated; got one of "
                f"{float(np.nanmax(np.abs(returns)))!r}"
            )
        if not np.isfinite(returns).any():
            raise InvalidInput(
                "routing needs a return of at least one policy, got none that is known"
            )
        if not (isinstance(self.risk, (int, float)) and 0.0 < self.risk <= 1.0):
            raise InvalidInput(
                f"risk is the share of the worst contexts, in (0, 1], got {self.risk!r}"
            )

    def __len__(self) -> int:
        return len(self.sources)

    @cached_property
    def performance(self) -> Array:
        """(k, N) normalised returns."""
        return self.bounds.normalise(self.returns)

    @property
    def value(self) -> float:
        """V as the policies are routed, estimated from the returns held here; see `routing`."""
        return self.routing.value.value

    # ---- routing -----------------------------------------------------------------------------

    @cached_property
    def routing(self) -> Routing:
        """Who serves which listed context, what that is worth, and how sure."""
        played = Episodes(self.episodes, self.bounds) if self.episodes else None
        return Routing(self.space, self.sources, self.performance, played, risk=self.risk)

    def explain(
        self, context: Mapping[str, Value], *, outside: Literal["error", "nearest"] = "error"
    ) -> Choice:
        """The policy for a context, with the reason; rules in `mbtl.portfolio.router`.

        Args:
            context: on the list or between.
            outside: what to do with numbers beyond the range of their axis: refuse them, or judge
                by the nearest context inside and say so (`Choice.instead`).

        Raises:
            ContextMismatch: the context lies outside the axes.
        """
        inside = self._inside(context, outside)
        seen, ranking = self._ranked(inside)
        best, runner_up = int(ranking[0]), int(ranking[1]) if len(ranking) > 1 else None
        returns = self.bounds.denormalise(seen.performance)
        if seen.target is not None:  # the number itself where it is believed, free of rounding
            as_measured = seen.performance == self.performance[:, seen.target]
            returns = np.where(as_measured, self.returns[:, seen.target], returns)
        predicted, source = float(returns[best]), self.sources[best]
        behind = None if runner_up is None else abs(predicted - float(returns[runner_up]))
        return Choice(
            policy=best,
            source=source,
            source_context=self.space.context(source),
            trained_on=self.trained_on(best),
            predicted_return=predicted,
            error=self._error(seen, best),
            basis=seen.basis[best],
            runner_up=runner_up,
            margin=behind,
            margin_error=None if runner_up is None else self._error(seen, best, runner_up),
            instead=None if inside == context else dict(inside),
        )

    def _inside(self, context: Mapping[str, Value], outside: str) -> Mapping[str, Value]:
        """The context, or the nearest one inside."""
        check_known("way to treat a context outside", outside, ("error", "nearest"))
        return self.space.nearest(context) if outside == "nearest" else context

    def _ranked(self, context: Mapping[str, Value]) -> tuple[Forecast, Indices]:
        """What the policies should achieve on a context, and their places, the best first."""
        seen = forecast(self.space, self.sources, self.routing.beliefs, context)
        sources = np.asarray(self.sources, dtype=np.intp)
        return seen, rank(seen.performance, seen.distance, sources)

    def trained_on(self, policy: int) -> str:
        """What a policy was trained on, in words: a context, or "all contexts"."""
        return self.space.describe_set(self.sets.get(policy, (self.sources[policy],)))

    def _error(self, seen: Forecast, policy: int, less: int | None = None) -> float | None:
        """Error of a policy's number, or of its lead over another; raw units, None: unknown.

        Luck that policies share is in a return and cancels in a difference between two.
        """
        routing, here = self.routing, seen.judged_on
        both = [policy] if less is None else [policy, less]
        if not routing.noise_is_known and routing.beliefs.measured[both][:, here].any():
            return None
        row = np.full(len(here), policy)
        error = routing.tails * routing.error(row, here, seen.weights, less)
        if seen.target is None:
            error = float(np.hypot(error, np.sqrt(seen.between(policy, less))))
        if error == 0.0 and seen.target is None:
            return None  # between the listed contexts nothing is exact
        return error * (self.bounds.high - self.bounds.low)

    def policy_for(
        self, context: Mapping[str, Value], *, outside: Literal["error", "nearest"] = "error"
    ) -> Any:
        """The policy that serves a context; `explain` gives the reason."""
        _, ranking = self._ranked(self._inside(context, outside))
        return self.policy(int(ranking[0]))

    def policy(self, i: int) -> Any:
        """The policy at position `i`, loaded from its folder on first use.

        Raises:
            InvalidInput: no such position, or the format needs `load` or `trust`.
            StorageError: the policy was not saved or cannot be read.
            MissingExtra: reading it needs a library that is not installed.
        """
        if not 0 <= i < len(self):
            raise InvalidInput(f"policies are numbered 0 to {len(self) - 1}, got {i}")
        if i not in self._loaded:
            folder = self.policy_folders[i]
            if folder is None:
                raise StorageError(
                    f"policy {i + 1} (trained on {self.trained_on(i)}) was not saved and is not in "
                    "memory; hand it to study.tell(..., policy_object=policy), or policy=folder to "
                    "keep it; or give the problem save and load functions and train it again"
                )
            self._loaded[i] = load_policy(
                Path(folder), self.policy_format, self.load, trust=self.trust
            )
        return self._loaded[i]

    def adaptive(
        self, *, episodes: int = 10, forget: float = 0.0, signs: Signs | None = None
    ) -> Adaptive:
        """Serve a context that is not told, from the returns of the episodes there.

        Args:
            episodes: how many are expected; the more, the more is tried out, without `signs`.
            forget: chance per episode that the context has changed.
            signs: what `signs` recorded, to change the policy within episodes, too.
        """
        mean, width = self.routing.believed, self.bounds.high - self.bounds.low
        own = deviations(self.episodes, mean.shape, width)
        return Adaptive(self.space, self.bounds, mean, own, self.policy, episodes, forget, signs)

    def signs(
        self,
        make_env: Callable[[Context], Any],
        *,
        every: int = 10,
        episodes: int = 5,
        features: Features | None = None,
        seed: int = 0,
    ) -> Signs:
        """Record what each policy shows, part by part, in each listed context: see `adaptive`.

        Plays k x N x `episodes` whole episodes in this process, with policies that `predict`.

        Args:
            make_env: context -> Gymnasium environment, whose rewards add up to the return.
            every: steps of a part.
            episodes: of each policy in each context.
            features: numbers of a part, such as speeds, from its observations (every, ...), each
                before its action, and its actions (every, ...). They show the context sooner than
                rewards do.
            seed: of the episodes, which are the same for every policy.

        Raises:
            InvalidInput: fewer than one step or two episodes, features that are not finite or not
                always as many, or rewards that do not add up to the returns.
        """
        if every < 1 or episodes < 2:
            raise InvalidInput(
                "a part has 1 step or more, and their scatter needs 2 episodes or more, got "
                f"every={every} and episodes={episodes}"
            )
        found = list[list[Array]]()
        seeds = episode_seeds(seed, self.space.n, episodes)
        for context, some in zip(self.space.contexts, seeds, strict=True):
            with closing(make_env(dict(context))) as env:
                for i in range(len(self)):
                    found += [played(env, self.policy(i), one, every, features) for one in some]
        each = stacked(found)
        each = each.reshape(self.space.n, len(self), episodes, *each.shape[1:]).swapaxes(0, 1)
        mean = np.ma.masked_invalid(each).mean(axis=2).filled(np.nan)
        deviation = np.empty_like(mean)
        for p, j in np.ndindex(mean.shape[2:]):
            deviation[..., p, j] = deviations(list(each[..., p, j]), mean.shape[:2], 1.0)
        signs = Signs(every, mean, deviation, features)
        self._check_adds_up(signs.to_go[:, :, 0], np.sqrt((deviation[..., 0] ** 2).sum(axis=2)))
        return signs

    def _check_adds_up(self, earned: Array, deviation: Array) -> None:
        """Whoever is judged by something else than rewards cannot be chosen by them."""
        off = np.abs(earned - self.returns) - deviation
        if np.nanmedian(off) > _OFF * (self.bounds.high - self.bounds.low):
            raise InvalidInput(
                "signs need rewards that add up to the return, and these add up to "
                f"{np.nanmean(earned):.4g} where returns are {np.nanmean(self.returns):.4g} in the "
                "mean; give an environment that is rewarded by the score"
            )

    def evaluate(
        self,
        problem: Any,
        *,
        contexts: Sequence[Mapping[str, Value]] | None = None,
        between: int = 200,
        seed: int = 0,
    ) -> Served:
        """Play what serves some contexts, such as those that no training has seen.

        Args:
            problem: the CMDP, or a trainer, which evaluates.
            contexts: to serve, within the axes; None: drawn from them.
            between: how many are drawn.
            seed: of the draw and of the episodes.

        Raises:
            ContextMismatch: a context lies outside the axes.
            InvalidInput: there is no context.
            TrainingFailed: no episode of any counts.
        """
        if isinstance(contexts, Mapping):
            raise InvalidInput(f"contexts are a list, got one, {short(contexts)}; write [context]")
        drawn = contexts is None
        some = self.space.between(between, seed) if contexts is None else list(map(dict, contexts))
        if not some:
            raise InvalidInput("a portfolio is evaluated on one context or more, got none")
        trainer = problem.facts().trainer if hasattr(problem, "facts") else problem
        choices = [self.explain(context) for context in some]
        seeds = evaluation_seeds(seed, 0, range(len(some)), Purpose.REPORT)
        rows: dict[int, Array] = {}
        for policy in sorted({choice.policy for choice in choices}):
            mine = [i for i, choice in enumerate(choices) if choice.policy == policy]
            here = [some[i] for i in mine]
            played = trainer.evaluate(self.policy(policy), here, [seeds[i] for i in mine])
            told = checked_returns(played, len(mine), here, gaps=True)
            rows |= dict(zip(mine, told, strict=True))
        returns = completed(np.array([rows[i] for i in range(len(some))]), gaps=True)
        there = np.flatnonzero(np.isfinite(returns).all(axis=1)).tolist()
        if not there:
            raise TrainingFailed(f"no episode counts, got NaN in all of {len(some)} contexts")
        return Served(
            self.space,
            tuple(some[i] for i in there),
            tuple(choices[i] for i in there),
            returns[there],
            self.bounds,
            drawn,
            len(some) - len(there),
        )

    # ---- keeping -----------------------------------------------------------------------------

    def save(
        self, folder: Path | str, *, overwrite: bool = False, allow_missing: bool = False
    ) -> Path:
        """Write everything, policies included, into a folder that appears whole or not at all.

        Args:
            folder: does not exist, or is empty, or holds a portfolio and `overwrite` is set.
            overwrite: replace the portfolio that is there.
            allow_missing: keep returns and routes even of policies that cannot be saved.

        Raises:
            InvalidInput: something else is in the way.
            StorageError: a policy is in memory only, because its trainer cannot save it.
            StorageError: the place cannot be written, or a policy folder is gone.
        """
        missing = self.policies_missing
        if missing and not allow_missing:
            raise StorageError(
                f"a saved portfolio holds its policies, but {len(missing)} of {len(self)} were "
                "never saved; give the problem save and load functions, tell the study with "
                "policy=folder, or pass allow_missing=True to keep only their returns and routes"
            )
        bounds = self.bounds
        record = {
            "cmdp": self.cmdp,
            "space": self.space.to_json(),
            "bounds": {k: v for k, v in asdict(bounds).items() if v is not None},
            "sources": list(self.sources),
            "risk": self.risk,
            "policy_format": self.policy_format,
            **({"sets": {str(i): list(on) for i, on in self.sets.items()}} if self.sets else {}),
            "metadata": dict(self.metadata),
        }
        arrays = {"returns": self.returns}
        if self.routing.noise_is_known:
            most = max(each.shape[1] for each in self.episodes)
            arrays["episodes"] = np.full((len(self), self.space.n, most), np.nan)
            for kept, each in zip(arrays["episodes"], self.episodes, strict=True):
                kept[:, : each.shape[1]] = each
        return write_portfolio(
            Path(folder), record, arrays, self._saved_policies(), overwrite=overwrite
        )

    @property
    def policies_missing(self) -> tuple[int, ...]:
        """Positions of the policies that `save` could not write."""
        return tuple(
            i
            for i, (_, folder, policy) in enumerate(self._saved_policies())
            if folder is None and not isinstance(policy, MLPPolicy)
        )

    def __repr__(self) -> str:
        v = f"V = {self.value:.4f}, estimated"
        return f"Portfolio({len(self)} policies for {self.space!r}, {v})"

    def _saved_policies(self) -> list[SavedPolicy]:
        found: list[SavedPolicy] = []
        for i, (source, folder) in enumerate(zip(self.sources, self.policy_folders, strict=True)):
            same = self.sources[:i].count(source)
            name = f"source-{source:04d}" + (f"-{same + 1}" if same else "")
            found.append((name, None if folder is None else Path(folder), self.in_memory.get(i)))
        return found


def _played(each: Array) -> Array:
    """(N, E_i) without the episodes that other policies had more."""
    played = np.isfinite(each).any(axis=0)
    return each[:, played] if played.any() else each[:, :1]


def load_portfolio(
    folder: Path | str, load: Callable[[Path], Any] | None = None, *, trust: bool = False
) -> Portfolio:
    """Open a saved portfolio: all files are checked by hash, policies are read on first use.

    Policies that carry a numpy copy (small networks) are read from that: it needs no training
    library and executes nothing. Other Stable-Baselines3 policies are read from their own zip,
    which can execute code, and only with `trust` (docs/portfolio-format.md).

    Args:
        folder: what `Portfolio.save` wrote.
        load: folder -> policy; given, it reads every policy, e.g. `mbtl.trainers.load_sb3`.
        trust: also read files that can execute code; set it if you trust whoever made the folder.

    Raises:
        StorageError: not a portfolio, a file is missing, changed or not listed, a path or link
            leads out of the folder, or the format is newer.
    """
    record, arrays, folders = read_portfolio(Path(folder))
    try:
        return Portfolio(
            space=ContextSpace.from_json(record["space"]),
            sources=tuple(record["sources"]),
            returns=arrays["returns"],
            bounds=Bounds(**record["bounds"]),
            episodes=[_played(each) for each in arrays.get("episodes", ())],
            risk=record.get("risk", 1.0),
            policy_folders=folders,
            policy_format=record["policy_format"],
            load=load,
            sets={int(i): tuple(on) for i, on in record.get("sets", {}).items()},
            cmdp=record["cmdp"],
            metadata=dict(record["metadata"]),
            trust=trust,
        )
    except MALFORMED as error:
        raise StorageError(
            f"the parts of a portfolio must fit each other, got {error!r} in {folder}; "
            "save it again"
        ) from error
