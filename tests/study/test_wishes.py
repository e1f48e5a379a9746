import pytest

import mbtl

SPACE = mbtl.ContextSpace.grid({mbtl.Linear("x", 0.0, 1.0): 6})


def study_of(**settings):
    return mbtl.create_study(SPACE, budget=3, **settings)


def test_records_say_the_same_as_keywords():
    bounds = mbtl.Bounds(0.0, 10.0, "minimize", floor=50.0)
    records = study_of(
        objective=mbtl.Objective(bounds, risk=0.5, best_return=1.0),
        stopping=mbtl.Stopping(value=0.9, gain=0.01, left=0.02, confidence=0.8, cost=2.5),
    )
    keywords = study_of(
        bounds=bounds, risk=0.5, best_return=1.0, stop_value=0.9, stop_gain=0.01, stop_left=0.02,
        stop_confidence=0.8, cost_budget=2.5,
    )  # fmt: skip
    assert records.spec == keywords.spec
    assert study_of().spec == study_of(objective=mbtl.Objective(), stopping=mbtl.Stopping()).spec


@pytest.mark.parametrize(
    ("both", "match"),
    [
        ({"objective": mbtl.Objective(), "risk": 0.5, "bounds": (0, 1)}, "and bounds=, risk=; wr"),
        ({"stopping": mbtl.Stopping(), "stop_gain": 0.1}, r"write Stopping\(gain="),
        ({"stopping": mbtl.Stopping(), "cost_budget": 5.0}, r"write Stopping\(cost="),
        ({"objective": (0, 1)}, "must be a mbtl.Objective"),
        ({"stopping": mbtl.Objective()}, "must be a mbtl.Stopping"),
    ],
)
def test_both_at_once_are_refused_with_what_to_write_instead(both, match):
    with pytest.raises(mbtl.InvalidInput, match=match):
        study_of(**both)
