"""A population that is interrupted before its first copy trains, beside one that is not."""

import pytest

from mbtl.actions import Population
from mbtl.study.steps.callbacks import StepCallback


class Interrupt(KeyboardInterrupt):
    pass


class StopsACopy(StepCallback):
    """Before the first copy trains, which was decided already."""

    def on_training(self, study, training, source, to):
        if training == 2:
            raise Interrupt


def both(opened, folder):
    """The undisturbed study and the interrupted one, both at their end, with the same starts.

    `opened(folder=None, strategy)` makes a study, or goes on with the one in a folder.
    """
    people = Population(size=2, selector=None)
    calm = opened(strategy=people)
    calm.run(progress=False, report=False)
    with pytest.raises(Interrupt):
        opened(folder, people).run(progress=False, report=False, callbacks=[StopsACopy()])
    study = opened(folder, people)
    study.run(progress=False, report=False)
    starts = [t.start for t in study.state.trainings]
    assert starts[:2] == [None, None]
    assert len(starts) > 2
    assert None not in starts[2:]
    assert starts == [t.start for t in calm.state.trainings]
    return calm, study
