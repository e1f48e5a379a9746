"""The page of `mbtl report` in Chromium: its size, and how long until it answers.

Two pages: a study of 100 contexts and 15 picks, and a matrix of 900 x 900. A page answers when its
data are unpacked, plotly.js is loaded and the first picture is drawn. Each is loaded several times
in one browser. Printed are the median and the smallest of the clock, which other processes on the
machine lengthen, and of the processor time of the page's own thread, which they do not; beside them
the same for plotly.js alone, in a page with nothing else. Needs mbtl[plots] and a Chromium, named
by CHROMIUM or on the path.

example: CHROMIUM=/usr/bin/chromium python benchmarks/report_page.py
"""

from __future__ import annotations

import statistics
import sys
import tempfile
from pathlib import Path
from typing import Any

import measure  # before mbtl, which loads numpy
from measure import digits

import mbtl
from mbtl.report import of_study, write_page
from mbtl.zoo.benchmark.subject import of_matrix

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from report.browser import CHROMIUM, Browser

STUDY, MATRIX, PLOTLY = "cartpole-length-dqn", "cartpole-masses-length", "plotly.js alone"
GOALS = {STUDY: (4.0, 2.0), MATRIX: (5.0, None)}
"""Largest size [MB] and longest wait [s]."""
WAIT = """
  while (!document.documentElement.dataset.ready) await new Promise((go) => setTimeout(go, 20));
  return +document.documentElement.dataset.ready / 1000;
"""
ALONE = """<!doctype html><meta charset="utf-8"><link rel="icon" href="data:,"><div id="x"></div>
<script>{plotly}</script><script>Plotly.newPlot("x", [{{y: [1, 2]}}]).then(() =>
document.documentElement.dataset.ready = performance.now());</script>"""


def study(picks: int = 15) -> mbtl.Study:
    """The paper's rule on the rows of a shipped matrix of 100 contexts."""
    matrix = mbtl.load_matrix(STUDY)
    made = mbtl.create_study(
        matrix.space, budget=picks, strategy="mbtl", objective=mbtl.Objective(matrix.bounds)
    )
    for _ in range(picks):
        pick = made.ask()
        made.tell(pick, matrix.returns[0, pick.source])
    return made


def loaded(browser: Browser, page: Path) -> tuple[float, float]:
    """Seconds until a page answers: on the clock, and of its thread's processor time."""
    browser.call("Page.navigate", url="about:blank")
    before = thread_seconds(browser)
    browser.call("Page.navigate", url=page.as_uri())
    browser.run("while (document.readyState !== 'complete') await new Promise(setTimeout);")
    wall = float(browser.run(WAIT))
    return wall, thread_seconds(browser) - before


def thread_seconds(browser: Browser) -> float:
    """Processor time that the tasks of the page's thread have taken."""
    found = browser.call("Performance.getMetrics")["metrics"]
    return float(next(m["value"] for m in found if m["name"] == "TaskDuration"))


def row(name: str, file: Path, times: list[tuple[float, float]]) -> dict[str, Any]:
    """Size and times of a page."""
    wall, cpu = (sorted(column) for column in zip(*times, strict=True))
    return {
        "page": name,
        "MB": digits(file.stat().st_size / 1e6, 3),
        "wall": {"median": digits(statistics.median(wall), 3), "least": digits(wall[0], 3)},
        "cpu": {"median": digits(statistics.median(cpu), 3), "least": digits(cpu[0], 3)},
        "goals": GOALS.get(name),
    }


def said(one: dict[str, Any], plotly: dict[str, Any]) -> str:
    """A line of what is printed."""
    wall, cpu = one["wall"], one["cpu"]
    goals = "" if one["goals"] is None else f" (goal {one['goals'][0]:g} MB"
    if one["goals"] is not None:
        goals += ")" if one["goals"][1] is None else f", {one['goals'][1]:g} s)"
    return (
        f"{one['page']}: {one['MB']:.2f} MB; answers after {wall['median']:.2f} s on the clock "
        f"(least {wall['least']:.2f}), {cpu['median']:.2f} s of processor time (least "
        f"{cpu['least']:.2f}), {cpu['median'] / plotly['cpu']['median']:.2f} x plotly.js{goals}"
    )


def main() -> None:
    """Measure and print."""
    parser = measure.parser(__doc__)
    parser.add_argument("--loads", type=int, default=9, help="of each page")
    args = parser.parse_args()
    if CHROMIUM is None:
        raise SystemExit("this needs a Chromium; name it in CHROMIUM")
    from plotly.offline import get_plotlyjs

    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        whole = of_matrix(mbtl.load_matrix(MATRIX), "mbtl", budget=15)
        files = {
            STUDY: write_page([of_study(study())], place / "study.html"),
            MATRIX: write_page([whole], place / "matrix.html"),
            PLOTLY: place / "plotly.html",
        }
        files[PLOTLY].write_text(ALONE.format(plotly=get_plotlyjs()), encoding="utf-8")
        times: dict[str, list[tuple[float, float]]] = {name: [] for name in files}
        browser = Browser(place / "profile")
        try:
            browser.screen(1280, 900)
            browser.call("Performance.enable", timeDomain="threadTicks")
            loaded(browser, files[STUDY])  # the browser's own start is not the page's
            for _ in range(args.loads):
                for name, file in files.items():
                    times[name].append(loaded(browser, file))
        finally:
            browser.close()
        rows = [row(name, files[name], found) for name, found in times.items()]
    document = {"pages": rows, "machine": measure.machine("plotly")}
    measure.show(document, [said(one, rows[-1]) for one in rows], as_json=args.json)


if __name__ == "__main__":
    main()
