"""The site: Markdown by MyST, the theme furo, the API reference from docstrings. `make docs`."""

import re

from docutils import nodes
from latex2mathml.converter import convert

from mbtl.version import __version__

project = "mbtl"
author = copyright = "The mbtl authors"
release = version = __version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.viewcode"]
exclude_patterns = ["_build"]

myst_enable_extensions = ["dollarmath", "deflist"]
myst_heading_anchors = 3
html_theme = "furo"
html_title = f"mbtl {release}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_math_renderer = "mathml"

default_role = "code"  # docstrings mark code by single backticks
autodoc_member_order = "bysource"
autodoc_default_options = {"members": True}
autodoc_type_aliases = {name: name for name in ("Array", "ArrayLike", "Context", "Floats")}
python_maximum_signature_line_length = 88
python_use_unqualified_type_names = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True
napoleon_attr_annotations = False  # types stand in the signature

PHRASE, SENTENCES = 30, 80
"""A cell with more characters than these holds a phrase, or sentences."""

PRIME = re.compile("<msup>(<mi>.</mi>)<mi>&#x02032;</mi></msup>")
"""Written small and high it is hardly seen: fonts have it so already."""

SECTIONS = "Args|Attributes|Example|Examples|Note|Raises|Returns|Yields"


def plain(app, what, name, obj, options, lines):
    """Docstrings are plain text: nothing in a formula is markup, and indented blocks stay so."""
    text = "\n".join(lines)
    spans = re.split(r"(`[^`\n]*`)", text)
    spans[::2] = [re.sub(r"([|*]|(?<=\w)_(?!\w))", r"\\\1", span) for span in spans[::2]]
    text = "".join(spans)
    if what == "module":  # tables of notation
        text = re.sub(
            rf"^(?!(?:{SECTIONS}):)(\S.*):\n\n?((?:    .*\n?(?:\n(?=    ))?)+)",
            _as_it_is,
            text,
            flags=re.M,
        )
    lines[:] = text.split("\n")


def _as_it_is(found):
    block = re.sub(r"\\([|*_])", r"\1", found[2])
    return f"{found[1]}::\n\n{block.rstrip()}\n\n"


def short(app, what, name, obj, options, signature, returned):
    """Names of types as they are written in the source."""
    alias = re.compile(r"TypeAliasForwardRef\('(\w+)'\)")
    return tuple(None if text is None else alias.sub(r"\1", text) for text in (signature, returned))


def helps(command, name):
    """What `--help` of a command and of those below it prints, in Markdown."""
    if hasattr(command, "commands"):
        there = {n: command.get_command(None, n) for n in command.list_commands(None)}
        return "".join(helps(one, f"{name} {n}") for n, one in there.items())
    text = command.get_help(command.context_class(command, info_name=name, terminal_width=90))
    return f"\n## {name}\n\n```text\n{text}\n```\n"


def add_helps(app, page, source):
    """The page of commands goes on with what the program says itself."""
    if page == "commands":
        from typer.main import get_command

        from mbtl.cli.app import app as program

        source[0] += helps(get_command(program), "mbtl")


def formula(page, node):
    """MathML, which browsers draw by themselves: no script, and nothing to be fetched."""
    block = isinstance(node, nodes.math_block)
    text = convert(node.astext(), display="block" if block else "inline")
    text = PRIME.sub(r'\1<mo lspace="0" rspace="0">&#x2032;</mo>', text)
    page.body.append(f'<div class="formula">{text}</div>' if block else text)
    raise nodes.SkipNode


def widen(app, tree, name):
    """Cells of tables that hold sentences get room, however many columns stand beside them."""
    for cell in tree.findall(nodes.entry):
        length = len(cell.astext())
        if length > PHRASE:
            cell["classes"].append("phrase" if length <= SENTENCES else "sentences")


def setup(app):
    """`plain` comes before napoleon, which reads the sections."""
    app.add_html_math_renderer("mathml", (formula, None), (formula, None))
    app.connect("doctree-resolved", widen)
    app.connect("autodoc-process-docstring", plain, priority=1)
    app.connect("autodoc-process-signature", short)
    app.connect("source-read", add_helps)
    app.connect("env-get-outdated", lambda *_: ["commands"])
