"""A scenario of SUMO's: the files that its configuration names, and what a context changes there.

A context never touches the user's files. What it changes is read into memory and written to another
folder; everything else is used from where it is. What a configuration writes (options with
"output", logs, saved states) is left out, and what additional files write goes to that folder.
"""

from __future__ import annotations

import gzip
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import NamedTuple, Protocol
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from mbtl.contexts import Context, ContextSpace, Value
from mbtl.errors import InvalidInput, check_known, unknown_name

INPUTS = ("net-file", "additional-files", "route-files")
"""Options whose files a context can change, in the order in which SUMO reads them."""
LIGHTS, DEMAND = INPUTS[:2], INPUTS[1:]
"""Where programmes of lights are, of which the last counts, and where types and vehicles are."""
_LONG = {"n": INPUTS[0], "net": INPUTS[0], "a": INPUTS[1], "additional": INPUTS[1]}
_LONG |= {"r": INPUTS[2], "routes": INPUTS[2], "b": "begin", "e": "end"}
_DROPPED = re.compile(
    r"output|log|save-state|netstate|^(summary|tripinfo|vehroutes|seed|random|verbose|v|remote-port"
    r"|num-clients|no-warnings|W|xml-validation|human-readable-time|H)$"
)
"""Options that write files or say how, and those of `Simulation`."""
_WRITES = re.compile(rb"\b(file|dest|output)\s*=")
_READERS = ("variableSpeedSign", "rerouter")
"""Elements whose attribute `file` is read; that of detectors is written."""


class Files:
    """Options and files of a scenario, in memory as far as they are asked for.

    Attributes:
        options: of SUMO by their long names; paths are absolute.
    """

    def __init__(self, options: Mapping[str, str]) -> None:
        self.options = dict(options)
        self._read: dict[Path, Element] = {}

    def paths(self, *names: str) -> list[Path]:
        """The files that options name, in the order in which SUMO reads them."""
        named = ",".join(self.options.get(name, "") for name in names).split(",")
        return [Path(path) for path in named if path]

    def tree(self, path: Path) -> Element:
        """The root of a file, to be changed at will.

        Raises:
            InvalidInput: it cannot be read.
        """
        if path not in self._read:
            try:
                with (gzip.open if path.suffix == ".gz" else open)(path, "rb") as file:
                    self._read[path] = ElementTree.parse(file).getroot()
            except (OSError, ElementTree.ParseError) as error:
                raise InvalidInput(f"a scenario needs XML files, got {path}: {error}") from error
        return self._read[path]

    def every(self, tag: str, *options: str) -> list[Element]:
        """All elements of a tag in the files that options name."""
        return [found for path in self.paths(*options) for found in self.tree(path).iter(tag)]

    def write(self, folder: Path) -> dict[str, str]:
        """Write what was read to a folder; SUMO takes all with the options that are returned."""
        for path in self.paths("additional-files"):
            if _WRITES.search(path.read_bytes()):
                self.tree(path)
        copies = {}
        for number, (path, root) in enumerate(self._read.items()):
            for one in root.iter():
                for name in {"href", "imgFile", "file", "dest", "output"} & {*one.keys()}:
                    read = name in ("href", "imgFile") or one.tag in _READERS
                    value = Path(one.get(name, ""))
                    one.set(name, str(path.parent / value) if read else value.name)
            copies[str(path)] = str(folder / f"{number}-{path.name.removesuffix('.gz')}")
            ElementTree.ElementTree(root).write(copies[str(path)], encoding="utf-8")
        changed = dict(self.options)
        for name in {*INPUTS} & {*changed}:
            changed[name] = ",".join(copies.get(one, one) for one in changed[name].split(","))
        return changed


class Change(Protocol):
    """What an axis changes in a scenario. A change of your own has this one method."""

    def apply(self, files: Files, value: Value) -> None:
        """Change the copy as a value of the axis says.

        Raises:
            InvalidInput: the scenario has no such thing, or it cannot take this value.
        """


class Light(NamedTuple):
    """A traffic light: the lanes that lead to it, and how many phases its programme has."""

    lanes: set[str]
    phases: int


@dataclass(frozen=True)
class Scenario:
    """Files of SUMO's, and what the axes of a context change in them.

    Attributes:
        options: of SUMO by their long names; paths are absolute.
        changes: by name of an axis.
    """

    options: Mapping[str, str]
    changes: Mapping[str, Change]

    @classmethod
    def read(cls, config: str | os.PathLike[str], changes: Mapping[str, Change]) -> Scenario:
        """The scenario of a `.sumocfg`.

        Raises:
            InvalidInput: it cannot be read.
        """
        path, options = Path(config).resolve(), dict[str, str]()
        root = Files({}).tree(path)
        unused = {*root.findall("gui_only/*")}
        for entry in (one for one in root.iter() if one not in unused):
            name, value = _LONG.get(entry.tag, entry.tag), entry.get("value", entry.get("v", ""))
            if value and not _DROPPED.search(name):
                parts = [os.path.expandvars(part.strip()) for part in value.split(",")]
                named = name.endswith(("file", "files", "load-state"))
                options[name] = ",".join(
                    str(path.parent / part) if named else part for part in parts
                )
        return cls(options, dict(changes))

    def check(self, space: ContextSpace) -> None:
        """Try each change with a value of its axis, on a copy in memory.

        Raises:
            UnknownName: the files do not have what is to be changed.
            InvalidInput: axes and changes are not of the same names.
        """
        axes = [axis.name for axis in space.axes]
        if {*axes} != {*self.changes}:
            given = [*self.changes]
            raise InvalidInput(f"each axis has a change of its name, got {axes} and {given}")
        self.files(space.context(0))

    def files(self, context: Context) -> Files:
        """A copy in memory with the changes of a context."""
        files = Files(self.options)
        for name, change in self.changes.items():
            change.apply(files, context[name])
        return files

    @property
    def seconds(self) -> float:
        """From begin to end; 0 without an end."""
        times = [self.options.get(name, "0").split(":")[::-1] for name in ("begin", "end")]
        begin, end = (sum(60.0**k * float(part) for k, part in enumerate(one)) for one in times)
        return end - begin

    @cached_property
    def lights(self) -> dict[str, Light]:
        """Traffic lights whose programme has a green and something else, by name."""
        files, lights = Files(self.options), dict[str, Light]()
        for program in files.every("tlLogic", *LIGHTS):
            states = [phase.get("state", "") for phase in program.iter("phase")]
            if len(states) > 1 and any(map(is_green, states)):
                lights[program.get("id", "")] = Light(set(), len(states))
        for link in files.every("connection", "net-file"):
            name, road = link.get("tl", ""), link.get("from", ":")
            if name in lights and not road.startswith(":"):  # a footpath
                lights[name].lanes.add(f"{road}_{link.get('fromLane')}")
        return lights


def is_green(state: str) -> bool:
    """Whether a phase of a light can be kept: somebody has green, and nobody sees yellow."""
    return "g" in state.lower() and not {"y", "u"} & {*state}


# ---- what an axis can change ---------------------------------------------------------------------


@dataclass(frozen=True)
class Demand:
    """So many times the vehicles of the scenario (SUMO's `--scale`)."""

    def apply(self, files: Files, value: Value) -> None:
        """See `Change`."""
        files.options["scale"] = _text(float(files.options.get("scale", 1)) * float(value))


_FASTEST = 100.0
"""m/s that no road allows."""


@dataclass(frozen=True)
class SpeedLimit:
    """So many times the speed limit of all roads, and of straight ways across their junctions."""

    def apply(self, files: Files, value: Value) -> None:
        """See `Change`."""
        links = files.every("connection", "net-file")
        straight = {link.get("via") for link in links if link.get("dir") == "s"}
        fastest = max(float(lane.get("speed", 0)) for lane in files.every("lane", "net-file"))
        if fastest * float(value) > _FASTEST:
            raise InvalidInput(
                f"SpeedLimit takes a factor, got {value}, which makes {fastest:g} m/s "
                f"{fastest * float(value):g} m/s; divide by the limit, or set speeds by Attribute"
            )
        for edge in files.every("edge", "net-file"):
            for lane in edge.iter("lane"):
                if edge.get("function") != "internal" or lane.get("id") in straight:
                    lane.set("speed", _text(float(lane.get("speed", 0)) * float(value)))


@dataclass(frozen=True)
class Attribute:
    """Any attribute in a network, route or additional file.

        Attribute("city.rou.xml", "vType[@id='car']", "sigma")
        Attribute("city.net.xml", "edge[@id='A1B1']/lane", "speed", multiply=True)

    Attributes:
        file: name of the file, without folder.
        path: of elements below its root, in ElementTree's XPath; all that match are changed.
        attribute: which they have; it is set to the value, or with
        multiply: multiplied by it.
    """

    file: str
    path: str
    attribute: str
    multiply: bool = False

    def apply(self, files: Files, value: Value) -> None:
        """See `Change`."""
        paths = {path.name: path for path in files.paths(*INPUTS)}
        check_known("file of the scenario", self.file, paths)
        root = files.tree(paths[self.file])
        try:
            found = root.findall(f".//{self.path}")
        except (SyntaxError, KeyError, TypeError):  # ElementTree's ways to say that it is no path
            found = []
        if not found:
            tags = {one.tag for one in root.iter()}
            ids = {(one.tag, one.get("id")) for one in root.iter()}
            known = tags | {f"{tag}[@id={id!r}]" for tag, id in ids if id}
            hint = f"Its elements are {', '.join(sorted(tags))}."
            raise unknown_name(f"element of {self.file}", self.path, known, hint=hint)
        for one in found:
            if (old := one.get(self.attribute)) is None:
                raise unknown_name(f"attribute of <{one.tag}>", self.attribute, one.attrib)
            try:
                new = float(old) * float(value) if self.multiply else value
            except ValueError as error:
                raise InvalidInput(f"only numbers are multiplied, got {old!r}; set it") from error
            one.set(self.attribute, _text(new))


@dataclass(frozen=True)
class PhaseDuration:
    """Seconds of one phase of a traffic light's fixed time programme.

    A policy that decides how long a light is green leaves the other phases of it to an axis.

    Attributes:
        light: its name.
        phase: number of the phase, from 0.
    """

    light: str
    phase: int

    def apply(self, files: Files, value: Value) -> None:
        """See `Change`."""
        paths = files.paths(*LIGHTS)
        found = [(path, one) for path in paths for one in files.tree(path).iter("tlLogic")
                 if one.get("id") == self.light]  # fmt: skip
        last = len(found[-1][1].findall("phase")) - 1 if found else None
        if last is not None and not 0 <= self.phase <= last:
            raise InvalidInput(f"the light {self.light!r} has phases 0 to {last}, got {self.phase}")
        own = [path for path, _ in found]
        phase = f"tlLogic[@id={self.light!r}]/phase[{self.phase + 1}]"
        Attribute((own or paths[:1])[-1].name, phase, "duration").apply(files, value)


@dataclass(frozen=True)
class TypeShare:
    """The share of one vehicle type, 0..1, in a `vTypeDistribution`.

    The other types there keep their proportions. A distribution with the id DEFAULT_VEHTYPE holds
    for all vehicles without a type.

    Attributes:
        type: name of the vehicle type.
    """

    type: str

    def apply(self, files: Files, value: Value) -> None:
        """See `Change`."""
        groups = files.every("vTypeDistribution", *DEMAND)
        kinds = {kind.get("id", ""): (kind, group) for group in groups for kind in group}
        if not kinds:
            raise InvalidInput(
                f"the share of a type needs a vTypeDistribution in the demand, got none; put "
                f"{self.type!r} and the others into one"
            )
        check_known("vehicle type in a vTypeDistribution", self.type, kinds)
        share = float(value)
        if not 0.0 <= share <= 1.0:
            raise InvalidInput(f"the share of a type is a number from 0 to 1, got {value!r}")
        own, group = kinds[self.type]
        others = {one: float(one.get("probability", 1)) for one in group if one is not own}
        for one, weight in others.items():
            one.set("probability", _text((1.0 - share) * weight / sum(others.values())))
        own.set("probability", _text(share))


def _text(value: Value) -> str:
    """As SUMO reads it: whole numbers without a point."""
    return value if isinstance(value, str) else f"{value:.12g}"
