"""The page of a study that is paid in steps: bill, V against steps, courses, who serves."""

import re

import numpy as np
import pytest
from step_problem import SPACE, Slow, opened

import mbtl
from mbtl.report import of_step_study, page
from mbtl.report.step_subject import step_content
from mbtl.study.steps.pieces import pieces
from report.browser import CHROMIUM
from report.test_page import items_of, study_on
from report.test_page_in_browser import browser, probe  # noqa: F401  (fixtures)


@pytest.fixture(scope="module")
def study():
    """With extensions and a training that failed."""
    made = opened(Slow(fails_at=0.0), budget=250_000)
    made.run(progress=False)
    return made


def test_pieces_add_up_to_the_bill_and_follow_each_other(study):
    done, prices = pieces(study), study.state.prices
    assert [piece.before for piece in done[1:]] == [piece.after for piece in done[:-1]]
    assert done[0].before == 0.0
    assert done[-1].after == study.state.spent
    paid = dict.fromkeys(("training", "extension", "evaluation", "failed"), 0.0)
    for piece in done:
        paid[piece.kind] += piece.after - piece.before
    assert all(paid.values())
    assert paid["evaluation"] == prices.evaluation
    assert paid["failed"] == prices.failed
    trained = prices.training + prices.extension + prices.checks
    assert paid["training"] + paid["extension"] == trained


def test_v_along_the_pieces_ends_at_that_of_the_study(study):
    values = [piece.value for piece in pieces(study) if piece.value is not None]
    assert len(values) >= len(study.state.policies)
    assert values[-1] == pytest.approx(study.value)
    assert values[0] < values[-1]


def test_v_is_in_the_bounds_of_now_where_the_study_has_none():
    free = opened(Slow(), bounds=None)
    free.run(progress=False, report=False)
    (*_, last) = [piece.value for piece in pieces(free) if piece.value is not None]
    assert last == pytest.approx(free.value)


def test_only_policies_that_serve_are_shown_and_each_says_which_it_is(study):
    item = step_content(of_step_study(study))
    served, portfolio = item["served"], study.portfolio()
    assert sorted(set(served["policy"].tolist())) == list(range(len(item["policies"])))
    sources = np.asarray(item["sources"])[served["policy"]]
    assert sources.tolist() == [portfolio.sources[i] for i in portfolio.assignment]
    assert served["performance"] == pytest.approx(portfolio.routing.served)
    assert all(re.fullmatch(r"training \d+ at [\d.]+K steps", name) for name in item["policies"])
    evaluated = np.isfinite(item["rows"])
    assert evaluated.any(axis=1).all()
    assert not evaluated.all()


def test_texts_can_be_read_without_scripts(study):
    text = page(
        [
            of_step_study(study),
        ]
    )
    body = re.sub(r"<script.*?</script>", "", text, flags=re.S)
    assert "strategy pilot, 250K of 250K steps, 7 trainings, 11 contexts, finished" in body
    assert re.search(r"<td>trainings that went on</td><td>[\d.]+K</td><td>\d+%</td>", body)
    assert re.search(r"<td>all in</td><td>250K</td><td>100%</td>", body)
    assert "ended: its own context gives the largest return there is" in body
    assert "x = 0: RuntimeError: the simulator fell over" in body
    assert "on fresh episodes (" in body


def test_a_study_that_has_not_begun_has_a_page():
    text = page([of_step_study(opened(Slow()))])
    assert "0 of 150K steps, 0 trainings, 11 contexts, under way" in text
    assert 'data-chart="' not in re.sub(r"<script.*?</script>", "", text, flags=re.S)


def test_a_policy_of_all_contexts_says_so():
    made = opened(Slow(), strategy="committee")
    made.run(progress=False)
    (item,) = items_of(page([of_step_study(made)]))
    assert {one["trained_on"] for one in item["trainings"]} > {"all contexts"}
    assert max(item["trainings"], key=lambda one: one["serves"])["trained_on"] == "all contexts"


@pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium")
def test_the_pictures_are_drawn_also_beside_a_study_that_counts_trainings(probe, study):  # noqa: F811
    found = probe(
        page([of_step_study(study), of_study_of_trainings()]),
        """
        const spending = await plotted("spending"), courses = await plotted("courses");
        found.v = spending[0].y.at(-1);
        found.fresh = spending[1].y[0];
        found.paid = courses.map((t) => t.x.reduce((a, b) => a + b, 0));
        found.names = courses.map((t) => t.name);
        found.rows = seen("courses").layout.yaxis.categoryarray;
        for (const p of ["policies", "heat"]) found[p] = (await plotted(p)).length;
        const table = document.querySelector("article:not([hidden]) details[data-table]");
        table.open = true;
        await until(() => table.querySelector("tbody tr"));
        found.which = table.querySelector("tbody td:nth-child(3)").textContent;
        choose(document.getElementById("which"), "1");
        found.curve = (await plotted("curve")).length;
        found.wide = document.documentElement.scrollWidth;
        """,
        width=390,
    )
    prices = study.state.prices
    assert found["v"] == pytest.approx(study.value)
    assert found["fresh"] == pytest.approx(study.summary().fresh_value)
    assert found["names"] == ["new training", "extension", "evaluation", "failed"]
    assert found["paid"][2:] == pytest.approx([prices.evaluation, prices.failed])
    assert found["rows"] == [*map(str, range(1, 8)), "failed"]
    assert min(found["policies"], found["heat"], found["curve"]) >= 1
    assert found["which"].startswith("training ")
    assert found["wide"] <= 390


def of_study_of_trainings():
    from mbtl.report import of_study

    return of_study(study_on(mbtl.ContextSpace.grid({mbtl.Linear("y", 0.0, 1.0): 9}), picks=2))


def test_steps_are_shown_over_two_axes_too():
    space = mbtl.ContextSpace.grid({mbtl.Linear("x", 0.0, 1.0): 4, mbtl.Linear("y", 0.0, 1.0): 3})
    made = mbtl.create_study(
        space, cost="steps", budget=150_000, trainer=Slow(), horizon=20, bounds=(0.0, 1.0),
        episodes=2,
    )  # fmt: skip
    made.run(progress=False, report=False)
    item = step_content(of_step_study(made))
    assert item["served"]["policy"].shape == (space.n,)
    assert SPACE.n != space.n
