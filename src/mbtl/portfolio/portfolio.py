"""Portfolio: trained policies and a router, so that each context gets the policy that serves it.

Notation (shapes): k policies, N listed contexts.
    sources  (k,)     context index each policy was trained on
    returns  (k, N)   mean undiscounted return of each policy on each context, raw units; NaN where
                      a policy was not evaluated
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from mbtl.arrays import Array
from mbtl.contexts import ContextSpace, Value
from mbtl.errors import InvalidInput, StorageError
from mbtl.objective import Bounds, generalisation_performance, nearest_filled, value
from mbtl.portfolio import router
from mbtl.portfolio.archive import SavedPolicy, load_policy, read_portfolio, write_portfolio
from mbtl.portfolio.choice import Choice, explanation
from mbtl.portfolio.mlp import MLPPolicy
from mbtl.portfolio.router import Indices
from mbtl.untrusted import MALFORMED


@dataclass(frozen=True, eq=False, repr=False)
class Portfolio:
    """Policies trained on some contexts of a space, and their measured returns on all of them.

    Attributes:
        space: the listed contexts.
        sources: context index each policy was trained on; a source may occur twice.
        returns: (k, N) raw mean returns; NaN where a policy was not evaluated.
        bounds: normalisation of returns, with the direction that is better.
        theta: slope of the linear gap, performance per grid step; used where nothing was measured.
        policy_folders: per policy the folder a trainer saved it in; None if it was not saved.
        policy_format: "mlp", "sb3" or "custom", see `mbtl.trainer.Trainer.policy_format`.
        load: folder -> policy; needed for the format "custom", replaces our own loaders otherwise.
        in_memory: position -> policy, for policies that are at hand and need no loading.
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
    theta: float
    policy_folders: Sequence[Path | None] = ()
    policy_format: str = "custom"
    load: Callable[[Path], Any] | None = None
    in_memory: Mapping[int, Any] = field(default_factory=dict)
    cmdp: str | None = None
    metadata: Mapping[str, Any] = field(default_factory=dict)
    trust: bool = False
    _loaded: dict[int, Any] = field(default_factory=dict, init=False, repr=False)

    def __post_init__(self) -> None:
        returns = np.array(self.returns, dtype=np.float64)
        returns.setflags(write=False)
        sources = tuple(int(source) for source in self.sources)
        folders = tuple(self.policy_folders) or (None,) * len(sources)
        object.__setattr__(self, "returns", returns)
        object.__setattr__(self, "sources", sources)
        object.__setattr__(self, "policy_folders", folders)
        self._loaded.update(self.in_memory)
        k, n = len(sources), self.space.n
        if k == 0 or returns.shape != (k, n):
            raise InvalidInput(
                "a portfolio needs one or more policies and returns of shape (policies, contexts), "
                f"got {k} sources for {n} contexts and returns of shape {returns.shape}"
            )
        if not all(0 <= source < n for source in sources):
            raise InvalidInput(f"sources must be context indices 0..{n - 1}, got {sources}")
        if len(folders) != k:
            raise InvalidInput(
                f"policy_folders needs one folder or None per policy, got {len(folders)} for {k}"
            )
        if np.isinf(returns).any():
            raise InvalidInput(
                "returns must be finite, or NaN where not evaluated; got an infinite one"
            )
        if not (np.isfinite(self.theta) and self.theta >= 0):
            raise InvalidInput(f"theta must be finite and >= 0, got {self.theta!r}")

    def __len__(self) -> int:
        return len(self.sources)

    @cached_property
    def performance(self) -> Array:
        """(k, N) normalised returns."""
        return self.bounds.normalise(self.returns)

    @property
    def value(self) -> float:
        """V of the returns held here: weighted mean over contexts of the best performance.

        A policy counts as on the nearest context where it was evaluated.
        """
        rows = nearest_filled(self.performance, self.space.steps)
        return value(generalisation_performance(rows), self.space.weights)

    @cached_property
    def _judged(self) -> Array:
        """(k, N) performance that routing compares; one entry alone is left to the gap model."""
        return nearest_filled(self.performance, self.space.steps, least=2)

    def first(self, k: int) -> Portfolio:
        """The portfolio as it was after `k` trainings, without the policies themselves."""
        return Portfolio(self.space, self.sources[:k], self.returns[:k], self.bounds, self.theta)

    # ---- routing -----------------------------------------------------------------------------

    @cached_property
    def assignment(self) -> Indices:
        """(N,) position of the policy that serves each listed context: the policy map."""
        chosen = router.assign(self.space, self.sources, self._judged)
        for target in np.flatnonzero(chosen < 0):
            chosen[target] = self.explain(self.space.context(int(target))).policy
        chosen.setflags(write=False)
        return chosen

    @property
    def sources_used(self) -> tuple[int, ...]:
        """Sources whose policy serves at least one listed context, in training order."""
        return tuple(dict.fromkeys(self.sources[int(i)] for i in np.unique(self.assignment)))

    def explain(self, context: Mapping[str, Value]) -> Choice:
        """The policy for a context, with the reason; rules in `mbtl.portfolio.router`.

        Raises:
            ContextMismatch: the context lies outside the axes.
            InvalidInput: no policy has a measured or predicted return there.
        """
        seen = router.forecast(self.space, self.sources, self._judged, self.theta, context)
        ranking = seen.ranking(self.sources)
        if not ranking:
            raise InvalidInput(
                f"routing needs a policy that was evaluated on its source or near the context, got "
                f"none for {dict(context)!r}; evaluate the policies first"
            )
        best, runner_up = ranking[0], ranking[1] if len(ranking) > 1 else None
        source, basis = self.sources[best], seen.basis[best]
        returns = self.bounds.denormalise(seen.performance)
        if basis == "observed":
            measured = self.returns[:, seen.target]  # the number itself, free of rounding
            returns = np.where(np.isfinite(measured), measured, returns)
            basis = basis if np.isfinite(measured[best]) else "interpolated"
        predicted = float(returns[best])
        margin = None if runner_up is None else abs(predicted - float(returns[runner_up]))
        steps = float(seen.distance[best])
        sentence = explanation(self.space, best, source, predicted, basis, steps, runner_up, margin)
        return Choice(
            best, source, self.space.context(source), predicted, basis, runner_up, margin, sentence
        )

    def policy_for(self, context: Mapping[str, Value]) -> Any:
        """The policy that serves a context; `explain` gives the reason."""
        return self.policy(self.explain(context).policy)

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
                source = self.space.describe(self.space.context(self.sources[i]))
                raise StorageError(
                    f"policy {i} (trained on {source}) was not saved and is no longer in memory; "
                    "give the problem save and load functions and train it again"
                )
            self._loaded[i] = load_policy(
                Path(folder), self.policy_format, self.load, trust=self.trust
            )
        return self._loaded[i]

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
                "never saved; give the problem save and load functions, or pass "
                "allow_missing=True to keep only their returns and routes"
            )
        bounds = self.bounds
        record = {
            "cmdp": self.cmdp,
            "space": self.space.to_json(),
            "bounds": {"low": bounds.low, "high": bounds.high, "direction": bounds.direction},
            "theta": self.theta,
            "sources": list(self.sources),
            "policy_format": self.policy_format,
            "metadata": dict(self.metadata),
        }
        return write_portfolio(
            Path(folder), record, self.returns, self._saved_policies(), overwrite=overwrite
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
        return f"Portfolio({len(self)} policies for {self.space!r}, V = {self.value:.4f})"

    def _saved_policies(self) -> list[SavedPolicy]:
        names: list[str] = []
        for source in self.sources:
            same = sum(source == other for other in self.sources[: len(names)])
            names.append(f"source-{source:04d}" + (f"-{same + 1}" if same else ""))
        return [
            (name, None if folder is None else Path(folder), self.in_memory.get(i))
            for i, (name, folder) in enumerate(zip(names, self.policy_folders, strict=True))
        ]


def load_portfolio(
    folder: Path | str, load: Callable[[Path], Any] | None = None, *, trust: bool = False
) -> Portfolio:
    """Open a saved portfolio: all files are checked by hash, policies are read on first use.

    Policies that carry a numpy copy (small networks) are read from that: it needs no training
    library and executes nothing. Other Stable-Baselines3 policies are read from their own zip,
    which can execute code, and only with `trust` (docs/portfolio-format.md).

    Args:
        folder: what `Portfolio.save` wrote.
        load: folder -> policy; given, it reads every policy, e.g. `mbtl.training.load_sb3`.
        trust: also read files that can execute code; set it if you trust whoever made the folder.

    Raises:
        StorageError: not a portfolio, a file is missing, changed or not listed, a path or link
            leads out of the folder, or the format is newer.
    """
    record, returns, folders = read_portfolio(Path(folder))
    try:
        return Portfolio(
            space=ContextSpace.from_json(record["space"]),
            sources=tuple(record["sources"]),
            returns=returns,
            bounds=Bounds(**record["bounds"]),
            theta=record["theta"],
            policy_folders=folders,
            policy_format=record["policy_format"],
            load=load,
            cmdp=record["cmdp"],
            metadata=dict(record["metadata"]),
            trust=trust,
        )
    except MALFORMED as error:
        raise StorageError(
            f"the parts of a portfolio must fit each other, got {error!r} in {folder}; "
            "save it again"
        ) from error
