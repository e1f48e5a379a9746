"""Building transfer data: trainings of every kind, and what they return on every context.

CMDPs of one world and recipe, and all seeds, are trained in one program where lanes are many, which
is what an accelerator is fast at; on a CPU a few are. Work is done in parts, each a file that
appears whole or not at all: trainings first, which keep their policies, then evaluations. So an
interrupted build goes on where it was.

Notation (shapes): P trainings of a part, N contexts, M sources, E episodes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbtl.contexts import Context
from mbtl.engine import lazy as engine
from mbtl.engine.world_trainer import WorldTrainer
from mbtl.errors import InvalidInput, check_known
from mbtl.files import claimed_folder, whole_file
from mbtl.portfolio import MLPPolicy
from mbtl.seeds import MATRIX_TRIAL, PER_TARGET, episode_seeds, evaluation_seeds, training_seed
from mbtl.trainers.contract import OnProgress, Progress, even_groups, recipe_of, reference_rows
from mbtl.zoo.benchmark.build import distinct
from mbtl.zoo.benchmark.matrix import REFERENCE, TransferMatrix
from mbtl.zoo.benchmark.npz import read_npz, read_text, text_array, write_npz
from mbtl.zoo.benchmark.provenance import here
from mbtl.zoo.benchmark.shipped import load_matrix, shipped_matrices
from mbtl.zoo.benchmark.transfers import KINDS, save_transfers, summary

GENERALIST_UNITS = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 15.0)
"""Marks of the policy for all contexts."""
TUNED_UNITS = (0.5, 1.0)
"""Marks of its copies."""
PARENTS = (1.0, 4.0)
"""Units of the policies for all that copies are tuned from."""


@dataclass(frozen=True)
class OfOneWorld:
    """contexts of several CMDPs of one world -> world and parameters; they tell by their axes."""

    problems: tuple[tuple[frozenset[str], Any], ...]

    @property
    def lanes(self) -> int | None:
        """As the first one says."""
        own = getattr(self.problems[0][1], "lanes", None)
        return None if own is None else int(own)

    def __call__(self, contexts: Sequence[Context]) -> tuple[Any, Any]:
        """The world, and the parameters of `contexts` with one leading axis."""
        by_axes, world, parts = dict(self.problems), None, []
        for axes, some in groupby(contexts, frozenset):
            world, params = by_axes[axes](list(some))
            parts.append(params)
        if len(parts) == 1:
            return world, parts[0]
        return world, engine.joined(parts)


class Lane(NamedTuple):
    """One training: of which CMDP of the build, which seed, and on which context (None: all)."""

    cmdp: int
    seed: int
    source: int | None = None


@dataclass(frozen=True)
class Part:
    """Some trainings of one kind that are done together.

    Attributes:
        kind: of `KINDS`.
        lanes: the P trainings.
        number: of the part within its kind.
        marks: units at which its policies are evaluated.
        parent: units of the policies that copies are tuned from; 0 for other kinds.
    """

    kind: str
    lanes: tuple[Lane, ...]
    number: int
    marks: tuple[float, ...]
    parent: float = 0.0

    @property
    def name(self) -> str:
        """Of its files."""
        parent = f"-from-{self.parent:g}" if self.parent else ""
        return f"{self.kind}{parent}-{self.number:03d}"

    @property
    def asked(self) -> str:
        """The kind, as it is asked for."""
        return f"{self.kind}@{self.parent:g}" if self.parent else self.kind


@dataclass(frozen=True)
class Kinds:
    """A build of transfer data, of CMDPs that share a world and a recipe.

    Attributes:
        cmdps: the problems.
        trainers: theirs; equal but for the contexts.
        seeds: of the matrices.
        folder: in which it grows.
        every: sources are every n-th context.
        lanes: trainings of one program; None: what is best here.
        until: units of the policies for all, at most.
        parents: units of the policies for all that copies are tuned from.

    Raises:
        InvalidInput: the problems differ in more than contexts.
    """

    cmdps: tuple[Any, ...]
    trainers: tuple[WorldTrainer, ...]
    seeds: tuple[int, ...]
    folder: Path
    every: int = 1
    lanes: int | None = None
    until: float = GENERALIST_UNITS[-1]
    parents: tuple[float, ...] = PARENTS

    def __post_init__(self) -> None:
        pairs = zip(self.cmdps, self.trainers, strict=True)
        one = [trainer.problem([dict(c.space.context(0))]) for c, trainer in pairs]
        worlds = [(world, [np.shape(x) for x in params]) for world, params in one]
        recipes = [trainer.recipe for trainer in self.trainers]
        sizes = [cmdp.space.n for cmdp in self.cmdps]
        alike = (worlds, recipes, sizes)
        if any(one != each[0] for each in alike for one in each[1:]):
            raise InvalidInput(
                "CMDPs that are built together must have one world, recipe and number of contexts, "
                f"got {', '.join(cmdp.id for cmdp in self.cmdps)}; build them one after the other"
            )

    # ---- what there is to do -----------------------------------------------------------------

    @cached_property
    def trainer(self) -> WorldTrainer:
        """Of all the CMDPs."""
        if len(self.trainers) == 1:
            return self.trainers[0]
        named = [
            (frozenset(axis.name for axis in cmdp.space.axes), trainer.problem)
            for cmdp, trainer in zip(self.cmdps, self.trainers, strict=True)
        ]
        return replace(self.trainers[0], problem=OfOneWorld(tuple(named)))

    @property
    def n(self) -> int:
        """Number of contexts of each CMDP."""
        return int(self.cmdps[0].space.n)

    @property
    def sources(self) -> range:
        """Contexts of specialists and tuned copies."""
        return range(0, self.n, self.every)

    def parts(self, kinds: Sequence[str] = KINDS) -> list[Part]:
        """In an order in which parents come first.

        Args:
            kinds: of `KINDS`; "tuned@1" are copies of the policy for all of one unit alone.

        Raises:
            UnknownName: no such kind.
        """
        parents = [parent for parent in self.parents if parent <= self.until]
        each = [Lane(c, seed) for c in range(len(self.cmdps)) for seed in self.seeds]
        one = [Lane(lane.cmdp, lane.seed, source) for lane in each for source in self.sources]
        marks = tuple(mark for mark in GENERALIST_UNITS if mark <= self.until)
        wanted = [("generalists", each, marks, 0.0), ("specialists", one, (1.0,), 0.0)]
        wanted += [("tuned", one, TUNED_UNITS, parent) for parent in parents]
        found = [
            part
            for kind, lanes, marks, parent in wanted
            for part in self._grouped(kind, lanes, marks, parent)
        ]
        names = dict.fromkeys((*KINDS, *(part.asked for part in found)))
        for kind in kinds:
            check_known("kind of training", kind, names)
        return [part for part in found if {part.kind, part.asked} & set(kinds)]

    def _grouped(
        self, kind: str, lanes: Sequence[Lane], marks: tuple[float, ...], parent: float
    ) -> list[Part]:
        """Trainings of a kind, as many together as pay."""
        sizes, parts, first = even_groups(len(lanes), self.lanes or self.trainer.lanes), [], 0
        for number, size in enumerate(sizes):
            parts.append(Part(kind, tuple(lanes[first : first + size]), number, marks, parent))
            first += size
        return parts

    # ---- training ----------------------------------------------------------------------------

    def train(self, part: Part, on_progress: OnProgress | None = None) -> None:
        """Train what is missing of a part; its policies are kept in files, one per mark."""
        left = [mark for mark in part.marks if not self._policies(part, mark).is_file()]
        if not left:
            return
        contexts = [self._contexts(lane) for lane in part.lanes]
        seeds = [self._training_seed(part, lane) for lane in part.lanes]
        if part.kind == "specialists":
            kept = "best" if self.trainer.checkpoint == "best" else "final"
            own = [some[0] for some in contexts]
            state = self.folder / f"{part.name}.partial.npz"
            found = self.trainer.train_many(
                own, seeds, keep=(kept,), state=state, on_progress=on_progress
            )
            self._keep(part, 1.0, found[kept])
            state.unlink(missing_ok=True)
            return
        parents: Any = None
        which: list[int] = []
        trunk, done = None, 0.0
        if part.kind == "tuned":
            parents, which = self._parents(part)
        elif len(left) < len(part.marks):
            done = part.marks[-len(left) - 1]
            trunk = self._trunk(part, done)
        grown = self.trainer.grow_many(
            contexts,
            seeds,
            part.marks,
            parents=parents,
            which=which,
            parents_on=self.n,
            trunk=trunk,
            done=done,
            on_progress=on_progress,
        )
        for mark, policies, now in grown:
            if part.kind == "generalists":  # whoever goes on needs it: copies, and later marks
                with whole_file(self._trunk_file(part, mark)) as file:
                    np.savez(file, **engine.to_arrays(now))  # type: ignore[arg-type]
            self._keep(part, mark, policies)

    def _training_seed(self, part: Part, lane: Lane) -> int:
        """As in a study whose root is the seed of the lane."""
        if lane.source is None:
            return training_seed(lane.seed, MATRIX_TRIAL, range(self.n))
        if part.kind == "specialists":
            return training_seed(lane.seed, MATRIX_TRIAL, lane.source)
        lineage = (self.n, *range(self.n), int(1000 * part.parent))
        return training_seed(lane.seed, MATRIX_TRIAL, lane.source, lineage=lineage)

    def _contexts(self, lane: Lane) -> list[Context]:
        space = self.cmdps[lane.cmdp].space
        return list(space.contexts) if lane.source is None else [space.context(lane.source)]

    def _parents(self, part: Part) -> tuple[Any, list[int]]:
        """Trunks that the copies of a part begin from, and which of them each takes."""
        for other in self.parts(("generalists",)):
            places = {lane: i for i, lane in enumerate(other.lanes)}
            mine = [places.get(Lane(lane.cmdp, lane.seed)) for lane in part.lanes]
            if all(place is not None for place in mine):
                return self._trunk(other, part.parent), [int(place or 0) for place in mine]
        raise InvalidInput("copies of one part must have parents of one part")

    def _trunk(self, part: Part, mark: float) -> Any:
        """The saved trunk of generalists."""
        file = self._trunk_file(part, mark)
        if not file.is_file():
            raise InvalidInput(
                f"copies are tuned from policies for all contexts, and there are none of {mark:g} "
                "units; build the kind generalists first"
            )
        return engine.from_arrays(self._shapes(part), read_npz(file))

    def _shapes(self, part: Part) -> Any:
        """Of the trunk of generalists; made once, for all parts of copies begin from it."""
        import jax

        if part not in self._known_shapes:
            contexts = [self._contexts(lane) for lane in part.lanes]
            seeds = [self._training_seed(part, lane) for lane in part.lanes]
            begun = self.trainer.grown_from_scratch(contexts, seeds)
            self._known_shapes[part] = jax.tree.map(
                lambda x: jax.ShapeDtypeStruct(x.shape, x.dtype), begun
            )
        return self._known_shapes[part]

    @cached_property
    def _known_shapes(self) -> dict[Part, Any]:
        return {}

    def _trunk_file(self, part: Part, mark: float) -> Path:
        return self.folder / f"{part.name}-trunk-{mark:g}.npz"

    # ---- policies ----------------------------------------------------------------------------

    def _policies(self, part: Part, mark: float) -> Path:
        return self.folder / f"{part.name}-at-{mark:g}.npz"

    def _keep(self, part: Part, mark: float, policies: Sequence[MLPPolicy]) -> None:
        actor = engine.import_actor(list(policies))
        arrays = {"origin": text_array(here()), "log_std": np.asarray(actor.log_std)}
        for k, (weight, bias) in enumerate(actor.network):
            arrays |= {f"weight_{k}": np.asarray(weight), f"bias_{k}": np.asarray(bias)}
        write_npz(self._policies(part, mark), arrays)

    def _actor(self, part: Part, mark: float) -> Any:
        """(P, ...) the acting part of kept policies."""
        arrays = read_npz(self._policies(part, mark))
        count = sum(name.startswith("weight_") for name in arrays)
        network = tuple((arrays[f"weight_{k}"], arrays[f"bias_{k}"]) for k in range(count))
        return engine.Actor(network, arrays["log_std"])

    # ---- evaluation --------------------------------------------------------------------------

    def evaluate(self, part: Part, on_progress: OnProgress | None = None) -> None:
        """Returns of the policies of a part on all contexts of their CMDPs.

        Kept are (marks, P, N, 3): the means of both halves of the episodes, and the deviation.
        """
        file = self._returns(part)
        if self._is_evaluated(part):
            return
        actors = [self._actor(part, mark) for mark in part.marks]
        lanes = [lane for _ in part.marks for lane in part.lanes]
        found = self._played(engine.joined(actors), lanes, on_progress)
        shape = (len(part.marks), len(part.lanes), *found.shape[1:])
        write_npz(
            file,
            {
                "returns": summary(found).reshape(*shape[:-1], 3),
                "origin": _entry(self._policies(part, part.marks[-1]), "origin"),
                "evaluated": text_array(here()),
            },
        )

    def _played(
        self, actor: Any, lanes: Sequence[Lane], on_progress: OnProgress | None
    ) -> NDArray[Any]:
        """(P, N, E) returns of each policy on the contexts of its lane's CMDP."""
        trainer = self.trainer
        own = {
            seed: episode_seeds(self._evaluation_seeds(seed), self.n, trainer.eval_episodes)
            for seed in self.seeds
        }
        every = [context for cmdp in self.cmdps for context in cmdp.space.contexts]
        world, params = trainer.problem(every)
        activation = trainer.learner.activation
        rows: list[Any] = []
        for (cmdp, seed), who in groupby(range(len(lanes)), lambda i: lanes[i][:2]):
            some, first = list(who), cmdp * self.n
            part = engine.taken(params, slice(first, first + self.n))
            acting, how = engine.taken(actor, some), trainer.how
            rows.append(
                engine.evaluate(world, acting, part, own[seed], activation=activation, how=how)
            )
            if on_progress is not None:
                on_progress(Progress(some[-1] + 1, len(lanes), {}, "policies"))
        return np.concatenate(rows)

    def _evaluation_seeds(self, seed: int) -> list[int]:
        """One per target."""
        return evaluation_seeds(seed, MATRIX_TRIAL, range(self.n))

    def _returns(self, part: Part) -> Path:
        return self.folder / f"{part.name}-returns.npz"

    def _is_evaluated(self, part: Part) -> bool:
        """Whether it was, up to its last mark: a build may have been shorter at first."""
        file = self._returns(part)
        return file.is_file() and len(_entry(file, "returns")) >= len(part.marks)

    # ---- the whole ---------------------------------------------------------------------------

    def run(
        self,
        kinds: Sequence[str] = KINDS,
        on_progress: Callable[[str, Progress | None], None] = lambda part, progress: None,
    ) -> None:
        """Do what is missing of these kinds.

        Args:
            kinds: as of `parts`.
            on_progress: told which part is at work, and how far it is once that is known.

        Raises:
            InvalidInput: the folder holds another build, or parents of copies are missing.
            StorageError: it cannot be written, or another process builds in it.
            TrainingFailed: weights are no longer finite.
        """
        parts = self.parts(kinds)
        with claimed_folder(self.folder, self.claim, "transfer data"):
            for done, part in enumerate(parts):
                tell = partial(on_progress, f"{part.name} ({done + 1} of {len(parts)})")
                tell(None)
                self.train(part, tell)
                self.evaluate(part, tell)

    @property
    def claim(self) -> dict[str, Any]:
        """JSON-able; what a folder must have been begun with to go on."""
        recipes = [recipe_of(trainer) for trainer in self.trainers]
        each = [(cmdp.id, cmdp.version, dict(cmdp.settings)) for cmdp in self.cmdps]
        whole = replace(self, until=GENERALIST_UNITS[-1])  # it may go on to more units
        groups = [len(part.lanes) for part in whole.parts()]
        own = {"problems": each, "recipes": recipes, "on_several": dict(self.trainer.on_sets)}
        return {**own, "seeds": self.seeds, "groups": groups}

    def there(self) -> list[Part]:
        """Parts of kinds, and of copies of one parent, of which everything was evaluated."""
        found = list[Part]()
        for _, some in groupby(self.parts(), lambda part: part.asked):
            parts = list(some)
            if all(self._is_evaluated(part) for part in parts):
                found += parts
        return found

    def refer(self) -> None:
        """Rows without any policy, of each CMDP and seed."""
        for cmdp, trainer in zip(self.cmdps, self.trainers, strict=True):
            for seed in self.seeds:
                file = self._references(cmdp, seed)
                if not file.is_file():
                    own = self._evaluation_seeds(seed)
                    rows = reference_rows(trainer, list(cmdp.space.contexts), own)
                    write_npz(file, {k: summary(np.asarray(v)) for k, v in rows.items()})

    def _references(self, cmdp: Any, seed: int) -> Path:
        return self.folder / f"{cmdp.id}-references-{seed}.npz"

    def save(self, out: Path, command: str, preset: str) -> list[Path]:
        """Write the file of each CMDP and seed, of what is there.

        Without specialists of its own, a build takes them, and the rows without any policy, of the
        shipped matrix of this recipe.

        Raises:
            InvalidInput: the policies for all are missing; or specialists, and no matrix fits.
        """
        parts = self.there()
        there = {part.asked for part in parts}
        if "generalists" not in there:
            raise InvalidInput("transfer data hold policies for all; build the kind generalists")
        parents = sorted({part.parent for part in parts if part.parent})
        found: dict[tuple[int, int], dict[str, list[Any]]] = {}
        for part in parts:
            returns = _entry(self._returns(part), "returns")[: len(part.marks)]
            for i, lane in enumerate(part.lanes):
                own = found.setdefault(lane[:2], {})
                own.setdefault(part.asked, []).append(returns[:, i])
        shipped = [
            None if "specialists" in there else self._shipped(c) for c in range(len(self.cmdps))
        ]
        files = []
        for (c, seed), own in sorted(found.items()):
            cmdp, trainer, matrix = self.cmdps[c], self.trainers[c], shipped[c]
            (generalist,) = own["generalists"]
            arrays = {"generalists": generalist}
            if parents:
                each = [np.stack(own[f"tuned@{parent:g}"], axis=1) for parent in parents]
                arrays["tuned"] = np.stack(each)
            provenance: dict[str, Any] = {}
            if matrix is None:
                arrays["specialists"] = np.stack([rows[0] for rows in own["specialists"]])
            else:
                arrays |= self._of_matrix(matrix, seed)
                provenance["specialists"] = matrix.provenance["seeds"][seed]
            references = self._references(cmdp, seed)
            if references.is_file():
                arrays |= {f"{REFERENCE}{k}": row for k, row in read_npz(references).items()}
            provenance |= {
                "problem": cmdp.id,
                "version": cmdp.version,
                "switches": dict(cmdp.settings),
                "recipe": trainer.recipe,
                "on_several": dict(trainer.on_sets),
                "evaluation_seeds": PER_TARGET,
                "preset": preset,
                "seed": seed,
                "command": command,
                "together": [one.id for one in self.cmdps],
                "origins": self._origins(parts, "origin"),
                "evaluated": self._origins(parts, "evaluated"),
            }
            files.append(
                save_transfers(
                    out,
                    cmdp,
                    seed,
                    arrays,
                    episodes=trainer.eval_episodes,
                    sources=list(self.sources),
                    generalist_units=self.parts(("generalists",))[0].marks,
                    tuned_parents=parents,
                    tuned_units=TUNED_UNITS,
                    unit_steps=trainer.whole,
                    provenance=provenance,
                )
            )
        return files

    def _shipped(self, c: int) -> TransferMatrix:
        """The matrix whose policies are the specialists of this problem and recipe."""
        cmdp, trainer = self.cmdps[c], self.trainers[c]
        own = (cmdp.version, dict(cmdp.settings), trainer.recipe)
        missing = f"specialists of {cmdp.id} are missing; build the kind specialists"
        if cmdp.id not in shipped_matrices():
            raise InvalidInput(missing)
        matrix = load_matrix(cmdp.id)
        records = matrix.provenance["seeds"]
        same = all((one["version"], one["switches"], one["recipe"]) == own for one in records)
        whole = matrix.fresh_returns is not None and matrix.std is not None
        there = set(self.sources) <= set(matrix.trained) and max(self.seeds) < matrix.n_seeds
        if not (same and whole and there):
            raise InvalidInput(
                f"{missing} (the shipped matrix is of other switches, another recipe, or of fewer "
                "sources or seeds)"
            )
        return matrix

    def _of_matrix(self, matrix: TransferMatrix, seed: int) -> dict[str, NDArray[Any]]:
        """(M, N, 3) specialists and (N, 3) reference rows of a matrix, as `summary` has them."""
        rows = np.searchsorted(matrix.trained, self.sources)
        parts = (matrix.returns, matrix.fresh_returns, matrix.std)
        arrays = {"specialists": np.stack([x[seed][rows] for x in parts if x is not None], axis=-1)}
        for name, own in matrix.references.items():
            arrays[f"{REFERENCE}{name}"] = np.vstack([own[seed], np.full(matrix.n, np.nan)]).T
        return {name: each.astype(np.float32) for name, each in arrays.items()}

    def _origins(self, parts: Sequence[Part], key: str) -> list[dict[str, Any]]:
        """The distinct places where policies were trained, or evaluated, with their kinds."""
        entries = (read_text(_entry(self._returns(part), key), key) for part in parts)
        found = distinct(zip(entries, (part.kind for part in parts), strict=True))
        return [{**origin, "kinds": list(dict.fromkeys(kinds))} for origin, kinds in found]


def _entry(file: Path, key: str) -> NDArray[Any]:
    """One array of a file, without the others."""
    return read_npz(file, key.__eq__)[key]
