"""Build wheel and sdist, look into them, and use them as a stranger would.

    make release-check                       everything: minutes
    python tools/release_check.py --build    build and look only: seconds

What is built is the last commit, in a folder of its own: what is not committed is not released, and
no leftovers are. Then, each in a clean environment and an empty folder:

- Python 3.11, 3.12 and 3.13: import, `mbtl --help`, `mbtl bench` on a shipped matrix;
- the newest of them with the extras `jax` and `plots`: `mbtl run` to its end, twice;
- the oldest with the oldest dependencies that pyproject.toml allows: the tests of the core, without
  any extra, from the sdist; and `mbtl run` with the oldest of `jax` and `plots`.

Needs uv, which finds the interpreters or gets them.
"""

from __future__ import annotations

import argparse
import io
import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
import time
import zipfile
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PYTHONS = ("3.11", "3.12", "3.13")
LIMIT = 20_000_000
"""Bytes of a wheel; data beyond it belong outside the package, fetched by a command with a hash."""

NEEDED = (
    "mbtl/py.typed",
    "mbtl/plot/mbtl.mplstyle",
    "mbtl/report/page/page.html",
    "mbtl/report/page/page.css",
    "mbtl/report/page/page.js",
    "mbtl/zoo/benchmark/data/LICENSE.md",
    "mbtl/zoo/benchmark/data/published.csv",
)
IN_SDIST = ("pyproject.toml", "README.md", "CHANGELOG.md", "LICENSE", "CITATION.cff", "Makefile")
FOLDERS = ("tests", "tools", "examples", "benchmarks", "evidence")
MACHINE_PATH = re.compile(rb"(?<![\w.\]>~])/(?:home|root|Users|work|tmp|opt)/[\w./-]+")
CORE_TESTS = (
    "test_contexts.py", "test_acquisition.py", "models", "selectors", "portfolio", "zoo/benchmark",
    "study/test_study.py", "study/test_leases.py", "study/test_storage.py",
    "test_objective.py", "test_history.py", "test_files.py", "test_seeds.py",
    "test_routing.py", "test_missing_extras.py",
)  # fmt: skip


class Refused(Exception):
    """The release must not go out like this; the message says why."""


def main() -> None:
    """Check a release; the first thing that is wrong ends it."""
    parser = argparse.ArgumentParser(description="Build a release and check it.")
    parser.add_argument("--build", action="store_true", help="build and look only")
    parser.add_argument("--python", action="append", choices=PYTHONS, help="only this one; repeats")
    options = parser.parse_args()
    try:
        with tempfile.TemporaryDirectory() as place:
            wheel, sdist = build(Path(place), ROOT / "dist")
            check_wheel(wheel, shipped())
            check_sdist(sdist)
            if not options.build:
                use(wheel, sdist, Path(place), options.python or PYTHONS)
    except Refused as reason:
        sys.exit(f"release-check: {reason}")
    print("release-check: all is well; in dist/:", wheel.name, sdist.name)


# ---- what is built ----------------------------------------------------------------------------


def shipped() -> set[str]:
    """Names, in the wheel, of every file of the package that is committed."""
    names = output("git", "ls-files", "src/mbtl", cwd=ROOT).splitlines()
    return {name.removeprefix("src/") for name in names}


def build(place: Path, dist: Path) -> tuple[Path, Path]:
    """Wheel and sdist of the last commit; the wheel comes from the sdist."""
    source = place / "source"
    source.mkdir()
    with tarfile.open(fileobj=io.BytesIO(archive())) as tree:
        tree.extractall(source, filter="data")
    shutil.rmtree(dist, ignore_errors=True)
    output(uv(), "build", "--quiet", "--out-dir", str(dist), cwd=source)
    (wheel,), (sdist,) = dist.glob("*.whl"), dist.glob("*.tar.gz")
    print(f"{wheel.name}: {wheel.stat().st_size / 1e6:.1f} MB")
    print(f"{sdist.name}: {sdist.stat().st_size / 1e6:.1f} MB")
    return wheel, sdist


def check_wheel(wheel: Path, committed: set[str]) -> None:
    """Everything that is committed is in it and nothing else; no path of a machine; not too large.

    Raises:
        Refused: one of these does not hold.
    """
    size = wheel.stat().st_size
    if size > LIMIT:
        raise Refused(
            f"the wheel may have {LIMIT:,} bytes, has {size:,}; keep the largest matrices out of "
            "the package and fetch them by a command that checks their hash"
        )
    with zipfile.ZipFile(wheel) as content:
        names = {n for n in content.namelist() if ".dist-info/" not in n}
        for kind, wrong in (
            ("does not have", ({*committed, *NEEDED}) - names),
            ("has, although not committed,", names - committed),
        ):
            if wrong:
                raise Refused(
                    f"the wheel {kind} {len(wrong)} files: {', '.join(sorted(wrong)[:5])}"
                )
        for name in content.namelist():
            for where, data in parts(name, content.read(name)):
                if found := MACHINE_PATH.search(data):
                    raise Refused(f"{where} names a path of a machine: {found[0].decode()}")


def parts(name: str, data: bytes) -> Iterator[tuple[str, bytes]]:
    """What can be read in a file: itself, or the members of an archive of arrays."""
    if not name.endswith(".npz"):
        yield name, data
        return
    with zipfile.ZipFile(io.BytesIO(data)) as arrays:
        for member in arrays.namelist():  # numpy keeps text with four bytes per character
            yield f"{name}, {member}", arrays.read(member).replace(b"\0", b"")


def check_sdist(sdist: Path) -> None:
    """Tests, examples and tools are in it, so that a packager can check what is packaged.

    Raises:
        Refused: something is missing.
    """
    with tarfile.open(sdist) as content:
        names = {name.partition("/")[2] for name in content.getnames()}
    wanted = output("git", "ls-files", *FOLDERS, cwd=ROOT).splitlines()
    if missing := {*IN_SDIST, *wanted} - names:
        raise Refused(f"the sdist lacks {', '.join(sorted(missing)[:5])}; see MANIFEST.in")


# ---- what it is like to use -------------------------------------------------------------------


def use(wheel: Path, sdist: Path, place: Path, pythons: tuple[str, ...] | list[str]) -> None:
    """The wheel in clean environments: several Pythons, the newest and the oldest dependencies."""
    for version in pythons:
        python = environment(place / f"python{version}", version)
        install(python, str(wheel))
        basics(python, place)
        print(f"Python {version}: import, --help and bench work")
    install(python, f"{wheel}[jax,plots]")
    whole_run(python, place / "run")
    print(f"Python {version} with jax and plots: a run works, and is there when repeated")

    with tarfile.open(sdist) as content:
        content.extractall(place, filter="data")
    source = place / sdist.name.removesuffix(".tar.gz")
    oldest = environment(place / "oldest", PYTHONS[0])
    install(oldest, "--resolution", "lowest-direct", "-r", str(source / "pyproject.toml"))
    install(oldest, "--no-deps", str(wheel))
    basics(oldest, place)
    install(oldest, "pytest", "pytest-timeout", "hypothesis")
    tests = [f"tests/{name}" for name in CORE_TESTS]
    # what old versions find deprecated in each other is not ours to mend
    quiet = ("-W", "ignore::DeprecationWarning", "-p", "no:cacheprovider", "-m", "not long")
    output(oldest, "-m", "pytest", *quiet, *tests, cwd=source)
    print("the oldest dependencies: the tests of the core pass without extras")

    extras = ("--extra", "jax", "--extra", "plots")
    oldest = environment(place / "oldest-extras", PYTHONS[0])
    install(oldest, "--resolution", "lowest-direct", "-r", str(source / "pyproject.toml"), *extras)
    install(oldest, "--no-deps", str(wheel))
    whole_run(oldest, place / "run-oldest")
    print("the oldest jax and plots: a run works, and is there when repeated")


def basics(python: str, place: Path) -> None:
    """What works without any extra."""
    empty = Path(tempfile.mkdtemp(dir=place))
    where = output(python, "-c", "import mbtl; print(mbtl.__file__)", cwd=empty).strip()
    if not Path(where).is_relative_to(Path(python).parents[1]):
        raise Refused(f"the wheel should be imported, but {where} was")
    mbtl = str(Path(python).with_name("mbtl"))
    output(mbtl, "--help", cwd=empty)
    rivals = "random,mbtl,specialists"
    words = ("bench", "--matrix", "cartpole-length", "--selectors", rivals, "--json")
    found = json.loads(output(mbtl, *words, "--budget", "4", "--seeds", "1", cwd=empty))
    if {row["selector"] for row in found["results"]} != {*rivals.split(",")}:
        raise Refused(f"mbtl bench gave {found['results']}")


def whole_run(python: str, folder: Path) -> None:
    """The main job, in an empty folder; repeated it has nothing left to do."""
    folder.mkdir()
    command = [str(Path(python).with_name("mbtl")), "run", "cartpole-length", "--json"]
    first = json.loads(output(*command, cwd=folder))
    if not first["fresh_value"] > 0.99:
        raise Refused(f"mbtl run cartpole-length ended at V = {first['fresh_value']} instead of 1")
    if json.loads(output(*command, cwd=folder))["picks"] != first["picks"]:
        raise Refused("mbtl run, repeated, did not show the same picks")
    for name in ("study.db", "portfolio/portfolio.json", "curve.png", "policy-map.png"):
        if not list(folder.glob(f"runs/*/{name}")):
            raise Refused(f"mbtl run left no {name}")


# ---- tools ------------------------------------------------------------------------------------


def uv() -> str:
    """The uv of this machine, or of .venv."""
    found = shutil.which("uv", path=f"{os.environ['PATH']}:{ROOT / '.venv/bin'}")
    if found is None:
        raise Refused("uv is needed and is not there; run: .venv/bin/python -m pip install uv")
    return found


def environment(place: Path, version: str) -> str:
    """The interpreter of a clean virtual environment; pyenv's own, which uv does not look for."""
    pyenv = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv"))
    there = sorted(pyenv.glob(f"versions/{version}.*/bin/python"))
    base = str(there[-1]) if there else version
    output(uv(), "venv", "--quiet", "--python", base, str(place), cwd=ROOT)
    return str(place / "bin" / "python")


def install(python: str, *what: str) -> None:
    """Install into an environment, without this project's pins."""
    output(uv(), "pip", "install", "--quiet", "--python", python, *what, cwd=Path(python).parent)


def archive() -> bytes:
    """The last commit as a tar file."""
    return subprocess.run(
        ["git", "archive", "HEAD"], cwd=ROOT, check=True, capture_output=True
    ).stdout


def output(*command: str, cwd: Path) -> str:
    """What a command prints; it sees neither this folder's sources nor another environment.

    Raises:
        Refused: it failed; the message has what it said last.
    """
    ours = ("PYTHONPATH", "PYTHONDONTWRITEBYTECODE", "VIRTUAL_ENV", "UV_CONSTRAINT", "UV_PYTHON")
    settings = {name: value for name, value in os.environ.items() if name not in ours}
    begun = time.monotonic()
    done = subprocess.run(command, cwd=cwd, env=settings, capture_output=True, text=True)
    if done.returncode:
        raise Refused(f"failed: {' '.join(command)}\n{(done.stdout + done.stderr)[-3000:]}")
    if (seconds := time.monotonic() - begun) > 5:
        print(f"  {seconds:4.0f} s  {Path(command[0]).name} {' '.join(command[1:4])}", flush=True)
    return done.stdout


if __name__ == "__main__":
    main()
