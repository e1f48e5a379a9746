"""Two records differ by the first setting that does, at any depth."""

import pytest

from mbtl.settings import first_difference

OLD = {"seed": 1, "recipe": {"steps": 5, "sizes": [4, 4]}, "note": None}


def test_equal_records_have_no_difference():
    assert first_difference(OLD, dict(reversed(OLD.items()))) is None
    assert first_difference(OLD, {k: v for k, v in OLD.items() if k != "note"}) is None


@pytest.mark.parametrize(
    ("change", "difference"),
    [
        ({"seed": 2}, ("seed", 1, 2)),
        ({"recipe": {"steps": 5, "sizes": [4]}}, ("recipe.sizes", [4, 4], [4])),
        ({"recipe": {"steps": 5}}, ("recipe.sizes", [4, 4], None)),
        ({"recipe": 7}, ("recipe", OLD["recipe"], 7)),
        ({"recipe": {**OLD["recipe"], "new": None}, "note": "x"}, ("note", None, "x")),
        ({"more": 1}, ("more", None, 1)),
    ],
)
def test_the_first_difference_is_named_with_both_values(change, difference):
    assert first_difference(OLD, {**OLD, **change}) == difference
