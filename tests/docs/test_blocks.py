"""Every code block of README and docs is executed, or says why it is not."""

import re
import shlex

import blocks
import numpy as np
import pytest

from mbtl.errors import MbtlError

pytest.importorskip("stable_baselines3")
pytest.importorskip("jax")


pages = pytest.mark.parametrize(
    "page", blocks.PAGES, ids=lambda page: str(page.relative_to(blocks.ROOT))
)


@pytest.fixture
def folder(folder, monkeypatch):
    """What a page writes there can be imported."""
    monkeypatch.syspath_prepend(folder)
    return folder


@pages
@pytest.mark.usefixtures("undrawn", "folder")
def test_the_blocks_of_a_page_run(page):
    blocks.execute(page)


@pytest.mark.long
@pytest.mark.usefixtures("undrawn")
@pytest.mark.filterwarnings("ignore")
def test_the_blocks_on_rllib_run_where_it_is_installed(folder):
    pytest.importorskip("ray.rllib")
    text = (blocks.ROOT / "docs" / "rllib.md").read_text()
    shorter = text.replace("<!-- not run: needs ray[rllib]", "<!--").replace("round(12", "round(2")
    (folder / "page.md").write_text(shorter)
    blocks.execute(folder / "page.md")
    import my_poles
    import ray

    contexts, same = my_poles.problem.space.contexts, np.testing.assert_array_equal
    first, again = (my_poles.train(contexts, 7, length=0.5) for _ in range(2))
    on = [my_poles.train(contexts, 7, start=first, length=length) for length in (0.0, 0.5)]
    ray.shutdown()
    for name, weights in first.items():
        same(again[name], weights)
        same(on[0][name], weights)  # it begins with them
    assert any((on[1][name] != weights).any() for name, weights in first.items())
    returns = my_poles.evaluate(first, contexts, range(8))
    same(my_poles.evaluate(first, contexts[4:], range(4, 8)), returns[4:])  # in any company


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
