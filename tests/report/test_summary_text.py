"""The printed summary fits a terminal, also with several axes."""

import io

import numpy as np
import pytest
from rich.console import Console

from flat import created
from mbtl.problems import get_cmdp
from mbtl.report import summarise_study
from mbtl.report.text import show_summary


@pytest.fixture(scope="module")
def space():
    return get_cmdp("cartpole-masses-length").space


def test_a_context_of_three_axes_takes_three_lines_of_the_table(space):
    study = created(space, budget=2, bounds=(0.0, 1.0), problem="cartpole-masses-length")
    study.tell(study.ask(), np.linspace(0.1, 0.9, space.n))
    screen = Console(file=io.StringIO(), width=80)
    show_summary(screen, summarise_study(study), space)
    text = screen.file.getvalue()
    assert "\N{HORIZONTAL ELLIPSIS}" not in text, "nothing is cut off"
    first = next(line for line in text.splitlines() if "masspole = 0.1 kg" in line)
    assert first.split()[5] == "0.5000", "V beside the first axis"
    assert "masscart" not in first
