"""Is one policy for all better at the best of its evaluations than at the end of its training?

    python evidence/best_marks.py ramp-acc --until 1    # fifteen minutes of a core

Printed is V, the mean over all contexts, at each length in units: the mean and three seeds.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from typing import Any

from widths import EPISODES, for_all

import mbtl


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("cmdp", help="a ring or a ramp: other recipes do not evaluate it")
    parser.add_argument("--until", type=float, default=1.0, help="units")
    args = parser.parse_args()
    cmdp = mbtl.get_cmdp(args.cmdp)
    usual: Any = cmdp.trainer_for()
    for checkpoint, words in (("final", "its end"), ("best", "its best")):
        print(f"{cmdp.id}, one policy for all at {words}", flush=True)
        for_all(cmdp, replace(usual, checkpoint=checkpoint, eval_episodes=EPISODES), args.until)


if __name__ == "__main__":
    main()
