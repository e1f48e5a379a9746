"""Films of one episode: what a policy does, with clock, speed and score, beside a baseline."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mbtl.errors import InvalidInput

_RATE = 10
"""Pictures per second."""
_LONGEST = 30
"""Seconds of a film; longer episodes run faster in it."""
_MOST = _RATE * _LONGEST
_BAND, _GAP, _LEGEND = 82, 8, 30
"""Pixels of the words above a picture, between two pictures, and of the legend under all."""
_COLOURS = 128
"""Of a film."""
_NARROW = 560
"""Pixels that words need at least."""


@dataclass(frozen=True)
class Picture:
    """One look at an episode.

    Attributes:
        image: as the simulator draws it.
        when: seconds since the episode began; decisions where the simulator has no clock.
        speed: mean speed of all cars [m/s]; NaN where there are none.
        gained: sum of the rewards so far.
    """

    image: Any
    when: float
    speed: float
    gained: float


class Watched:
    """An environment whose episodes are seen to their end; pictures are kept of the first.

    It tells `on_look` where it is after every decision. An episode is played as it comes: kinds of
    luck that an evaluation plays one of each (`strata`) are hidden.

    Attributes:
        env: the environment.
        metrics: what stands beside a score: unit by its name in the last step's info.
        rows: every decision: its episode and number, what was seen before, what was done, the
            reward, and the numbers of `info`; empty unless `noting`.
        pictures: of the first episode, if it is filmed: first, last, and at most `2 * _MOST` in
            all, evenly spread over its decisions.
        has_clock: the environment says what time it is in a picture.
        ends: what the last step of each episode said.
        scores: of the episodes, once they are known.
    """

    strata = ()

    def __init__(
        self,
        env: Any,
        filming: bool,
        on_look: Callable[[str], None] = lambda where: None,
        metrics: Mapping[str, str] | None = None,
        unit: str | None = None,
        *,
        noting: bool = False,
    ) -> None:
        self.env, self._filming, self._on_look = env, filming, on_look
        self._unit, self._noting, self._seen = unit, noting, None
        self.rows: list[dict[str, Any]] = []
        self.metrics = metrics or {}
        self.pictures: list[Picture] = []
        self.ends: list[dict[str, Any]] = []
        self.scores: list[float] = []
        self.has_clock = False
        self._decisions, self._looks, self._every = 0, 0, 1
        self._gained, self._begun = 0.0, 0.0

    def __getattr__(self, name: str) -> Any:
        return getattr(self.env, name)

    def reset(self, **options: Any) -> Any:
        """Begin an episode, and look."""
        self._decisions, self._gained = 0, 0.0
        self._simulator.watcher = None  # what passes before the first decision is not seen
        started = self.env.reset(**options)
        self._seen = started[0]
        over = self._is_team and not self.env.agents
        self._look(last=over)
        if self._films:
            self._simulator.watcher = self._look
        if over:
            self._ended(self.env.summary)
        return started

    def step(self, action: Any) -> Any:
        """One decision, and look."""
        *moved, info = self.env.step(action)
        if self._noting:
            self._note(action, moved[1], next(iter(info.values()), {}) if self._is_team else info)
        self._seen = moved[0]
        self._decisions += 1
        reward, terminated, truncated = moved[1:4]
        self._gained += float(
            np.mean([*reward.values()] or [0.0]) if isinstance(reward, dict) else reward
        )
        over = not self.env.agents if self._is_team else terminated or truncated
        self._look(last=over)
        if over:
            self._ended(next(iter(info.values()), {}) if self._is_team else info)
        return *moved, info

    @property
    def unit(self) -> str:
        """Of the score."""
        return str(getattr(self.env, "SCORE", "return")) if self._unit is None else self._unit

    def measures(self, episode: int) -> dict[str, tuple[float, str]]:
        """What stands beside the score of an episode: value and unit by name."""
        end = self.ends[episode]
        return {n: (float(end[n]), unit) for n, unit in self.metrics.items() if n in end}

    # ---- inside ------------------------------------------------------------------------------

    @property
    def _is_team(self) -> bool:
        return hasattr(self.env, "possible_agents")

    @property
    def _simulator(self) -> Any:
        return getattr(self.env, "unwrapped", self.env)

    @property
    def _films(self) -> bool:
        return self._filming and not self.ends

    def _note(self, action: Any, reward: Any, info: Mapping[str, Any]) -> None:
        """One decision as a row of numbers; of a team its mean reward."""
        alone = {} if self._is_team else {"seen": self._seen, "done": action}
        told = {k: v for k, v in info.items() if isinstance(v, (int, float, np.number))}
        self.rows.append(
            {
                "episode": len(self.ends) + 1,
                "decision": self._decisions + 1,
                "reward": float(np.mean([*reward.values()] if self._is_team else reward)),
                **{
                    f"{name} {i}": float(x)
                    for name, part in alone.items()
                    if not isinstance(part, (dict, tuple))
                    for i, x in enumerate(np.ravel(part))
                },
                **told,
            }
        )

    def _ended(self, info: Mapping[str, Any]) -> None:
        self.ends.append(dict(info))
        self._simulator.watcher = None

    def _look(self, last: bool = False) -> None:
        self._on_look(f"episode {len(self.ends) + 1}, decision {self._decisions}")
        if not self._films:
            return
        first = not self.pictures
        self._looks += 1
        if not (first or last) and self._looks % self._every:
            return
        drawn = None
        with suppress(NotImplementedError):  # of Gymnasium, where there is no render
            drawn = self.env.render()
        if drawn is None:
            raise InvalidInput(
                "--film needs environments with render_mode='rgb_array', got one whose render "
                "draws nothing; let it return a picture, or see the numbers: --csv FILE"
            )
        image = np.asarray(drawn).copy()
        sight = getattr(self.env, "sight", None)
        self.has_clock = sight is not None
        clock, speed = (float(self._looks), math.nan) if sight is None else sight
        self._begun = clock if first else self._begun
        self.pictures.append(Picture(image, clock - self._begun, speed, self._gained))
        if len(self.pictures) >= 2 * _MOST:  # too many for a film: look half as often
            del self.pictures[1:-1:2]
            self._every *= 2


def save_film(
    file: Path,
    title: str,
    takes: Mapping[str, Watched],
    on_picture: Callable[[int, int], None] = lambda drawn, planned: None,
) -> int:
    """Write a GIF of some takes side by side, on one clock, each with its name, speed and score.

    Every picture shows all takes at the same moment; a take that has ended keeps its last one. Wide
    pictures stand below each other. It lasts `_LONGEST` seconds at most.

    Args:
        file: to write.
        title: problem and context.
        takes: name -> what was watched; each has one picture or more.
        on_picture: told how many pictures were drawn, of how many.

    Returns:
        Number of pictures.
    """
    end = max(take.pictures[-1].when for take in takes.values())
    length = min(_MOST, max(len(take.pictures) for take in takes.values()))
    moments = np.linspace(0.0, end, length) if length > 1 else np.array([end])
    legend = next(iter(takes.values())).env
    words = tuple(getattr(legend, "LEGEND", ()))
    seconds = all(take.has_clock for take in takes.values())
    pace = f"{end * _RATE / (length - 1):.0f} times real time" if seconds and length > 1 else ""
    frames = []
    for k, moment in enumerate(moments.tolist()):
        shown = [_captioned(f"{title}: {name}", take, moment) for name, take in takes.items()]
        frames.append(_beside(shown, words, pace))
        on_picture(k + 1, length)
    first, *rest = frames
    first.save(file, save_all=True, append_images=rest, duration=1000 // _RATE, loop=0)
    return length


def caption(take: Watched, moment: float) -> tuple[str, str]:
    """What is said of a moment: clock and speed, and below the score once the episode has ended."""
    picture = _picture(take, moment)
    ended = picture is take.pictures[-1]
    parts, worth = [], []
    if take.has_clock:
        parts.append(f"ended at {picture.when:.0f} s" if moment > picture.when and ended
                     else f"{moment:.0f} s")  # fmt: skip
    if math.isfinite(picture.speed):
        parts.append(f"mean speed now {picture.speed:.1f} m/s")
    elif not take.has_clock:
        parts.append(f"return so far {picture.gained:.0f}")
    if ended and take.scores:
        score = f"{take.scores[0]:.2f}"
        named = take.unit == "return"  # it says all
        worth.append(f"return {score}" if named else f"score {score} {take.unit}")
        worth += [f"{value:.4g} {unit}" for value, unit in take.measures(0).values()]
    return "   ".join(parts), "   ".join(worth)


def _picture(take: Watched, moment: float) -> Picture:
    """The latest that was taken by then."""
    known = [picture.when for picture in take.pictures]
    return take.pictures[max(bisect_right(known, moment + 1e-6) - 1, 0)]


def _captioned(name: str, take: Watched, moment: float) -> Any:
    from PIL import Image, ImageDraw

    seen = Image.fromarray(_picture(take, moment).image)
    width = max(seen.width, _NARROW)
    framed = Image.new("RGB", (width, seen.height + _BAND), "white")
    framed.paste(seen, ((width - seen.width) // 2, _BAND))
    pen = ImageDraw.Draw(framed)
    _write(pen, 3, name, (20, 20, 20), width)
    for top, words in zip((29, 55), caption(take, moment), strict=True):
        _write(pen, top, words, (20, 60, 160), width)
    return framed


def _write(pen: Any, top: int, words: str, colour: tuple[int, int, int], width: int) -> None:
    """Words in the largest letters that fit."""
    from PIL import ImageFont

    sizes = (20, 18, 16, 14, 12, 10)
    fonts = [ImageFont.load_default(size) for size in sizes]
    font = next((f for f in fonts if pen.textlength(words, font=f) <= width - 12), fonts[-1])
    pen.text((6, top), words, fill=colour, font=font)


def _beside(
    images: list[Any], legend: tuple[tuple[tuple[int, int, int], str], ...], pace: str
) -> Any:
    """Several pictures as one, in few colours, above a legend."""
    from PIL import Image, ImageDraw, ImageFont

    across = images[0].width <= 1.5 * images[0].height
    sizes = [(one.width, one.height) for one in images]
    spare = _GAP * (len(images) - 1)
    width = sum(w for w, _ in sizes) + spare if across else max(w for w, _ in sizes)
    height = max(h for _, h in sizes) if across else sum(h for _, h in sizes) + spare
    under = _LEGEND if legend or pace else 0
    whole, at = Image.new("RGB", (width, height + under), "white"), 0
    for one in images:
        whole.paste(one, (at, 0) if across else (0, at))
        at += (one.width if across else one.height) + _GAP
    pen, font, x = ImageDraw.Draw(whole), ImageFont.load_default(16), 6
    for colour, words in legend:
        pen.rectangle((x, height + 10, x + 14, height + 22), fill=colour, outline=(90, 90, 90))
        pen.text((x + 20, height + 6), words, fill=(20, 20, 20), font=font)
        x += 40 + int(pen.textlength(words, font=font))
    pen.text((x, height + 6), pace, fill=(20, 60, 160), font=font)
    return whole.convert("P", palette=Image.Palette.ADAPTIVE, colors=_COLOURS)
