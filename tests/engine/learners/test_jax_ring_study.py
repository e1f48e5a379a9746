"""A study of a twin that is paid in steps: its recipe counts episodes, whose steps differ."""

import pytest

pytest.importorskip("jax", reason="the jax extra is not installed")
pytest.importorskip("gymnasium", reason="the envs extra is not installed")

import mbtl
from flat import ran
from mbtl.problems import get_cmdp

RING = get_cmdp("ring-acc", engine="jax").every(13)
"""Holds of 7, 20 and 33 s: episodes of 58, 20 and 13 decisions."""
DECISIONS = (58, 20, 13)


def test_a_study_of_a_twin_is_charged_what_was_played():
    options = {"episodes": 4, "eval_episodes": 1, "hyperparameters": {"hidden": (8,)}}
    study = mbtl.create_study(
        RING.recipe("quick", **options), budget=mbtl.Steps(11_000), strategy="random"
    )
    ran(study, report=False)
    assert {row.source: row.steps for row in study.state.rows} == {
        source: 4 * decisions for source, decisions in enumerate(DECISIONS)
    }
    bill = study.state.bill()
    assert bill.training == 4 * sum(DECISIONS)
    assert bill.evaluation == 3 * sum(DECISIONS)  # every policy once on every context
    assert bill.total == bill.training + bill.evaluation
