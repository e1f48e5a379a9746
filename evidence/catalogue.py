"""The catalogue of CMDPs, docs/catalogue.md, written from the registry; a strip of film per family.

`--films` also plays the first CMDP of each family and keeps five moments of the episode in one
picture: a kept policy of `--policies` (see films.py) where the family is in TRAINED, choices at
random in traffic, both at the nominal context. Half a minute, needs mbtl[traffic,envs].

example: python evidence/catalogue.py --write
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

import films
import numpy as np

from mbtl.problems import CMDP, cmdp_ids, get_cmdp
from mbtl.zoo.benchmark import load_matrix, shipped_matrices
from mbtl.zoo.cmdps.engines import EnvFactory

FILE = films.DOCS / "catalogue.md"
FAMILIES = {
    "cartpole": ("CartPole", "Balance a pole on a cart; Gymnasium's physics, step for step."),
    "pendulum": ("Pendulum", "Swing a pendulum up and hold it; Gymnasium's physics."),
    "walker": ("BipedalWalker", "Walk over rough ground on two legs, in a twin of Box2D's."),
    "cheetah": ("HalfCheetah", "Run as fast as possible, in MuJoCo."),
    "signal": ("Traffic signal", "Switch the lights of one crossing."),
    "eco": ("Eco-driving", "Guide cars to a traffic light: few stops, little fuel, no jam."),
    "ring": ("Ring road", "Advise one of 22 cars on a ring, so that the wave of stops dissolves."),
    "ramp": ("Highway ramp", "Advise cars of a main road where another road joins."),
}
INTRODUCTION = """# The catalogue of CMDPs

**`mbtl run ID` trains on any of these problems.** A *CMDP* is a problem with contexts. The tables
say what varies between them, their number N, and the nominal one, on which people train without
help. *Matrix* is the shipped [transfer matrix](matrices.md), of policies of all contexts unless it
says of how many; `mbtl bench --matrix ID` compares selectors on it in seconds. Those of signals
and eco-driving hold the paper's scores, on other scales than here. *Scale* names the returns that
are performance 0 and 1.

Control is simulated in jax or Gymnasium, traffic in jax or SUMO (`--engine`). Pictures are of the
nominal context: of a trained policy in control, of random choices in traffic
(`python evidence/catalogue.py --write`).
"""
TRAINED = {
    "cartpole": "cartpole-length",
    "pendulum": "pendulum-length",
    "walker": "walker-gravity",
    "cheetah": "cheetah-gravity",
}
"""Family -> the CMDP whose policy is seen."""
MOMENTS = 5
WIDTH = 1200
"""Pixels of a strip."""


def page() -> str:
    """The catalogue in Markdown."""
    lines = [INTRODUCTION]
    every = [get_cmdp(id) for id in cmdp_ids()]
    shipped = set(shipped_matrices())
    assert {_family(cmdp.id) for cmdp in every} <= FAMILIES.keys(), "a family is missing"
    for family, (title, text) in FAMILIES.items():
        members = [cmdp for cmdp in every if _family(cmdp.id) == family]
        lines += [f"## {title}", "", f"{text} {common(members)}", ""]
        if (films.DOCS / "images" / f"film-{family}.png").exists():
            lines += [f"![five moments of {title}](images/film-{family}.png)", ""]
        lines += ["| id | what varies | N | nominal | matrix |"]
        lines += ["|---|---|---|---|---|"]
        lines += [row(cmdp, shipped) for cmdp in members] + [""]
    return "\n".join(lines).rstrip() + "\n"


def common(members: list[CMDP]) -> str:
    """The longest episode and the scale, which are those of the whole family."""
    (horizon,) = {cmdp.horizon for cmdp in members}
    ((low, high),) = {tuple(cmdp.bounds or (0.0, 1.0)) for cmdp in members}
    return f"At most {horizon} decisions; scale {low:g} to {high:g}."


def row(cmdp: CMDP, shipped: set[str]) -> str:
    """One line of a table."""
    varies = "; ".join(_span(cmdp, axis.name) for axis in cmdp.space.axes)
    nominal = ", ".join(f"{value:g}" for value in (cmdp.nominal or {}).values())
    matrix = _matrix(cmdp.id) if cmdp.id in shipped else "-"
    cells = [f"`{cmdp.id}`", varies, cmdp.space.n, nominal, matrix]
    return "| " + " | ".join(map(str, cells)) + " |"


def _matrix(id: str) -> str:
    """What is shipped of it, as in "3 seeds, 20 sources"."""
    found = load_matrix(id)
    seeds = f"{found.n_seeds} seed{'s' * (found.n_seeds > 1)}"
    return seeds if found.sources is None else f"{seeds}, {len(found.sources)} sources"


def _family(id: str) -> str:
    return id.split("-", maxsplit=1)[0]


def _span(cmdp: CMDP, name: str) -> str:
    values = [float(value) for value in cmdp.space.values(name)]
    unit = next(axis.unit for axis in cmdp.space.axes if axis.name == name)
    return f"{name} {min(values):g} to {max(values):g}{'' if unit in ('', '1') else f' {unit}'}"


def of_policy(id: str, folder: Path) -> list[Any]:
    """Moments of an episode of a kept policy."""
    cmdp = films.simulated(id)
    take, _ = films.played(cmdp, cmdp.nominal or {}, folder, 20 * MOMENTS)
    return [picture.image for picture in take.pictures[:: len(take.pictures) // MOMENTS][:MOMENTS]]


def at_random(id: str) -> list[Any]:
    """Moments of an episode of traffic."""
    cmdp = films.simulated(id)
    assert isinstance(cmdp.make_env, EnvFactory)
    options = {**cmdp.make_env.options, "render_mode": "rgb_array"}
    env: Any = replace(cmdp.make_env, options=options)(cmdp.nominal or {})
    env.reset(seed=0)
    space = env.action_space("") if callable(env.action_space) else env.action_space
    space.seed(0)
    alone = not hasattr(env, "agents")
    moments = []
    for step in range(20 * MOMENTS):
        if step % 20 == 10:
            moments.append(np.asarray(env.render()))
        env.step(space.sample() if alone else {name: space.sample() for name in env.agents})
    env.close()
    return moments


def strip(pictures: list[Any]) -> Any:
    """Moments side by side; roads one below the other."""
    from PIL import Image

    moments = [Image.fromarray(picture) for picture in pictures]
    wide = moments[0].width > 3 * moments[0].height
    width = WIDTH if wide else WIDTH // MOMENTS
    height = width * moments[0].height // moments[0].width
    across, down = (0, height + 4) if wide else (width + 4, 0)
    size = (width + (MOMENTS - 1) * across, height + (MOMENTS - 1) * down)
    whole = Image.new("RGB", size, "white")
    for place, moment in enumerate(moments):
        whole.paste(moment.resize((width, height)), (place * across, place * down))
    return whole.convert("P", palette=Image.Palette.ADAPTIVE, colors=64)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", action="store_true", help="docs/catalogue.md")
    parser.add_argument("--films", nargs="*", choices=FAMILIES, help="docs/images/film-*.png")
    parser.add_argument("--policies", type=Path, default=Path("runs"), help="see films.py")
    args = parser.parse_args()
    for family in FAMILIES if args.films == [] else args.films or ():
        id = TRAINED.get(family) or next(id for id in cmdp_ids() if _family(id) == family)
        moments = of_policy(id, args.policies) if family in TRAINED else at_random(id)
        strip(moments).save(films.DOCS / "images" / f"film-{family}.png", optimize=True)
    if args.write:
        FILE.write_text(page(), encoding="utf-8")
    else:
        print(page())


if __name__ == "__main__":
    main()
