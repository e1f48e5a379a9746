"""The film in the README: the terminal of a run, and the page that `mbtl report` makes of it.

    CHROMIUM=/usr/bin/chromium .venv/bin/python tools/film.py docs/images/film.gif

Every line and every picture in it comes from the commands that it shows, run now in an empty
folder; only waiting is shortened. Needs the extras `jax` and `plots`, and a Chromium.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from textwrap import wrap

import matplotlib
from PIL import Image, ImageDraw, ImageFont

ROOT = Path(__file__).resolve().parents[1]
SIZE = WIDTH, HEIGHT = 900, 560
SECONDS = 45.0
MARGIN, LINE, LETTERS = 16, 18, 13
COLUMNS, ROWS = 108, 29
PAPER, INK, PROMPT, FAINT = "#101418", "#d7dde3", "#7fd1a0", "#8a949e"
COLOURS = 64
LIMIT = 1_500_000

RUN = "mbtl run pendulum-mass --budget 4"
BENCH = "mbtl bench --matrix pendulum-mass --selectors random,greedy,specialists --budget 5"
REPORT = "mbtl report runs/pendulum-mass-full-seed0 -o report.html"

Frame = tuple[Image.Image, float]
"""A picture, and how many seconds it stands."""

SHOWN = """
  const root = document.documentElement;
  const pause = (ms) => new Promise((done) => setTimeout(done, ms));
  const until = async (is) => { for (let i = 0; i < 1200 && !is(); i++) await pause(50); };
  const seen = (part) => document.querySelector(`article:not([hidden]) [data-chart="${part}"]`);
  await until(() => root.dataset.ready);
"""


def main() -> None:
    """Write the film to the path that is given."""
    if len(sys.argv) != 2:
        sys.exit("usage: tools/film.py FILM.gif")
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        frames = [*terminal(RUN, place, line=0.9, end=11.0)]
        frames += terminal(BENCH, place, line=0.15, end=9.0)
        frames += terminal(REPORT, place, line=0.5, end=2.5)
        frames += pages(place)
    save(frames, Path(sys.argv[1]))


# ---- the terminal -----------------------------------------------------------------------------


def terminal(command: str, place: Path, *, line: float, end: float) -> Iterator[Frame]:
    """A command that is typed, and what it prints, a line at a time."""
    for n in range(0, len(command), 6):
        yield screen([], command[:n]), 0.2
    yield screen([], command), 0.8
    printed: list[str] = []
    for text in output(command, place):
        printed.append(text)
        # the first lines are what one waits for; a table comes at once
        yield screen(printed, command), line if text.startswith("pick ") else 0.05
    yield screen(printed, command), end


def output(command: str, place: Path) -> list[str]:
    """What a command prints, both streams together, as it comes."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    settings = os.environ | {"COLUMNS": str(COLUMNS), "PYTHONUNBUFFERED": "1", "PATH": path}
    done = subprocess.run(
        command.split(), cwd=place, env=settings, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, check=True,
    )  # fmt: skip
    lines = done.stdout.rstrip().splitlines()
    return [part for text in lines for part in wrap(text, COLUMNS, drop_whitespace=False) or [""]]


def screen(printed: list[str], command: str) -> Image.Image:
    """The last lines of a terminal."""
    image = Image.new("RGB", SIZE, PAPER)
    draw = ImageDraw.Draw(image)
    lines = [f"$ {command}", *printed][-ROWS:]
    for row, text in enumerate(lines):
        place = (MARGIN, MARGIN + row * LINE)
        if text.startswith("$ "):
            draw.text(place, "$", font=FONT, fill=PROMPT)
            draw.text((MARGIN + 2 * FONT.getlength("x"), place[1]), text[2:], font=BOLD, fill=INK)
        else:
            draw.text(place, text, font=FONT, fill=FAINT if set(text) == {"─"} else INK)
    return image


def font(name: str) -> ImageFont.FreeTypeFont:
    """One of the fonts that come with matplotlib."""
    return ImageFont.truetype(f"{matplotlib.get_data_path()}/fonts/ttf/{name}.ttf", LETTERS)


FONT, BOLD = font("DejaVuSansMono"), font("DejaVuSansMono-Bold")


# ---- the page ---------------------------------------------------------------------------------


def pages(place: Path) -> Iterator[Frame]:
    """The report in a browser, scrolled through."""
    sys.path.insert(0, str(ROOT / "tests"))
    from report.browser import Browser

    browser = Browser(place / "profile")
    try:
        browser.screen(*SIZE)
        browser.call("Page.navigate", url=(place / "report.html").as_uri())
        browser.run("while (document.readyState !== 'complete') await new Promise(setTimeout);")

        def shot(program: str, seconds: float) -> Frame:
            browser.run(f"{SHOWN} {program}; await pause(400);")
            path = place / "page.png"
            browser.picture(path)
            return Image.open(path).convert("RGB"), seconds

        def part(name: str) -> str:
            centred = 'scrollIntoView({ block: "center" }); window.scrollBy(0, -30)'
            return f'seen("{name}").{centred}; await until(() => seen("{name}").data);'

        yield shot("window.scrollTo(0, 0)", 5.0)
        yield shot(part("curve"), 6.0)
        yield shot(part("policies"), 5.0)
        yield shot(part("heat"), 5.0)
    finally:
        browser.close()


# ---- the file ---------------------------------------------------------------------------------


def save(frames: list[Frame], path: Path) -> None:
    """A GIF that lasts `SECONDS`: every frame that stands for long stands in proportion."""
    waits = [seconds for _, seconds in frames if seconds >= 2.0]
    quick = sum(seconds for _, seconds in frames) - sum(waits)
    stretch = (SECONDS - quick) / sum(waits)
    images = [image.quantize(COLOURS, dither=Image.Dither.NONE) for image, _ in frames]
    lasting = [int(1000 * s * (stretch if s >= 2.0 else 1.0)) for _, s in frames]
    images[0].save(
        path, save_all=True, append_images=images[1:], duration=lasting, loop=0, optimize=True
    )
    size = path.stat().st_size
    print(f"{path}: {len(images)} frames, {sum(lasting) / 1000:.0f} s, {size / 1e6:.2f} MB")
    if size > LIMIT:
        sys.exit(f"a film in the README has at most {LIMIT:,} bytes, this has {size:,}")


if __name__ == "__main__":
    main()
