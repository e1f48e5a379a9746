"""What code blocks of README and docs do when they are executed.

A page is executed from top to bottom in an empty folder, its Python blocks in one namespace.

- A Python block whose first line is `# name.py` is written to that file and imported: what stands
  under `if __name__ == "__main__"` does not run.
- In a `bash` block each `mbtl` command runs in this process, and each script that the page wrote or
  that is in examples/ as a program. Of `make` and `pip install 'mbtl[...]'` the targets and extras
  must exist.
- A block after `<!-- not run: why -->` is only read: Python must compile, `mbtl` must know the
  command and all of its options, scripts must exist.
- `<!-- invisible-code-block: python` begins Python that readers do not see: what a page takes for
  granted. `examples` and `numpy` are known from the start.
- An `xml` block whose first line is `<!-- name -->` is written to that file.
- `text`, `toml`, ... are for people. A block without a language is an error.
"""

import importlib
import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy
from sybil import Document, Example, Sybil
from sybil.evaluators.python import PythonEvaluator
from sybil.parsers.myst import CodeBlockParser

ROOT = Path(__file__).parents[2]
PAGES = sorted(
    page
    for page in [*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")]
    if page.name != "CHANGELOG.md"  # tells of what is gone, too
)
SHOWN = {"text", "toml", "json", "ini", "html", "yaml", "dockerfile"}
FENCE = re.compile(r"^[ >]*(`{3,})([^`\n]*)$")
NOT_RUN = re.compile(r"<!-- not run: .+ -->\s*\Z")
FILE = re.compile(r"# ([\w/]+\.py)\b")
_python = PythonEvaluator()


def fences(text: str) -> list[tuple[int, str]]:
    """Line and language of every fenced block."""
    found, inside = [], ""
    for number, line in enumerate(text.split("\n"), 1):
        match = FENCE.match(line)
        if match and not inside:
            inside = match[1]
            found.append((number, match[2].strip()))
        elif match and match[1] == inside and not match[2].strip():
            inside = ""
    return found


def is_read_only(example: Example) -> bool:
    """Whether the page says that the block takes too long, or needs what is not here."""
    before = example.document.text[: example.start]
    return NOT_RUN.search(before.rstrip(" >")) is not None


def python(example: Example) -> None:
    """Execute a block, or import the file that it is."""
    code = str(example.parsed)
    file = FILE.match(code)
    if is_read_only(example):
        compile(code, str(example.path), "exec")
        if file is not None:
            Path(file[1]).write_text(code)
    elif file is None:
        _python(example)
    else:
        Path(file[1]).parent.mkdir(parents=True, exist_ok=True)
        Path(file[1]).write_text(code)
        sys.modules.pop(Path(file[1]).stem, None)
        importlib.invalidate_caches()
        importlib.import_module(Path(file[1]).stem)


def xml(example: Example) -> None:
    """Write a file that the page goes on with."""
    text = str(example.parsed)
    ElementTree.fromstring(text)
    name = re.match(r"<!-- ([\w.]+) -->\n", text)
    if name is not None:
        Path(name[1]).write_text(text)


def bash(example: Example) -> None:
    """Run each command, or only look whether it could be run."""
    lines = str(example.parsed).replace("\\\n", " ").splitlines()
    if subprocess.run(["bash", "-n"], input="\n".join(lines), text=True).returncode:
        raise AssertionError(f"line {example.line}: bash cannot read this block")
    for line in lines:
        words = shlex.split(line.removeprefix("$ "), comments=True)
        if words:
            _command(words, run=not is_read_only(example))


def _command(words: list[str], *, run: bool) -> None:
    while re.fullmatch(r"\w+=.*", words[0]):
        words = words[1:]  # the environment
    program = Path(words[0]).name
    if program == "mbtl" and not set(words) & set("|>;&"):
        invoke(words[1:]) if run else read(words[1:])
    elif program == "make":
        targets = re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), re.M)
        assert {word for word in words[1:] if "=" not in word} <= set(targets), words
    elif program in ("pip", "uv") and "install" in words:
        known = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
        for word in words:
            ours = re.match(r"mbtl\[(.*)\]", word)
            assert ours is None or set(ours[1].split(",")) <= set(known["optional-dependencies"])
    elif program in ("netgenerate", "netconvert"):
        if run:
            found = Path(sys.executable).with_name(program)
            subprocess.run([found, *words[1:]], check=True, capture_output=True)
    elif program == "python" and len(words) > 1 and words[1].endswith(".py"):
        script = next(f for f in (Path(words[1]), ROOT / words[1]) if f.exists())
        if run:
            subprocess.run([sys.executable, script, *words[2:]], check=True, capture_output=True)
    else:
        assert not run, f"{words[0]!r} is not run in tests: mark the block with <!-- not run: -->"


def invoke(words: list[str]) -> None:
    """Run `mbtl`, as its own errors would end it."""
    from typer.testing import CliRunner

    from mbtl.cli.app import app

    result = CliRunner().invoke(app, words)
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert result.exit_code == 0, f"mbtl {shlex.join(words)}: {result.output}"


def read(words: list[str], *, whole: bool = True) -> None:
    """Let `mbtl` read a command with its options, and do nothing.

    Args:
        words: what follows `mbtl`.
        whole: nothing that the command needs may be missing, which a sentence may leave out.
    """
    from typer.main import get_command

    from mbtl.cli.app import app

    command: Any = get_command(app)
    while words and hasattr(command, "commands"):
        found = command.get_command(None, words[0])
        assert found is not None, f"mbtl knows no command {words}"
        command, words = found, words[1:]
    if "--help" in words or hasattr(command, "commands"):
        return
    try:
        command.make_context(command.name, list(words))
    except Exception as error:
        if whole or not re.search("Missing parameter|requires an argument", str(error)):
            raise


def parse(page: Path) -> Document:
    """The examples of a page."""
    kinds = {"python": python, "bash": bash, "xml": xml}
    parsers = [CodeBlockParser(language, evaluate) for language, evaluate in kinds.items()]
    return Sybil(parsers).parse(page)


def execute(page: Path) -> None:
    """All blocks of a page, in the working folder."""
    document = parse(page)
    document.namespace.update(examples=ROOT / "examples", numpy=numpy)
    for example in document.examples():
        example.evaluate()
