"""Write what was found into the station file or a sequence. Comments and order are kept; a difference is shown first.

`Proposal.write` checks that the file is still the same, and replaces it in one step. A file that came with Starbench,
or that cannot be written, is never changed: the proposal is then a copy under a new name.
"""

from __future__ import annotations

import difflib
import hashlib
import io
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import BaseModel
from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq
from ruamel.yaml.error import YAMLError
from ruamel.yaml.nodes import ScalarNode
from ruamel.yaml.resolver import VersionedResolver
from ruamel.yaml.tag import Tag

from bench.base.encoding import plain_number
from bench.base.errors import ControlRefused, ScriptError
from bench.plan.plan import SHIPPED_SEQUENCES
from bench.record.storage import write_atomic
from bench.stations.stages_and_lights import GardasoftLightConfig, ScpiLightConfig
from bench.stations.station import SHIPPED_STATIONS, Station
from bench.stations.station_text import TextLightConfig
from sequences.errors import DocumentFaults
from sequences.reader import check_document
from sequences.schema import Sequence as SequenceFile
from sequences.tree import DocumentPath
from sequences.yaml_text import parse

Text = str | tuple[str, ...]
"""YAML text of a value, or of each entry of a list."""
_LAYOUTS = ((2, 2, 0), (2, 4, 2), (4, 4, 0), (4, 4, 2), (4, 6, 4))
"""Indentation of mappings, of lists, and of a list's dash, as files use them."""
POSES = "aligned"
"""List of poses for a sequence that has none to which a pose can be added."""


def station_values(
    station: Station,
    *,
    position_deg: Mapping[str, float] | None = None,
    biases: Mapping[str, int] | None = None,
    frame: Mapping[str, float | None] | None = None,
    level_percent: float | None = None,
    hands: Mapping[str, Any] | None = None,
) -> tuple[dict[DocumentPath, Text], list[str]]:
    """Return what a station file must state, from what a session found; None leaves values as they are.

    ``position_deg``, by axis, shall become zero (`ControlRefused` if it cannot), ``level_percent`` 100 %.
    """
    values: dict[DocumentPath, Text] = {}
    notes = []
    if hands is not None:
        values |= _hand_values(hands)
        notes.append(
            "Lens and mount of the simulated camera stay as they are now: a real bench keeps them by itself."
        )
    for name, angle_deg in (position_deg or {}).items():
        values |= _zero_values(station, name, angle_deg)
    if position_deg:
        notes.append(
            "The limits move with the zero, so that the stage may turn to the same directions as before. The new zero"
            " counts from the next start of align or of a run."
        )
    if biases is not None:
        now = station.camera.biases.model_dump() if hasattr(station.camera, "biases") else {}
        changed = {name: value for name, value in biases.items() if now.get(name) != value}
        values |= {("camera", "biases", name): str(value) for name, value in changed.items()}
    for name, setting in (frame or {}).items():
        if setting is not None and setting != getattr(station.camera, name, None):
            values["camera", name] = plain_number(setting, 6)
    if level_percent is not None and level_percent != 100:
        values |= _level_values(station, level_percent)
        notes.append(f"The present level, {level_percent:g} %, becomes 100 % of this station.")
    return values, notes


def _hand_values(seen: Mapping[str, Any]) -> dict[DocumentPath, Text]:
    """Return how lens and mount of a simulated bench stand, as its station file states them."""
    distance_m = seen["focus_distance_m"]
    turn_deg = tuple(plain_number(float(angle), 4) for angle in seen["turn_deg"])
    return {
        ("simulation", "lens", "focus_distance_m"): distance_m
        if isinstance(distance_m, str)
        else plain_number(float(distance_m), 6),
        ("simulation", "lens", "f_number"): plain_number(float(seen["f_number"]), 3),
        ("simulation", "mount", "turn_deg"): turn_deg,
    }


def _level_values(station: Station, level_percent: float) -> dict[DocumentPath, Text]:
    """Return the full level of the light such that the present level becomes 100 %."""
    match station.light:
        case ScpiLightConfig() as light:
            high_v = light.low_v + (light.high_v - light.low_v) * level_percent / 100
            return {("light", "high_v"): plain_number(high_v, 4)}
        case GardasoftLightConfig() | TextLightConfig() as light:
            return {("light", "full_percent"): plain_number(light.full_percent * level_percent / 100, 3)}
        case _:
            return {}


def _zero_values(station: Station, name: str, angle_deg: float) -> dict[DocumentPath, Text]:
    """Return zero and limits of an axis such that the present angle becomes 0."""
    axis = station.axes[name]
    angle_deg = round(angle_deg, 4)
    if angle_deg == 0:
        return {}
    low, high = (round(limit - angle_deg, 4) for limit in axis.limits_deg)
    if not low <= 0 <= high:
        raise ControlRefused(
            f"{name} is at {angle_deg:g} deg, outside its limits; this cannot become zero.",
            where=name,
            remedy="Turn the axis back into its limits first.",
        )
    place = ("stage", "axes", name)
    return {
        (*place, "zero_deg"): plain_number(axis.zero_deg - angle_deg, 4),
        (*place, "limits_deg"): (plain_number(low, 4), plain_number(high, 4)),
    }


@dataclass(frozen=True)
class Proposal:
    """A change of a file that is not written yet."""

    path: Path  # File that `write` makes or replaces
    source: Path  # File from which the proposal was made; the same as ``path`` unless a copy is made
    before: bytes
    after: bytes
    notes: tuple[str, ...] = ()

    @property
    def is_copy(self) -> bool:
        """Whether a new file is made."""
        return self.path != self.source

    @property
    def mark(self) -> str:
        """Names the change; `write` makes only the one that the person saw."""
        return hashlib.sha256(b"\0".join((str(self.path).encode(), self.before, self.after))).hexdigest()

    @property
    def difference(self) -> str:
        """The changed lines with their surroundings, as `diff -u` shows them; empty if nothing changes."""
        before, after = (text.decode().splitlines() for text in (self.before, self.after))
        return "\n".join(
            difflib.unified_diff(before, after, self.source.name, self.path.name, n=2, lineterm="")
        )

    def as_data(self) -> dict[str, Any]:
        """Return the proposal as the page shows it."""
        return {
            "file": str(self.path),
            "source": str(self.source),
            "is_copy": self.is_copy,
            "difference": self.difference,
            "mark": self.mark,
            "notes": list(self.notes),
        }

    def write(self, mark: str) -> None:
        """Write the file in one step; refused if file or values changed since the person saw ``mark``."""
        where = str(self.path)
        if mark != self.mark:
            raise ControlRefused(
                "The file or the values have changed since the difference was shown. Nothing was written.",
                where=where,
                remedy="Look at the new difference, then write.",
            )
        if self.is_copy and os.path.lexists(self.path):
            raise ControlRefused(
                "A file of this name exists. Nothing was written.", where=where, remedy="Choose another name."
            )
        mode = self.source.stat().st_mode & 0o777
        write_atomic(self.path, self.after, mode=mode | 0o600 if self.is_copy else mode)


def propose_values(
    source: Path, values: Mapping[DocumentPath, Text], model: type[BaseModel], *, target: Path | None = None
) -> Proposal:
    """Propose to set values (YAML text by path) of a file; missing keys are added at the end of their mapping.

    ``target`` is a new file, needed where the source must not be changed (else `ControlRefused`).
    """
    before = _read(source)
    document, yaml = _load(source, before)
    for path, text in values.items():
        _put(document, path, text)
    return _proposal(source, target, before, _dumped(document, yaml), model)


def propose_pose(
    source: Path,
    angles_deg: Mapping[str, float],
    *,
    poses: str | None = None,
    name: str | None = None,
    light: Mapping[str, str] | None = None,
    target: Path | None = None,
) -> Proposal:
    """Propose to add a pose to a list of a sequence (made if missing), and to set its light; nothing is written.

    ``poses`` None is the file's first list; ``light`` YAML text by key of ``defaults.light``; else as `propose_values`.
    """
    before = _read(source)
    document, yaml = _load(source, before)
    if document.get("poses") is None:
        _insert(document, "poses", CommentedMap())
    sets = document["poses"]
    lists = [key for key, value in sets.items() if isinstance(value, CommentedSeq)]
    wanted = poses or (lists[0] if lists else POSES)
    notes = []
    if wanted not in sets:
        _insert(sets, wanted, CommentedSeq())
        notes.append(
            f"No step of this sequence uses the poses {wanted!r} yet. Add: repeat: {{poses: {wanted}, ...}}."
        )
    sequence_poses = sets[wanted]
    if not isinstance(sequence_poses, CommentedSeq):
        raise ControlRefused(
            f"The poses {wanted!r} are a grid; a single pose cannot be added.",
            where=str(source),
            remedy="Name another list of poses, or a new one.",
        )
    pose = CommentedMap()
    if name:
        pose["name"] = name
    for axis, angle_deg in angles_deg.items():
        pose[f"{axis}_deg"] = plain_number(angle_deg, 4)
    pose.fa.set_flow_style()
    sequence_poses.append(pose)
    for key, text in (light or {}).items():
        _put(document, ("defaults", "light", key), text)
    return _proposal(source, target, before, _dumped(document, yaml), SequenceFile, notes)


def must_be_copied(path: Path) -> str:
    """Return why a file must not be changed, a sentence; empty if the file may be changed."""
    folder = path.resolve().parent
    if folder in {SHIPPED_STATIONS.resolve(), SHIPPED_SEQUENCES.resolve()}:
        return "This file came with Starbench and is not changed."
    if not os.access(path, os.W_OK) or not os.access(folder, os.W_OK):
        return "This file cannot be written."
    return ""


class _TextResolver(VersionedResolver):
    """Every scalar is text, as for the strict reader: 0042 and 1.0e-4 keep their form."""

    def resolve(self, kind: Any, value: Any, implicit: Any) -> Any:
        if kind is ScalarNode:
            return Tag(suffix="tag:yaml.org,2002:str")
        return super().resolve(kind, value, implicit)


def _yaml(layout: tuple[int, int, int]) -> YAML:
    yaml = YAML(typ="rt")
    yaml.Resolver = _TextResolver
    yaml.preserve_quotes = True
    yaml.width = 100_000
    yaml.allow_unicode = True
    mapping, sequence, offset = layout
    yaml.indent(mapping=mapping, sequence=sequence, offset=offset)
    return yaml


def _load(source: Path, before: bytes) -> tuple[CommentedMap, YAML]:
    """Read a document for editing, with the layout that changes the fewest lines."""
    faults = parse(before, str(source)).faults
    if faults:
        raise ScriptError([str(fault) for fault in faults])
    lines = before.decode("utf-8-sig").splitlines()

    def changed(layout: tuple[int, int, int]) -> int:
        yaml = _yaml(layout)
        again = _dumped(yaml.load(before), yaml).decode().splitlines()
        return sum(line[0] in "+-" for line in difflib.ndiff(lines, again)) if again != lines else 0

    try:
        best = min(_LAYOUTS, key=changed)
        yaml = _yaml(best)
        document = yaml.load(before)
    except YAMLError as error:
        raise ControlRefused(
            "The file cannot be edited by a program.", where=str(source), remedy="Enter the values by hand."
        ) from error
    if not isinstance(document, CommentedMap):
        raise ControlRefused("The file is not a mapping.", where=str(source), remedy="Name another file.")
    return document, yaml


def _dumped(document: CommentedMap, yaml: YAML) -> bytes:
    stream = io.BytesIO()
    yaml.dump(document, stream)
    return stream.getvalue()


def _put(document: CommentedMap, path: DocumentPath, text: Text) -> None:
    here: Any = document
    for key in path[:-1]:
        if here.get(key) is None:
            inner = CommentedMap()
            inner.fa.set_flow_style()
            _insert(here, str(key), inner)
        here = here[key]
    value: str | CommentedSeq = text if isinstance(text, str) else CommentedSeq(text)
    if isinstance(value, CommentedSeq):
        value.fa.set_flow_style()
    _insert(here, str(path[-1]), value)


def _insert(mapping: CommentedMap, key: str, value: Any) -> None:
    """Set a value. In a block, a new key goes before the last one: comments and empty lines follow the last one."""
    if key in mapping or mapping.fa.flow_style():
        mapping[key] = value
    else:
        mapping.insert(max(0, len(mapping) - 1), key, value)


def _proposal(
    source: Path,
    target: Path | None,
    before: bytes,
    after: bytes,
    model: type[BaseModel],
    notes: Sequence[str] = (),
) -> Proposal:
    reason = must_be_copied(source)
    if reason and target is None:
        raise ControlRefused(
            f"{reason} Nothing was written.", where=str(source), remedy="Give a name for a copy."
        )
    where = target or source
    try:
        check_document(after, str(where), model)
    except DocumentFaults as error:
        raise ScriptError([str(fault) for fault in error.faults]) from error
    return Proposal(where, source, before, after, tuple(notes))


def _read(source: Path) -> bytes:
    try:
        return source.read_bytes()
    except OSError as error:
        raise ControlRefused(
            f"The file cannot be read: {error.strerror}.", where=str(source), remedy="Check the path."
        ) from error
