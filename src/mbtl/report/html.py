"""The page: one file that needs nothing else, neither network nor server.

Texts and tables are written by Python, so that they can be read without scripts; what moves is
drawn by `page/page.js` with plotly.js, which is in the file once and compressed.
"""

from __future__ import annotations

import html
import json
import re
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from mbtl.errors import InvalidInput, needs
from mbtl.files import whole_file
from mbtl.report.content import content
from mbtl.report.packing import compressed, packed
from mbtl.report.subject import Subject
from mbtl.report.summary import worst_first
from mbtl.version import __version__

_WORST = 5
"""Contexts that are listed as badly served."""
_SCORE = (
    "The score is the gain in V by which contexts are ranked; trust the order, not the size. Arrow "
    "keys move the slider."
)
_UNITS = "A unit is one whole training."
_FRESH = "Performance is of fresh episodes{}; the runner-up's is of the episodes that chose."
_SOME = " where they were played, else as it is believed"
_WORDS = (
    "Context: one setting of the simulator. V: mean performance over the contexts, or over the "
    "worst share of them that was asked for, each served by its best policy. Performance: the "
    "score as a share of the scale, and more than 1 beyond it. Specialist: a policy that was "
    "trained on one context."
)


def write_page(subjects: Sequence[Subject], path: str | Path) -> Path:
    """Write a report of one or more subjects.

    Args:
        subjects: studies and matrices.
        path: file to write; it is replaced whole.

    Raises:
        InvalidInput: the path is a folder.
        MissingExtra: plotly is not installed.
        StorageError: the file cannot be written.
    """
    path = Path(path)
    if path.is_dir():
        raise InvalidInput(f"a page is a file, and {path} is a folder; give {path / 'report.html'}")
    text = page(subjects)
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as file:
        file.write(text.encode("utf-8"))
    return path


def page(subjects: Sequence[Subject]) -> str:
    """The page as text; see `write_page`."""
    items = [content(one) for one in subjects]
    title = ", ".join(subject.name for subject in subjects)
    parts = {
        "TITLE": html.escape(title),
        "CSS": _file("page.css"),
        "BODY": "\n".join(map(_article, range(len(items)), subjects, items)),
        "CHOICE": _choice(subjects),
        "VERSION": html.escape(__version__),
        "DATA": packed(items),
        "PLOTLY": compressed(_plotly().encode("utf-8")),
        "JS": _file("page.js"),
    }
    # once through, so that what a study is called cannot stand for a part
    return re.sub(r"\{\{([A-Z]+)\}\}", lambda match: parts[match[1]], _file("page.html"))


def _plotly() -> str:
    with needs("plotly", "plots"):
        from plotly.offline import get_plotlyjs
    return str(get_plotlyjs())


def _file(name: str) -> str:
    return (resources.files("mbtl.report") / "page" / name).read_text(encoding="utf-8")


def _choice(subjects: Sequence[Subject]) -> str:
    if len(subjects) == 1:
        return ""
    options = "".join(
        f'<option value="{i}">{html.escape(f"{one.name}: {one.selector}")} ({one.kind})</option>'
        for i, one in enumerate(subjects)
    )
    return f'<label>Show <select id="which">{options}</select></label>'


def _article(i: int, subject: Subject, item: dict[str, Any]) -> str:
    """All of one subject, of which only the first is shown at once."""
    told, space = len(subject.history), subject.space
    unasked = sum(pick.place is not None and pick.number is None for pick in subject.picks)
    units = subject.units[-1] - unasked if told else 0.0
    asked = told - unasked
    facts = f"{subject.selector}, {asked} training{'s' * (asked != 1)}"
    facts += f", {units:g} units" if told and units != asked else ""
    facts += f", {unasked} {'policy' if unasked == 1 else 'policies'} of yours" if unasked else ""
    facts += f", {space.n} contexts"
    if subject.kind == "study":
        facts += ", finished" if subject.finished else ", under way"
    parts = [
        f'<article data-item="{i}"{" hidden" if i else ""}>',
        f"<h1>{html.escape(subject.name)}</h1>",
        f'<p class="facts">{html.escape(facts)}</p>',
        _headline(subject),
        *(f"<p>{_said(line)}</p>" for line in subject.sentences),
        f"<details><summary>Words</summary><p>{_WORDS}</p></details>",
        _beside(subject),
        _next(subject),
    ]
    if told:
        parts += [
            _section("curve", "V after each training", f"V is of {subject.values_of}. {_UNITS}"),
            _picks(subject),
            _section(
                "policies",
                "Which policy serves which context",
                _FRESH.format("" if subject.all_fresh else _SOME) if subject.fresh else "",
            ),
            _badly_served(subject),
            _details("serving", "Every context: its policy, its performance, the runner-up"),
        ]
        if np.isfinite(item["steps"]["mean"]).any():
            believed = f"What the model believed ({item['steps']['model']})"
            parts.append(_section("model", believed, _SCORE))
        if len(space.axes) == 1:  # on several, the map of policies shows them one by one
            parts.append(_section("heat", "Transfer: every policy on every context", ""))
        if space.d > 2:
            parts.append(_section("pairs", "Every pair of axes, the others averaged", ""))
    return "\n".join([*parts, _costs(subject), _provenance(subject.provenance), "</article>"])


def _headline(subject: Subject) -> str:
    if not subject.headline:
        return ""
    first, *others = subject.headline
    rest = "".join(f"<p>{_said(line)}</p>" for line in others)
    return f'<div class="headline"><p class="value">{_said(first)}</p>{rest}</div>'


def _said(line: str) -> str:
    """A sentence of the terminal, which has no such sign."""
    return html.escape(line).replace("+-", "±")


def _beside(subject: Subject) -> str:
    if not subject.beside:
        return ""
    heads, *rows = subject.beside
    return f"<section><h2>Beside what needs no training</h2>{_table(heads, rows)}</section>"


def _next(subject: Subject) -> str:
    rows = "".join(
        f"<li>{html.escape(what)}: <code>{html.escape(command)}</code></li>"
        for what, command in subject.next_steps
    )
    return f"<section><h2>What to do next</h2><ul>{rows}</ul></section>" if rows else ""


def _badly_served(subject: Subject) -> str:
    """The contexts with the lowest performance: where another training, or a look, is due."""
    routing, space = subject.routing, subject.space
    if routing is None or space.n <= _WORST:
        return ""
    served, score = subject.shown, [*subject.columns.items()][:1]
    played = np.isfinite(score[0][1]) if score else routing.measured
    rows = [
        [
            space.describe(space.context(int(i))),
            f"policy {routing.route[i] + 1}, trained on "
            + subject.picks[int(routing.route[i])].trained_on(space),
            _number(float(served[i])),
            *("–" if values[i] != values[i] else f"{values[i]:.4g}" for _, values in score),
        ]
        for i in worst_first(routing, space.weights * played)[:_WORST]
    ]
    table = _table(["context", "served by", "performance", *(head for head, _ in score)], rows)
    note = ""
    if subject.fresh is not None:
        note = "<p>They seemed worst before the fresh episodes, which performance is of.</p>"
    return f"<section><h2>Served worst</h2>{note}{table}</section>"


def _picks(subject: Subject) -> str:
    """What each training added, beside what was promised of it."""
    values, rows = list(subject.values), []
    for k, pick in enumerate(subject.picks):
        told = k < len(values)
        rows.append(
            [
                str(k + 1) if told else "–",
                pick.trained_on(subject.space),
                _number(values[k] if told else None),
                _number(values[k] - values[k - 1] if told and k else None),
                _number(pick.promised if k else None),
                pick.reason if pick.status == "told" else pick.status,
            ]
        )
    heads = ["policy", "trained on", "V", "gained", "promised", "why"]
    note = (
        "<p>Gained: by how much V rose. Promised: the gain that the selector expected when it "
        "chose, if it says one; the rules of the paper are optimistic on purpose.</p>"
    )
    return f"<section><h2>What each training added</h2>{_table(heads, rows)}{note}</section>"


def _costs(subject: Subject) -> str:
    seconds = [pick.seconds for pick in subject.picks if pick.seconds is not None]
    costs = [pick.cost for pick in subject.picks if pick.cost is not None]
    failed = [pick for pick in subject.picks if pick.status.startswith("failed")]
    lines = []
    if seconds:
        lines.append(
            f"{len(seconds)} trainings with their evaluations took {sum(seconds) / 60:.1f} "
            f"minutes, the longest {max(seconds) / 60:.1f}."
        )
    own = zip(subject.picks, np.diff(subject.units, prepend=0.0), strict=False)
    # where nobody counts costs, they are the units
    if any(pick.cost is not None and abs(pick.cost - units) > 1e-9 for pick, units in own):
        lines.append(f"The trainings cost {sum(costs):g} in the unit of the study.")
    count = f"{len(failed)} training{'s' * (len(failed) != 1)} failed."
    lines.append(count if failed else "No training failed." if subject.kind == "study" else "")
    body = "".join(f"<p>{html.escape(line)}</p>" for line in lines if line)
    for pick in failed:
        trace = html.escape(pick.traceback or "no traceback was recorded")
        what = html.escape(f"{pick.trained_on(subject.space)}: {pick.status}")
        body += f"<details><summary>{what}</summary><pre tabindex=0>{trace}</pre></details>"
    return f"<section><h2>Costs, times, failures</h2>{body}</section>" if body else ""


# ---- parts that articles share ------------------------------------------------------------------


def _section(kind: str, title: str, said: str) -> str:
    """A picture with its title; scripts draw it."""
    note = f"<p>{html.escape(said)}</p>" if said else ""
    return (
        f"<section><h2>{html.escape(title)}</h2>{note}"
        f'<div class="controls" data-controls="{kind}"></div>'
        f'<div class="chart {kind}" data-chart="{kind}" role="figure" '
        f'aria-label="{html.escape(title)}"></div></section>'
    )


def _details(kind: str, title: str) -> str:
    """A table that scripts fill when it is opened."""
    return (
        f'<details data-table="{kind}"><summary>{html.escape(title)}</summary>'
        '<div class="scroll" tabindex=0></div></details>'
    )


def _number(value: float | None) -> str:
    """Rounded, never minus zero; a dash where there is none."""
    return "–" if value is None or value != value else f"{round(value, 4) + 0.0:.4f}"


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Texts as a table."""
    head = "".join(f"<th scope=col>{html.escape(name)}</th>" for name in heads)
    body = "".join(
        "<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in rows
    )
    return (
        f'<div class="scroll" tabindex=0><table><thead><tr>{head}</tr></thead>'
        f"<tbody>{body}</tbody></table></div>"
    )


def _provenance(record: Any) -> str:
    """How all this was made, as a record that folds out."""
    text = json.dumps(record, indent=2, default=str)
    return (
        "<section><h2>How this was made</h2><details><summary>Recipe, versions, seeds</summary>"
        f"<pre tabindex=0>{html.escape(text)}</pre></details></section>"
    )
