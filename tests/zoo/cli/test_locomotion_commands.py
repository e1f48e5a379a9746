"""From training to a matrix that can be benched: every walker and cheetah, by real commands."""

import numpy as np
import pytest

from mbtl.zoo.benchmark import load_matrix

LINES = [f"walker-{axis}" for axis in ("gravity", "friction", "scale")]
LINES += [f"cheetah-{axis}" for axis in ("gravity", "friction", "stiffness")]


@pytest.mark.long
@pytest.mark.parametrize(
    ("id", "every", "n"), [*((id, 33, 3) for id in LINES), ("walker-512", 4, 8)]
)
def test_a_matrix_is_built_shown_and_benched(mbtl_command, id, every, n):
    build = ("matrix", "build", id, "--every", every, "--sources-every", n // 2 + 1, "--seeds", 1,
             "--timesteps", 2048, "--eval-episodes", 2)  # fmt: skip
    mbtl_command.done(*build)
    matrix = load_matrix(id, f"every{every}", folder="matrices")
    assert matrix.returns.shape == (1, 2, n)
    assert len(np.unique(matrix.returns)) > n  # contexts act
    assert set(matrix.references) == {"random_actions", "unguided"}
    file = f"matrices/{id}-every{every}-seed0.npz"
    assert "In the paper 0 is" in mbtl_command.done("matrix", "show", file)
    known = mbtl_command.document("matrix", "show", file)["seeds"][0]
    assert known.keys() > {"random_actions", "unguided", "nominal_policy", "independent"}
    if id.startswith("walker"):  # standing still costs little, and random actions a fall
        assert known["unguided"] > known["random_actions"]
    mbtl_command.done("bench", "--matrix", file, "--selectors", "random,mbtl,oracle",
                                "--budget", 2, "--bounds", "seen")  # fmt: skip
    assert "there already" in mbtl_command(*build)[2]
