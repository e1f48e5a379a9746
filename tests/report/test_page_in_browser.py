"""The page in a real browser, without a window: it loads, it moves, and nothing goes wrong."""

import numpy as np
import pytest

import mbtl
from mbtl.report import of_study, page
from mbtl.zoo.benchmark.subject import of_matrix
from report.browser import CHROMIUM, Browser
from report.test_page import matrix_on, study_on

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium")

HELP = """
  const found = {}, root = document.documentElement;
  const pause = (ms) => new Promise((done) => setTimeout(done, ms));
  const until = async (is) => { for (let i = 0; i < 1200 && !is(); i++) await pause(50); };
  const seen = (part) => document.querySelector(`article:not([hidden]) [data-chart="${part}"]`);
  const plotted = async (part) => {
    seen(part).scrollIntoView();
    await until(() => seen(part).data);
    return seen(part).data;
  };
  const choose = (box, value) => { box.value = value; box.dispatchEvent(new Event("change")); };
  await until(() => root.dataset.ready);
"""


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    opened = Browser(tmp_path_factory.mktemp("profile"))
    yield opened
    opened.close()


@pytest.fixture
def probe(browser, tmp_path):
    """What a program finds in a page; nothing may go wrong meanwhile."""

    def probed(text, program, width=1000):
        file = tmp_path / "report.html"
        file.write_text(text, encoding="utf-8")
        browser.wrong.clear()
        browser.screen(width, 900)
        browser.call("Page.navigate", url=file.as_uri())
        browser.run("while (document.readyState !== 'complete') await new Promise(setTimeout);")
        found = browser.run(HELP + program + "; return found;")
        assert browser.wrong == []
        assert browser.run("return document.getElementById('trouble').hidden")
        return found

    return probed


def test_a_curve_that_does_not_move_is_drawn_flat(probe):
    study = study_on(picks=1)
    value = study.value
    for source in (0, 1):
        study.tell(source, study.state.rows[0].each)
    found = probe(
        page([of_study(study)]),
        """
        await plotted("curve");
        found.range = seen("curve").layout.yaxis.range;
        """,
    )
    assert found["range"] == pytest.approx([value - 0.05, value + 0.05], abs=1e-6)


def test_a_study_loads_and_the_slider_moves_through_the_steps(probe):
    study = study_on(picks=5)
    found = probe(
        page([of_study(study)]),
        """
        for (const p of ["curve", "policies", "heat"]) found[p] = (await plotted(p)).length;
        const box = seen("model"), named = (name) => box.data.find((t) => t.name === name);
        const believed = () => named("believed").y[3];
        await plotted("model");
        const input = document.querySelector('input[type="range"]');
        found.last = believed();
        found.sides = named("trained here").textposition;
        input.value = 2;
        input.dispatchEvent(new Event("input"));
        found.second = believed();
        found.said = document.querySelector("output").textContent;
        found.dots = named("trained here").x.length;
        const key = new KeyboardEvent("keydown", { key: "ArrowRight", bubbles: true });
        document.body.dispatchEvent(key);
        found.after = document.querySelector("output").textContent;
        found.axis = box.layout.xaxis.type;
        const table = document.querySelector("details[data-table]");
        table.open = true;
        await until(() => table.querySelector("tbody tr"));
        found.rows = table.querySelectorAll("tbody tr").length;
        document.getElementById("theme").click();
        found.theme = document.documentElement.dataset.theme;
        found.paper = getComputedStyle(document.body).backgroundColor;
        """,
    )
    assert min(found["curve"], found["policies"], found["heat"]) >= 1
    assert found["second"] != found["last"]
    third = study.space.describe(study.space.context(study.history.sources[2]))
    assert found["said"].startswith("after 2 of 5; next pick: mass = ")
    assert third.split()[2][:4] in found["said"]
    assert found["dots"] == 2
    above = [side == "top center" for side in found["sides"]]
    assert [above[i] for i in np.argsort(study.history.sources)] == [True, False] * 2 + [True]
    assert found["after"].startswith("after 3 of 5")
    assert found["axis"] == "log"
    assert found["rows"] == study.space.n
    assert (found["theme"], found["paper"]) == ("dark", "rgb(20, 23, 27)")


def test_three_axes_are_maps_that_can_be_sliced_and_pairs_and_a_phone_needs_no_scrolling_aside(
    probe,
):
    space = mbtl.ContextSpace.grid(
        {
            mbtl.Log("mass", 0.1, 10.0, unit="kg"): 4,
            mbtl.Linear("length", 0.0, 1.0, unit="m"): 3,
            mbtl.Categorical("road", ("wet", "dry")): 2,
        }
    )
    study = study_on(space, picks=3)
    found = probe(
        page([of_study(study), of_matrix(matrix_on(space), "specialists", budget=3)]),
        """
        await plotted("policies");
        const box = seen("policies"), selects = [...box.parentElement.querySelectorAll("select")];
        found.type = box.data[0].type;
        found.shape = [box.data[0].z.length, box.data[0].z[0].length];
        found.policies = box.data[0].z;
        const text = (s) => s.parentElement.firstChild.textContent;
        const road = selects.find((s) => text(s) === "road");
        choose(road, "");
        found.both = box.data[0].z;
        choose(road, "1");
        choose(selects[0], "performance");
        const averaged = box.data[0].z[0][0], slice = selects.find((s) => text(s) === "road");
        choose(slice, "0");
        found.changed = averaged !== box.data[0].z[0][0];
        choose(selects.find((s) => text(s) === "up"), "2");
        found.turned = box.layout.yaxis.ticktext;
        found.pairs = (await plotted("pairs")).length;
        await plotted("model");
        found.model = seen("model").data[0].z.length;
        choose(selects[0], "2");
        found.third = box.data[0].z.map((row) => Array.from(row));
        choose(document.getElementById("which"), "1");
        found.wide = document.documentElement.scrollWidth;
        """,
        width=390,
    )
    assert (found["type"], found["shape"]) == ("heatmap", [3, 4])
    wet, dry = study.routing.route.reshape(4, 3, 2).T + 1  # people count from 1
    assert found["policies"] == dry.tolist()  # a slice at a time
    alone = np.where(wet == dry, wet, 0).tolist()
    assert found["both"] == [[policy or None for policy in row] for row in alone]
    assert found["changed"]
    assert found["turned"] == ["wet", "dry"]
    assert found["pairs"] == 3
    assert found["model"] == 2  # the model's map follows the policies'
    third = study.history.rows[2].reshape(4, 3, 2)[:, 1].T
    np.testing.assert_allclose(found["third"], third, atol=1e-3)
    assert found["wide"] <= 390


def test_contexts_that_are_no_grid_are_points(probe):
    rng = np.random.default_rng(0)
    axes = [mbtl.Linear("x", 0.0, 1.0), mbtl.Linear("y", 0.0, 1.0)]
    space = mbtl.ContextSpace.points(axes, [{"x": x, "y": y} for x, y in rng.random((12, 2))])
    found = probe(
        page([of_study(study_on(space))]),
        """
        found.type = (await plotted("policies"))[0].type;
        found.points = seen("policies").data[0].x.length;
        await plotted("model");
        """,
    )
    assert (found["type"], found["points"]) == ("scatter", 12)
