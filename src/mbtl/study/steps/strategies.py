"""Strategies by name, as the command line and `create_study` take them."""

from __future__ import annotations

from collections.abc import Mapping

from mbtl.actions import Committee, FixedLength, Halving, Pilot, Strategy
from mbtl.actions.evaluation import A_TENTH, WHERE_IT_MATTERS
from mbtl.errors import InvalidInput, unknown_name

STRATEGIES: Mapping[str, Strategy] = {
    "pilot": Pilot(),
    "fixed": FixedLength("mbtl", evaluation=A_TENTH),
    "halving": Halving("gain", 1, None, evaluation=WHERE_IT_MATTERS, name="halving"),
    "asha": Halving("own", 2, "random", evaluation=WHERE_IT_MATTERS),
    "committee": Committee(),
}
"""`pilot` learns the length from its first training; `fixed` trains all to the end; `halving` goes
on with those that V would miss most, `asha` with those that are best at home; `committee` lets a
pilot's specialists and one policy for all contexts take turns."""

DEFAULT = "pilot"
"""The simplest that the shipped transfer curves support (docs/steps.md)."""


def strategy_named(strategy: str | Strategy) -> Strategy:
    """A strategy by its name; one of a user's own stays as it is.

    Raises:
        UnknownName: nothing is called so.
        InvalidInput: an object that decides nothing.
    """
    if isinstance(strategy, str):
        if strategy not in STRATEGIES:
            raise unknown_name("strategy", strategy, STRATEGIES)
        return STRATEGIES[strategy]
    if not callable(getattr(strategy, "decide", None)) or not hasattr(strategy, "name"):
        raise InvalidInput(
            f"a strategy is a name ({', '.join(STRATEGIES)}) or an object with `name` and "
            f"`decide`, got {type(strategy).__name__}"
        )
    return strategy
