"""From a sequence to its script: repeats, sets of poses and defaults unfolded into numbered steps.

Knows how a checked sequence unfolds, and nothing of stations: ``bench.plans.plan`` compares steps with a bench.
The same document always gives the same steps with the same numbers, so a resumed run finds its place.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from collections.abc import Sequence as List
from dataclasses import dataclass, replace
from typing import Any

from sequences.errors import DocumentFaults, Fault
from sequences.reader import Located
from sequences.schema import (
    AXES,
    Grid,
    LightWords,
    MoveWords,
    PoseWords,
    RepeatWords,
    Sequence,
    StepWords,
    Words,
)
from sequences.script import (
    Flicker,
    Gates,
    LightStep,
    MoveStep,
    Pose,
    PromptStep,
    RecordStep,
    ReportStep,
    SettleStep,
    SolveStep,
    Step,
    WaitStep,
)
from sequences.wording import did_you_mean
from sequences.yaml_text import DocumentPath

MOST_STEPS = 100_000
"""A longer script is refused: a night of one pose a second has about this many steps."""
MOST_FAULTS = 1000
"""More are not looked for: the same ones come again in every round of a repeat."""


def flatten(document: Located[Sequence]) -> tuple[Step, ...]:
    """Unfold a sequence into the steps to run, numbered from 1.

    Raises
    ------
    DocumentFaults
        With every fault: a set of poses that is not there, a ``move`` without a pose, a ``record`` before any
        move, a script too long.
    """
    steps, faults = unfold(document)
    if faults:
        raise DocumentFaults(faults)
    return steps


def unfold(document: Located[Sequence]) -> tuple[tuple[Step, ...], list[Fault]]:
    """Unfold a sequence as far as it goes, for a caller that has faults of its own to add.

    Returns
    -------
    steps, faults
        The steps that make sense, and every fault found on the way, each once.
    """
    unfolding = _Unfolding(document)
    try:
        unfolding.add_all(document.value.steps, ("steps",), here=None)
    except _TooLong:
        if not unfolding.faults:
            unfolding.fault(("steps",), f"the script unfolds into more than {MOST_STEPS} steps.")
    return tuple(unfolding.steps), list(dict.fromkeys(unfolding.faults))


def grid_angles(grid: Grid) -> Iterator[dict[str, float]]:
    """Angles of a grid's poses in the order they are visited.

    Examples
    --------
    >>> grid = Grid(pan_deg=[-1, 1], tilt_deg=[0, 5])
    >>> [(a["pan"], a["tilt"]) for a in grid_angles(grid)]
    [(-1.0, 0.0), (1.0, 0.0), (1.0, 5.0), (-1.0, 5.0)]
    """
    visited: list[dict[str, float]] = [{}]
    for axis, angles in grid.angles_deg().items():
        rows = []
        for row, angle in enumerate(angles):
            back = grid.order == "serpentine" and row % 2 == 1
            rows += [{**at, axis: angle} for at in (reversed(visited) if back else visited)]
        visited = rows
    yield from visited


class _TooLong(Exception):
    """The script, or the list of its faults, passed its bound."""


@dataclass(frozen=True)
class _Place:
    """A pose of the document, before it is one of the run."""

    name: str | None
    angles_deg: Mapping[str, float]


class _Unfolding:
    """The steps so far, and where the camera stands after them."""

    def __init__(self, document: Located[Sequence]) -> None:
        self.document = document
        self.sequence = document.value
        self.axes = axes_named(document.value)
        self.steps: list[Step] = []
        self.faults: list[Fault] = []
        self._names: dict[str, int] = {}  # every name given, and how often it was wished for
        self._name = ""  # as wished for at the present pose
        self._recordings = 0
        self._pose: Pose | None = None  # where the camera stands
        self._move_step: MoveStep  # the step that brought it there

    def fault(self, path: DocumentPath, message: str) -> None:
        self.faults.append(self.document.fault(path, message))

    def add_all(self, steps: List[StepWords], path: DocumentPath, here: _Place | None) -> None:
        for i, step in enumerate(steps):
            self._add(step, (*path, i), here)

    def _add(self, step: StepWords, path: DocumentPath, here: _Place | None) -> None:
        if len(self.steps) >= MOST_STEPS or len(self.faults) >= MOST_FAULTS:
            raise _TooLong
        said = getattr(step, step.word)
        spot = (*path, step.word)
        if isinstance(said, RepeatWords):
            self._repeat(said, spot, here)
        elif isinstance(said, MoveWords):
            self._move(said, spot, here)
        elif step.word == "record":
            self._record(said, spot)
        else:
            self.steps.append(self._plain(step.word, said, self._number(spot)))

    def _repeat(self, said: RepeatWords, path: DocumentPath, here: _Place | None) -> None:
        if said.poses is None:
            for _ in range(said.times or 0):
                self.add_all(said.steps, (*path, "steps"), here)
            return
        for place in self._places(said.poses, (*path, "poses")):
            self.add_all(said.steps, (*path, "steps"), place)

    def _places(self, poses: str | list[PoseWords] | Grid, path: DocumentPath) -> list[_Place]:
        if isinstance(poses, str):
            named = self.sequence.poses.get(poses)
            if named is None:
                hint = did_you_mean(poses, self.sequence.poses)
                self.fault(path, f"no set of poses has this name (got {poses!r}).{hint}")
                return []
            path = ("poses", poses)
            poses = named
        if isinstance(poses, list):
            return [_Place(pose.name, pose.angles_deg()) for pose in poses]
        size = math.prod(len(angles) for angles in poses.angles_deg().values())
        if size > MOST_STEPS:
            self.fault(path, f"this grid has {size} poses; {MOST_STEPS} are the most.")
            return []
        return [_Place(None, angles) for angles in grid_angles(poses)]

    def _move(self, said: MoveWords, path: DocumentPath, here: _Place | None) -> None:
        given = said.angles_deg()
        place = _Place(said.name, given) if given else here
        if place is None:
            self.fault(
                path,
                "no pose to move to: give pan_deg, tilt_deg or roll_deg, or put it in a repeat over poses.",
            )
            return
        angles = {axis: place.angles_deg.get(axis, 0.0) for axis in self.axes}
        by_angles = " ".join(f"{axis} {angle:g}" for axis, angle in angles.items())
        self._name = said.name or place.name or by_angles
        self._pose = Pose(0, self._unique(self._name), angles)
        self._move_step = MoveStep(**self._number(path), pose=self._pose)
        self.steps.append(self._move_step)

    def _record(self, said: Words, path: DocumentPath) -> None:
        if self._pose is None:
            self.fault(path, "a recording before any move: say first where the camera looks.")
            return
        self._recordings += 1
        if self._pose.index == 0:  # the first recording here gives the pose its number
            self._pose = replace(self._pose, index=self._recordings)
            self._move_step = replace(self._move_step, pose=self._pose)
            self.steps[self._move_step.number - 1] = self._move_step
        else:
            self._pose = replace(self._pose, index=self._recordings, name=self._unique(self._name))
        settings = merged(said, self.sequence.defaults.record)
        settings["gates"] = Gates.from_words(settings["gates"])
        self.steps.append(RecordStep(**self._number(path), pose=self._pose, **settings))

    def _plain(self, word: str, said: Words, place: dict[str, Any]) -> Step:
        if isinstance(said, LightWords):
            flicker = merged(said, self.sequence.defaults.light)
            on = flicker.pop("output", "on") == "on"
            return LightStep(**place, flicker=Flicker(**flicker) if on else None)
        if word == "settle":
            return SettleStep(**place, **merged(said, self.sequence.defaults.settle))
        if word == "solve":
            settings = merged(said, self.sequence.defaults.solve)
            limits = {name: limit for name, limit in settings.pop("limits").items() if limit is not None}
            return SolveStep(**place, **settings, limits=limits)
        if word == "wait":
            return WaitStep(**place, **dict(said))
        if word == "prompt":
            return PromptStep(**place, **dict(said))
        return ReportStep(**place)

    def _number(self, path: DocumentPath) -> dict[str, Any]:
        return {"number": len(self.steps) + 1, "where": self.document.where(path), "path": path}

    def _unique(self, name: str) -> str:
        """Make a name no other pose has: by a number in brackets, if need be."""
        free, wishes = name, self._names.get(name, 0)
        while free in self._names:
            wishes += 1
            free = f"{name} ({wishes})"
        self._names[name] = max(wishes, 1)
        self._names.setdefault(free, 1)
        return free


def axes_named(sequence: Sequence) -> tuple[str, ...]:
    """Axes that any pose of the sequence names, in the order pan, tilt, roll."""
    named: set[str] = set()
    for poses in sequence.poses.values():
        named.update(_axes_of_set(poses))
    for step in _every_step(sequence.steps):
        if step.move is not None:
            named.update(step.move.angles_deg())
        if (
            step.repeat is not None
            and step.repeat.poses is not None
            and not isinstance(step.repeat.poses, str)
        ):
            named.update(_axes_of_set(step.repeat.poses))
    return tuple(axis for axis in AXES if axis in named)


def merged(said: Words, default: Words) -> dict[str, Any]:
    """Put together the settings of a step: what it says itself, above what the defaults say."""
    settings = {name: getattr(default, name) for name in type(default).model_fields}
    settings |= {name: getattr(said, name) for name in said.model_fields_set}
    for name, value in settings.items():
        if isinstance(value, Words):
            settings[name] = merged(value, getattr(default, name))
    return settings


def _axes_of_set(poses: list[PoseWords] | Grid) -> set[str]:
    if isinstance(poses, Grid):
        return set(poses.angles_deg())
    return {axis for pose in poses for axis in pose.angles_deg()}


def _every_step(steps: List[StepWords]) -> Iterator[StepWords]:
    for step in steps:
        yield step
        if step.repeat is not None:
            yield from _every_step(step.repeat.steps)
