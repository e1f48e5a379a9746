"""What `mbtl matrix build` builds: the folder in which it grows, and the files in which it ends."""

from __future__ import annotations

import json
import shutil
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from mbtl.errors import InvalidInput
from mbtl.files import claim_of
from mbtl.problems import CMDP
from mbtl.processes import usable_cores
from mbtl.seeds import PER_TARGET
from mbtl.settings import first_difference
from mbtl.trainers.contract import Trainer, recipe_of
from mbtl.zoo.benchmark import TransferMatrix, save_shipped
from mbtl.zoo.benchmark.build import ONLY, Build
from mbtl.zoo.benchmark.provenance import check_made_by
from mbtl.zoo.benchmark.shipped import DEFAULT, matrix_id, shipped_file
from mbtl.zoo.cli.shared import bar


@dataclass(frozen=True)
class Job:
    """What is built, for any seed.

    Attributes:
        cmdp: the problem.
        trainer: of its policies.
        checkpoints: policies of a training that are evaluated, each into a file of its own.
        lanes: sources trained together.
        preset: for the record.
        variant: name of the set.
        command: that builds it, but for the seed.
        usual: the checkpoint that the preset keeps; the file of another is named after it.
        every: every n-th context is a source; all are targets.
    """

    cmdp: CMDP
    trainer: Trainer
    checkpoints: tuple[str, ...]
    lanes: int
    preset: str
    variant: str
    command: str
    usual: str
    every: int = 1

    @property
    def settings(self) -> dict[str, Any]:
        """JSON-able; all that the numbers depend on."""
        return {
            "problem": self.cmdp.id,
            "version": self.cmdp.version,
            "switches": dict(self.cmdp.settings),
            "recipe": recipe_of(self.trainer),
            "evaluation_seeds": PER_TARGET,
        }

    @property
    def sources(self) -> range:
        """Contexts to train on."""
        return range(0, self.cmdp.space.n, self.every)

    def of_checkpoint(self, checkpoint: str) -> dict[str, Any]:
        """`settings` of one of several."""
        settings = self.settings
        if checkpoint != ONLY:
            settings["recipe"] = {**settings["recipe"], "checkpoint": checkpoint}
        return settings

    def file(self, out: Path, checkpoint: str, seed: int) -> Path:
        """Where it is to be saved."""
        return shipped_file(out, self.cmdp.id, self._named(checkpoint), seed)

    def _named(self, checkpoint: str) -> str:
        """Variant of a checkpoint."""
        if checkpoint in (ONLY, self.usual):
            return self.variant
        return checkpoint if self.variant == DEFAULT else f"{self.variant}-{checkpoint}"

    def there(self, out: Path, seed: int) -> dict[Path, TransferMatrix]:
        """The finished files of a seed; empty unless all are there.

        Raises:
            InvalidInput: one was made with other settings.
        """
        found = {}
        for checkpoint in self.checkpoints:
            file = self.file(out, checkpoint, seed)
            if file.is_file():
                found[file] = TransferMatrix.load(file)
                check_made_by(file, found[file].provenance, self.of_checkpoint(checkpoint))
                there, wanted = len(found[file].problem(1).sources), len(self.sources)
                if there != wanted:
                    raise InvalidInput(
                        f"{file} has {there} sources and this build {wanted}; name the set with "
                        "--variant, or move the file away"
                    )
        return found if len(found) == len(self.checkpoints) else {}

    def run(self, building: Build, out: Path, workers: int | None) -> dict[Path, TransferMatrix]:
        """Train and evaluate what is missing, and write the files of a seed."""
        seed = building.seed
        if workers is None:
            workers = 1 if self.lanes >= len(self.sources) else usable_cores()
        label = f"{matrix_id(self.cmdp.id, self.variant)} seed {seed}"
        with bar(label, len(self.sources)) as tell:
            building.run(workers, lambda done, total: tell(done, total, "sources"))
        built = {}
        for checkpoint in self.checkpoints:
            file = self.file(out, checkpoint, seed)
            built[file] = TransferMatrix.of_episodes(
                building.returns(checkpoint)[None],
                references={name: row[None] for name, row in building.references().items()},
                space=self.cmdp.space,
                bounds=self.cmdp.normalisation,
                theta=self.cmdp.theta,
                direction="max" if self.cmdp.direction == "maximize" else "min",
                provenance={**self.of_checkpoint(checkpoint), **self._record(building)},
                sources=list(self.sources),
                name=file.name,
            )
            save_shipped(built[file], out, self.cmdp.id, self._named(checkpoint), first_seed=seed)
        if building.kept is not None:  # its pieces would pass for a later evaluation
            shutil.rmtree(building.folder, ignore_errors=True)
        return built

    def _record(self, building: Build) -> dict[str, Any]:
        """Of what a matrix is, beside the settings that its numbers depend on."""
        return {
            "preset": self.preset,
            "seed": building.seed,
            "lanes": self.lanes,
            "command": f"{self.command} --seeds 1 --first-seed {building.seed}",
            "process_seconds": round(building.seconds(), 1),
            "train_seconds": round(building.seconds("train_seconds"), 1),
            "nominal": None if self.cmdp.nominal is None else dict(self.cmdp.nominal),
            "origins": building.origins(),
            "evaluated": building.origins("evaluated"),
        }

    def building(self, work: Path, seed: int) -> Build:
        """In its folder below `work`."""
        name = matrix_id(self.cmdp.id, self.variant)
        return Build(
            self.trainer,
            self.cmdp.space,
            seed,
            work / f"matrix-{name}-{self.preset}-seed{seed}",
            self.settings,
            self.checkpoints,
            self.lanes,
            every=self.every,
        )

    def again(self, work: Path, seed: int) -> Build:
        """Only the evaluation of what was built before, beside it.

        Raises:
            InvalidInput: nothing was built there, or by another training.
        """
        begun = self.building(work, seed)
        claim = claim_of(begun.folder)
        if claim is None:
            raise InvalidInput(
                f"no policies were kept in {begun.folder}; build without --evaluate-again, or give "
                "the --work of that build"
            )
        now = json.loads(json.dumps(begun.claim))
        for record in (claim, now):
            record["recipe"].pop("eval_episodes", None)
            record.pop("evaluation_seeds", None)
        if difference := first_difference(claim, now):
            name, was, got = difference
            raise InvalidInput(
                f"only the number of episodes may change when policies of {begun.folder} are "
                f"evaluated again: {name} was {was!r}, got {got!r}"
            )
        folder, kept = begun.folder / "evaluated-again", begun.folder / "policies"
        return replace(begun, folder=folder, kept=kept)
