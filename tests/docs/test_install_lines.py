"""What a page tells its readers to install is what its commands and code need."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
OURS = r"mbtl (?:run|check|play|matrix build|matrix multitask) "
NEEDS = {
    "jax": OURS + "(?:cartpole|pendulum|walker|cheetah|ring|ramp|eco|signal)-",
    "envs": OURS + r"(?:walker|cheetah)-|make\(\"(?:HalfCheetah|BipedalWalker)",
    "train": r"CMDP\.from_env|SB3Trainer\(",
    "traffic": OURS + r"(?:ring|ramp|eco|signal)-|netgenerate|mbtl\.cmdps\.traffic|play runs/ring",
    "plots": r"mbtl report|mbtl\.plot\.|--film",
    "frames": r"\.to_frame\(",
    "cluster": r"postgresql|dask",
}
INSTALL = re.compile(r"pip install '(?:mbtl|\.)\[([a-z,]+)\]'")
TEXTS = (ROOT / "README.md", *ROOT.glob("docs/*.md"))
PAGES = sorted(path for path in TEXTS if INSTALL.search(path.read_text()))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_a_page_installs_what_it_uses(page):
    text = page.read_text()
    code = "\n".join(re.findall(r"^```(?:bash|python)\n(.*?)^```", text, re.M | re.S))
    used = {extra for extra, sign in NEEDS.items() if re.search(sign, code)}
    installed = {extra for extras in INSTALL.findall(text) for extra in extras.split(",")}
    assert used <= installed
    if "train" in installed:  # the default on Linux is gigabytes of CUDA
        assert "PyTorch's CPU build first" in text
