"""What a trainer must be able to do for a study that is paid in steps, asked before it is paid."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from mbtl.actions import Policy
from mbtl.errors import InvalidInput, StudyMismatch
from mbtl.settings import first_difference
from mbtl.study.described import changed_code, code_mismatch
from mbtl.study.steps.kept import check_artifacts
from mbtl.study.steps.prices import whole_length
from mbtl.trainer import Trainer, code_of, recipe_of, refusal

if TYPE_CHECKING:
    from mbtl.study.steps.study import StepStudy


def check_trainer(study: StepStudy, trainer: Trainer, *, accept_changes: bool = False) -> None:
    """Refuse, before anything is spent, a trainer that cannot do what will be asked.

    Args:
        study: asks.
        trainer: makes and evaluates its policies.
        accept_changes: a user's own functions may have changed since; the log says so then.

    Raises:
        InvalidInput: so it is.
        StudyMismatch: it has another recipe or code, or the policies are kept elsewhere.
    """
    check_artifacts(study)
    spec = study.spec
    if len(spec.lengths) > 1 and (why := refusal(trainer, "length")):
        raise InvalidInput(f"{why}; or make the study with one length, lengths=[<one>]")
    whole = whole_length(trainer, spec.horizon)
    if whole is not None and whole < spec.lengths[-1]:
        raise InvalidInput(
            f"the last length is that of a whole training, got {spec.lengths[-1]:,} where the "
            f"trainer has {whole:,}; use the same trainer"
        )
    on_all = getattr(study.strategy, "trains_on_all", False)
    if on_all and (why := refusal(trainer, "sets") or refusal(trainer, "length")):
        raise InvalidInput(
            f"the strategy {study.strategy.name!r} trains one policy on all contexts, and {why}; "
            "or choose another strategy, such as 'pilot'"
        )
    if getattr(study.strategy, "starts_warm", False):
        _check_starts(study, trainer)
    known = spec.settings.get("recipe")
    own = recipe_of(trainer)
    if known is not None and (found := first_difference(known, own)):
        raise StudyMismatch(
            f"a study is run with the recipe it was made with: {found[0]} was {found[1]!r}, got "
            f"{found[2]!r}; use the same trainer, or start another study"
        )
    if study.is_durable and not getattr(trainer, "saves", True):
        raise InvalidInput(
            "a study that is stored goes on from saved policies, got a trainer that saves none; "
            "give save and load functions, or leave storage out"
        )
    if study.artifacts is not None and getattr(trainer, "saves", True) and not study.is_finished:
        study.artifacts.check()
    _equip(study, trainer, accept_changes)


def _equip(study: StepStudy, trainer: Trainer, accept_changes: bool) -> None:
    """Record a user's own code, or check that it is the same; see `mbtl.Study.equip`."""
    code, known = code_of(trainer), study.refresh().code
    if code == (known or {}):
        return
    changes = changed_code(known, code) if known and study.state.trainings else []
    if changes and not accept_changes:
        raise code_mismatch(changes)
    study.append("equipped", {"code": code, **({"accepted": changes} if changes else {})})


def check_start(study: StepStudy, trainer: Trainer, start: Policy) -> None:
    """Refuse to begin with weights that are not there, or that the trainer cannot take.

    Raises:
        InvalidInput: so it is.
    """
    _check_starts(study, trainer)
    trainings = study.state.trainings
    known = 0 <= start.training < len(trainings)
    if not known or not 0 <= start.length <= trainings[start.training].length:
        raise InvalidInput(
            f"a training begins with the weights of a mark that a training has passed, got "
            f"{start}; the strategy must choose another one"
        )


def with_episodes(trainer: Trainer, episodes: int) -> Trainer:
    """The trainer with so many episodes per target, where it can be told."""
    record: Any = trainer
    if getattr(trainer, "eval_episodes", episodes) == episodes:
        return trainer
    changed: Trainer = replace(record, eval_episodes=episodes)
    return changed


def _check_starts(study: StepStudy, trainer: Trainer) -> None:
    if why := refusal(trainer, "start"):
        raise InvalidInput(
            f"the strategy {study.strategy.name!r} begins trainings with the weights of others, "
            f"and {why}; or choose another strategy, such as 'pilot'"
        )
