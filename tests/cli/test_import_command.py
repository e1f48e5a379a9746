"""`mbtl matrix import`: matrices of others."""

import numpy as np

from mbtl.benchmark import TransferMatrix


def test_the_command_writes_a_file_to_bench_on(mbtl_command, tmp_path):
    np.save(tmp_path / "a.npy", np.arange(36.0).reshape(6, 6))
    command = ("matrix", "import", "a.npy", "--out", "sub/a.npz")
    axes = ("--axis", "inflow=50,100", "--axis", "green=4,8,12")
    code, _, err = mbtl_command(*command, *axes, "--bounds", "-5,500")
    assert (code, "6 contexts, 1 seeds" in err) == (0, True), err
    matrix = TransferMatrix.load(tmp_path / "sub/a.npz")
    assert matrix.space.contexts[4] == {"inflow": 100.0, "green": 8.0}
    assert (matrix.bounds.low, matrix.bounds.high) == (-5.0, 500.0)
    assert mbtl_command("bench", "--matrix", "sub/a.npz", "--budget", 2)[0] == 0
    for wrong, says in [
        ((), "--layout or"),
        (("--axis", "inflow"), "NAME=V1,V2"),
        (("--axis", "inflow=a,b"), "numbers with commas"),
        (("--axis", "inflow=1,2"), "must have shape"),
        ((*axes, "--bounds", "1"), "LOW,HIGH"),
        (("--layout", "walker"), "sd-mbtl-walker"),
    ]:
        code, _, err = mbtl_command(*command, *wrong)
        assert (code, says in err) == (2, True), err
