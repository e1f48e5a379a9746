"""Films of episodes: what a policy does, with clock, speed and score, beside unguided traffic."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

_RATE = 10
"""Pictures per second."""
_BAND, _GAP = 56, 8
"""Pixels of the words above a picture, and between two pictures."""
_COLOURS = 64
"""Of a film."""
_NARROW = 560
"""Pixels that words need at least."""


@dataclass(frozen=True)
class Picture:
    """One look at an episode.

    Attributes:
        image: as the simulator draws it.
        clock: seconds since the episode began; NaN where the simulator has no clock.
        speed: mean speed of all cars [m/s]; NaN where there are none.
        gained: sum of the rewards so far.
        episode: number of the episode, from 0.
    """

    image: Any
    clock: float
    speed: float
    gained: float
    episode: int


class Watched:
    """An environment whose episodes are seen to their end, and which can keep pictures of them.

    It tells `on_look` where it is after every decision.

    Attributes:
        env: the environment.
        pictures: of all decisions of all episodes, if it is filmed.
        scores: of the episodes, once they are known.
    """

    def __init__(
        self, env: Any, filming: bool, on_look: Callable[[str], None] = lambda where: None
    ) -> None:
        self.env, self._filming, self._on_look = env, filming, on_look
        self.pictures: list[Picture] = []
        self.scores: list[float] = []
        self._episode, self._decisions, self._gained, self._begun = -1, 0, 0.0, 0.0

    def __getattr__(self, name: str) -> Any:
        return getattr(self.env, name)

    def reset(self, **options: Any) -> Any:
        """Begin an episode, and look."""
        started = self.env.reset(**options)
        self._episode, self._decisions, self._gained = self._episode + 1, 0, 0.0
        self._look(first=True)
        return started

    def step(self, action: Any) -> Any:
        """One decision, and look."""
        *moved, info = self.env.step(action)
        self._decisions += 1
        reward = moved[1]
        self._gained += float(np.mean([*reward.values()] or [0.0])
                              if isinstance(reward, dict) else reward)  # fmt: skip
        self._look()
        info.pop("final_score", None)  # a score that is known is no reason to look away
        return *moved, info

    @property
    def unit(self) -> str:
        """Of the score."""
        return str(getattr(self.env, "SCORE", "return"))

    def _look(self, first: bool = False) -> None:
        self._on_look(f"episode {self._episode + 1}, decision {self._decisions}")
        if not self._filming:
            return
        image = np.asarray(self.env.render()).copy()
        sight = getattr(self.env, "sight", None)
        clock, speed = (math.nan, math.nan) if sight is None else sight
        self._begun = clock if first else self._begun
        seconds = clock - self._begun
        self.pictures.append(Picture(image, seconds, speed, self._gained, self._episode))


def save_film(file: Path, title: str, takes: Mapping[str, Watched]) -> int:
    """Write a GIF of some takes side by side, each with its name, clock, speed and score.

    Pictures of the same number stand beside each other; a take that has ended keeps its last one.
    Wide pictures stand below each other.

    Args:
        file: to write.
        title: problem and context.
        takes: name -> what was watched; each has one picture or more.

    Returns:
        Number of pictures.
    """
    length = max(len(take.pictures) for take in takes.values())
    frames = [
        _beside([_captioned(f"{title}: {name}", take, i) for name, take in takes.items()])
        for i in range(length)
    ]
    first, *rest = frames
    first.save(file, save_all=True, append_images=rest, duration=1000 // _RATE, loop=0)
    return length


def caption(take: Watched, number: int) -> str:
    """What is said of a picture: clock, speed, and the score once the episode has ended."""
    picture = take.pictures[number]
    later = take.pictures[number + 1 :]
    parts = []
    if math.isfinite(picture.clock):
        parts.append(f"{picture.clock:.0f} s")
    if math.isfinite(picture.speed):
        parts.append(f"mean speed now {picture.speed:.1f} m/s")
    elif not math.isfinite(picture.clock):
        parts.append(f"return so far {picture.gained:.0f}")
    ended = not any(one.episode == picture.episode for one in later)
    if ended and picture.episode < len(take.scores):
        score = f"{take.scores[picture.episode]:.2f}"
        named = take.unit == "return"  # it says all
        parts.append(f"return {score}" if named else f"score {score} {take.unit}")
    return "    ".join(parts)


def _captioned(name: str, take: Watched, number: int) -> Any:
    from PIL import Image, ImageDraw, ImageFont

    number = min(number, len(take.pictures) - 1)
    seen = Image.fromarray(take.pictures[number].image)
    width = max(seen.width, _NARROW)
    framed = Image.new("RGB", (width, seen.height + _BAND), "white")
    framed.paste(seen, ((width - seen.width) // 2, _BAND))
    pen, font = ImageDraw.Draw(framed), ImageFont.load_default(20)
    pen.text((6, 3), name, fill=(20, 20, 20), font=font)
    pen.text((6, 29), caption(take, number), fill=(20, 60, 160), font=font)
    return framed


def _beside(images: list[Any]) -> Any:
    """Several pictures as one, in few colours."""
    from PIL import Image

    across = images[0].width <= 1.5 * images[0].height
    sizes = [(one.width, one.height) for one in images]
    spare = _GAP * (len(images) - 1)
    width = sum(w for w, _ in sizes) + spare if across else max(w for w, _ in sizes)
    height = max(h for _, h in sizes) if across else sum(h for _, h in sizes) + spare
    whole, at = Image.new("RGB", (width, height), "white"), 0
    for one in images:
        whole.paste(one, (at, 0) if across else (0, at))
        at += (one.width if across else one.height) + _GAP
    return whole.convert("P", palette=Image.Palette.ADAPTIVE, colors=_COLOURS)
