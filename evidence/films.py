"""Films of a walker and a cheetah at three contexts, docs/images/film-*.gif, and how to get actors.

`--policies` is a folder with what `mbtl matrix build` or `mbtl run` kept: `runs` after

    mbtl run walker-gravity --budget 1 --preset standard
    mbtl matrix build cheetah-gravity --preset standard --sources-every 5

Each picture is of the kept policy whose source is nearest to its context. Needs mbtl[envs,plots].

example: python evidence/films.py --policies runs --write
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mbtl.envs import rollout
from mbtl.portfolio.archive import load_policy
from mbtl.problems import CMDP, get_cmdp
from mbtl.zoo.cli.film import Watched, save_film
from mbtl.zoo.cmdps.engines import EnvFactory
from mbtl.zoo.cmdps.registry import engines_of

DOCS = Path(__file__).parents[1] / "docs"
FILMS = {
    "walker-gravity": ({"gravity": 4.0}, {"gravity": 10.0}, {"gravity": 16.0}),
    "cheetah-gravity": ({"gravity": 0.981}, {"gravity": 5.886}, {"gravity": 10.791}),
}
LENGTHS = {"walker-gravity": (400, 6), "cheetah-gravity": (120, 2)}
"""Decisions of an episode, of which every so many-th is kept."""
WIDTH = 320
"""Pixels of a picture."""


def watched(cmdp: CMDP, context: Mapping[str, float], steps: int) -> Watched:
    """A filmed environment whose episodes end after so many decisions."""
    assert isinstance(cmdp.make_env, EnvFactory)
    options = {**cmdp.make_env.options, "render_mode": "rgb_array", "horizon": steps}
    return Watched(replace(cmdp.make_env, options=options)(dict(context)), filming=True)


def kept(cmdp: CMDP, context: Mapping[str, float], folder: Path) -> tuple[Any, dict[str, float]]:
    """The policy trained nearest to a context, and where that was.

    Raises:
        SystemExit: there is none.
    """
    name = re.compile(rf"(matrix-)?{cmdp.id}-(full|standard|quick)-seed\d+")
    places = [place for place in folder.glob("*/") if name.fullmatch(place.name)]
    found = {
        int(policy.name.split("-")[1]): policy
        for place in places
        for policy in sorted(place.glob("**/source-*/"))
    }
    if not found:
        raise SystemExit(f"{folder} holds no policies of {cmdp.id}; see --help")
    here = cmdp.space.encode_steps(context)
    source = min(found, key=lambda s: float(np.linalg.norm(cmdp.space.steps[s] - here)))
    return load_policy(found[source], "mlp", None), dict(cmdp.space.context(source))


def simulated(id: str) -> CMDP:
    """A CMDP in its simulator."""
    return get_cmdp(id, engine=engines_of(id)[0])


def played(
    cmdp: CMDP, context: Mapping[str, float], folder: Path, steps: int
) -> tuple[Watched, dict[str, float]]:
    """An episode of the nearest kept policy, and where that was trained."""
    policy, source = kept(cmdp, context, folder)
    take = watched(cmdp, context, steps)
    (scores,) = rollout.play([rollout.Job(lambda: take, [0])], rollout.Actor(policy), max_envs=1)
    take.scores = scores.tolist()
    return take, source


def film(id: str, folder: Path, file: Path) -> int:
    """Three contexts in one film; bytes of the file."""
    from PIL import Image

    cmdp, takes = simulated(id), {}
    steps, every = LENGTHS[id]
    for context in FILMS[id]:
        take, source = played(cmdp, context, folder, steps)
        end = len(take.pictures) - 1
        take.pictures = [p for i, p in enumerate(take.pictures) if i % every == 0 or i == end]
        for number, picture in enumerate(take.pictures):
            image = Image.fromarray(picture.image)
            small = image.resize((WIDTH, WIDTH * image.height // image.width))
            take.pictures[number] = replace(picture, image=np.asarray(small))
        trained = cmdp.space.describe(source).partition(" = ")[2]
        takes[f"{cmdp.space.describe(context)} (trained at {trained})"] = take
    save_film(file, id.partition("-")[0], takes)
    return file.stat().st_size


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--policies", type=Path, default=Path("runs"), help="where they are kept")
    parser.add_argument("--write", action="store_true", help="docs/images/film-*.gif")
    args = parser.parse_args()
    for id in FILMS:
        name = f"film-{id.partition('-')[0]}.gif"
        file = DOCS / "images" / name if args.write else Path(name)
        print(f"{file}: {film(id, args.policies, file) / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
