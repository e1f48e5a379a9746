"""No interrupt is lost, wherever it falls."""

import gc
import signal
import sys
import threading

import pytest

from mbtl.cli.common import interrupts
from mbtl.cli.interrupts import keep_interrupts


@pytest.fixture
def kept(monkeypatch):
    """As in the program: our hook and Python's own handler, for this test."""
    monkeypatch.setattr(sys, "unraisablehook", sys.__unraisablehook__)
    interrupts.clear()  # of tests before this one
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    keep_interrupts()
    yield
    signal.signal(signal.SIGINT, before)


def test_an_interrupt_in_a_callback_of_the_garbage_collector_comes_again(kept):
    """jax registers such a callback; Python drops whatever is raised inside."""
    fell = []

    def callback(phase, info):
        if not fell:
            fell.append(phase)
            raise KeyboardInterrupt

    gc.callbacks.append(callback)
    try:
        with pytest.raises(KeyboardInterrupt):  # noqa: PT012  the second line is where it comes
            gc.collect()
            threading.Event().wait(60)
    finally:
        gc.callbacks.remove(callback)
    assert fell


def test_other_errors_there_are_shown_as_ever(kept, capsys):
    class Careless:
        def __del__(self):
            raise ValueError("in a destructor")

    Careless()
    gc.collect()
    assert "ValueError: in a destructor" in capsys.readouterr().err
