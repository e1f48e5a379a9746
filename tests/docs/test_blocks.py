"""Every code block of README and docs is executed, or says why it is not."""

import re
import shlex
import sys

import blocks
import pytest

from mbtl.errors import MbtlError

pytest.importorskip("stable_baselines3")
pytest.importorskip("jax")


pages = pytest.mark.parametrize(
    "page", blocks.PAGES, ids=lambda page: str(page.relative_to(blocks.ROOT))
)


@pages
@pytest.mark.usefixtures("undrawn")
def test_the_blocks_of_a_page_run(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    before = set(sys.modules)
    try:
        blocks.execute(page)
    finally:
        for name in set(sys.modules) - before:
            if str(getattr(sys.modules[name], "__file__", "")).startswith(str(tmp_path)):
                del sys.modules[name]


@pages
def test_every_block_says_what_it_is_and_what_a_page_names_exists(page):
    text, known = page.read_text(), blocks.SHOWN | {"python", "bash", "xml"}
    for line, language in blocks.fences(text):
        assert language in known or language.startswith("{"), f"line {line}: {language!r}"
    for name in re.findall(r"\b(?:evidence|benchmarks|examples|tests)/[\w/]+\.py\b", text):
        assert (blocks.ROOT / name).exists(), name
    sentences = re.sub(r"^```.*?^```", "", text, flags=re.S | re.M)
    for span in re.findall(r"`(mbtl [a-z][^`]*)`", sentences):
        blocks.read(shlex.split(span.replace("...", ""))[1:], whole=False)


def test_a_command_that_is_only_read_must_exist():
    blocks.read(["run", "cartpole-length", "--budget", "3"])
    for wrong in (["runn", "x"], ["run", "x", "--budged", "3"], ["study", "list", "--no"]):
        with pytest.raises(Exception, match=r"no command|No such option"):
            blocks.read(wrong)


def test_a_command_that_fails_is_noticed():
    with pytest.raises((AssertionError, MbtlError)):
        blocks.invoke(["cmdps", "no-such-cmdp"])
