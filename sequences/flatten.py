"""From a sequence to its script: unfold repeats, sets of poses and defaults into numbered steps.

The module does not depend on a station. A document always gives the same numbers, so a resumed run finds its place.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from collections.abc import Sequence as List
from dataclasses import dataclass, replace
from typing import Any, Literal, cast

from sequences.reader import Located
from sequences.schema import (
    AXES,
    Grid,
    LightConfig,
    MoveConfig,
    PoseConfig,
    RecordConfig,
    RepeatConfig,
    Sequence,
    StepConfig,
    UntilConfig,
    Waveform,
)
from sequences.script import (
    ChooseStep,
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
    Until,
    WaitStep,
)
from sequences.solve_schema import DISTORTION_SETS, LENS_FAMILIES, DistortionSet, DistortionTerm, SolveConfig
from sequences.strict_model import StrictModel
from sequences.tree import DocumentPath, Fault
from sequences.wording import did_you_mean

MOST_STEPS = 100_000
"""Steps that a script may have at most: about a night with one pose a second."""
POSES_FAILED = 10
"""An ``until`` ends when this number of its chosen poses failed all attempts: so many are no chance."""
MOST_FAULTS = 1000
"""Faults that are collected at most: each round of a repeat has the same faults again."""


def axes_named(sequence: Sequence) -> tuple[str, ...]:
    """Return the axes that any pose of the sequence names, in the order pan, tilt, roll."""
    named: set[str] = set()
    for poses in sequence.poses.values():
        named.update(_axes_of_set(poses))
    for step in _every_step(sequence.steps):
        if step.move is not None:
            named.update(step.move.angles_deg())
        starts = step.until.start if step.until is not None else None
        for given in (step.repeat.poses if step.repeat is not None else None, starts):
            if given is not None and not isinstance(given, str):
                named.update(_axes_of_set(given))
    return tuple(axis for axis in AXES if axis in named)


def distortion_terms(
    chosen: DistortionSet | tuple[DistortionTerm, ...],
) -> tuple[DistortionTerm, ...] | Literal["auto"]:
    """Return the coefficients of a set or a list, in the order of their lens model; ``auto`` if the data choose them.

    >>> distortion_terms("k1k2p1p2"), distortion_terms(("k2", "k1")), distortion_terms("none")
    (('k1', 'k2', 'p1', 'p2'), ('k1', 'k2'), ())
    """
    if chosen == "auto":
        return "auto"
    terms = DISTORTION_SETS[chosen] if isinstance(chosen, str) else chosen
    ordered = (term for family in LENS_FAMILIES for term in family if term in terms)
    return cast("tuple[DistortionTerm, ...]", tuple(ordered))


def merged(given: StrictModel, default: StrictModel) -> dict[str, Any]:
    """Return the settings of a step: its own, and the sequence's defaults for all others."""
    settings = {name: getattr(default, name) for name in type(default).model_fields}
    settings |= {name: getattr(given, name) for name in given.model_fields_set}
    for name, value in settings.items():
        if isinstance(value, StrictModel):
            settings[name] = merged(value, getattr(default, name))
    return settings


def _axes_of_set(poses: list[PoseConfig] | Grid) -> set[str]:
    if isinstance(poses, Grid):
        return set(poses.angles_deg())
    return {axis for pose in poses for axis in pose.angles_deg()}


def _every_step(steps: List[StepConfig]) -> Iterator[StepConfig]:
    for step in steps:
        yield step
        if step.repeat is not None:
            yield from _every_step(step.repeat.steps)


def unfold(document: Located[Sequence]) -> tuple[tuple[Step, ...], list[Fault]]:
    """Unfold a sequence as far as possible: the valid steps, and every fault once, for a caller that adds its own."""
    unfolding = _Unfolding(document)
    try:
        unfolding.add_all(document.value.steps, ("steps",), here=None)
    except _TooLong:
        if not unfolding.faults:
            unfolding.fault(("steps",), f"the script unfolds into more than {MOST_STEPS} steps.")
    return tuple(unfolding.steps), list(dict.fromkeys(unfolding.faults))


def grid_angles(grid: Grid) -> Iterator[dict[str, float]]:
    """Yield the angles by axis, degrees, of a grid's poses in the order of the visits.

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
    """Too many steps or too many faults."""


@dataclass(frozen=True)
class _Place:
    """A pose of the document that has no number in the run yet."""

    name: str | None
    angles_deg: Mapping[str, float]


class _Unfolding:
    """The steps unfolded so far, and the camera's pose after them."""

    def __init__(self, document: Located[Sequence]) -> None:
        self.document = document
        self.sequence = document.value
        self.axes = axes_named(document.value)
        self.steps: list[Step] = []
        self.faults: list[Fault] = []
        self._names: dict[str, int] = {}  # every name in use, and how often it was requested
        self._name = ""  # requested name of the current pose
        self._recordings = 0
        self._waveform: Waveform = "square"  # of the latest light step
        self._pose: Pose | None = None  # the current pose
        self._move_step: MoveStep | None = None  # the step that moved to the current pose

    def fault(self, path: DocumentPath, message: str) -> None:
        self.faults.append(self.document.fault(path, message))

    def add_all(self, steps: List[StepConfig], path: DocumentPath, here: _Place | None) -> None:
        for i, step in enumerate(steps):
            self._add(step, (*path, i), here)

    def _add(self, step: StepConfig, path: DocumentPath, here: _Place | None) -> None:
        if len(self.steps) >= MOST_STEPS or len(self.faults) >= MOST_FAULTS:
            raise _TooLong
        given = getattr(step, step.word)
        spot = (*path, step.word)
        if isinstance(given, RepeatConfig):
            self._repeat(given, spot, here)
        elif isinstance(given, MoveConfig):
            self._move(given, spot, here)
        elif isinstance(given, UntilConfig):
            self._until(given, spot)
        elif step.word == "record":
            self._record(given, spot)
        else:
            self.steps.append(self._plain(step.word, given, self._number(spot)))

    def _repeat(self, given: RepeatConfig, path: DocumentPath, here: _Place | None) -> None:
        if given.poses is None:
            for _ in range(given.times or 0):
                self.add_all(given.steps, (*path, "steps"), here)
            return
        for place in self._places(given.poses, (*path, "poses")):
            self.add_all(given.steps, (*path, "steps"), place)

    def _places(self, poses: str | list[PoseConfig] | Grid, path: DocumentPath) -> list[_Place]:
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
            self.fault(path, f"this grid has {size} poses; at most {MOST_STEPS} are allowed.")
            return []
        return [_Place(None, angles) for angles in grid_angles(poses)]

    def _until(self, given: UntilConfig, path: DocumentPath) -> None:
        """Unfold an ``until``: the poses of its start, then rounds of choose, move, settle and record.

        There are rounds for all accepted recordings and all failed poses, so that steps and poses have numbers before
        anything is recorded; the run leaves out those it does not need.
        """
        starts = [] if given.start is None else self._places(given.start, (*path, "start"))
        if len(starts) > given.at_most:
            self.fault(
                (*path, "start"), f"start has {len(starts)} poses, more than at_most ({given.at_most})."
            )
            return
        rounds = given.at_most + POSES_FAILED - 1
        first, first_pose = len(self.steps) + 1, self._recordings + 1
        until = Until(
            first,
            first + 3 * len(starts) + 4 * rounds,
            given.goals(),
            given.at_most,
            given.minutes,
            len(starts),
            range(first_pose, first_pose + len(starts) + rounds),
        )
        record = self._record_settings_of(given)
        settle = merged(given.settle, self.sequence.defaults.settle)
        for place in starts:
            self._move(MoveConfig(), path, place)
            self.steps.append(SettleStep(**self._number((*path, "settle")), **settle))
            self._record(record, (*path, "record"))
        for round_number in range(1, rounds + 1):
            self._recordings += 1
            pose = Pose(self._recordings, self._unique(f"chosen {round_number}"), {}, chosen_in_run=True)
            self._choose(until, pose, path)
            self.steps.append(MoveStep(**self._number(path), pose=pose))
            self.steps.append(SettleStep(**self._number((*path, "settle")), **settle))
            self.steps.append(self._record_step(record, (*path, "record"), pose))
        self._choose(until, None, path)
        self._pose = None

    def _choose(self, until: Until, pose: Pose | None, path: DocumentPath) -> None:
        place = self._number(path)
        solve = self._plain("solve", SolveConfig(), place)
        assert isinstance(solve, SolveStep)
        self.steps.append(ChooseStep(**place, until=until, pose=pose, solve=solve))

    def _record_settings_of(self, given: UntilConfig) -> RecordConfig:
        """Return the settings of the recordings of an ``until``; by default, a pose that fails is skipped."""
        stated = {*given.record.model_fields_set, *self.sequence.defaults.record.model_fields_set}
        return (
            given.record if "on_failure" in stated else given.record.model_copy(update={"on_failure": "skip"})
        )

    def _move(self, given: MoveConfig, path: DocumentPath, here: _Place | None) -> None:
        angles = given.angles_deg()
        place = _Place(given.name, angles) if angles else here
        if place is None:
            self.fault(
                path,
                "no pose to move to: give pan_deg, tilt_deg or roll_deg, or put the move in a repeat over poses.",
            )
            return
        angles = {axis: place.angles_deg.get(axis, 0.0) for axis in self.axes}
        by_angles = " ".join(f"{axis} {angle:g}" for axis, angle in angles.items())
        self._name = given.name or place.name or by_angles
        self._pose = Pose(0, self._unique(self._name), angles)
        self._move_step = MoveStep(**self._number(path), pose=self._pose)
        self.steps.append(self._move_step)

    def _record(self, given: StrictModel, path: DocumentPath) -> None:
        if self._pose is None:
            self.fault(path, "a record before any move: add a move before it.")
            return
        self._recordings += 1
        if self._pose.index == 0:  # the first recording here gives the pose its number
            self._pose = replace(self._pose, index=self._recordings)
            if self._move_step is not None:
                self._move_step = replace(self._move_step, pose=self._pose)
                self.steps[self._move_step.number - 1] = self._move_step
        else:
            self._pose = replace(self._pose, index=self._recordings, name=self._unique(self._name))
        self.steps.append(self._record_step(given, path, self._pose))

    def _record_step(self, given: StrictModel, path: DocumentPath, pose: Pose) -> RecordStep:
        settings = merged(given, self.sequence.defaults.record)
        settings["gates"] = Gates.from_settings(settings["gates"], self._waveform)
        return RecordStep(**self._number(path), pose=pose, **settings)

    def _plain(self, word: str, given: StrictModel, place: dict[str, Any]) -> Step:
        if isinstance(given, LightConfig):
            flicker = merged(given, self.sequence.defaults.light)
            on = flicker.pop("output", "on") == "on"
            self._waveform = flicker["waveform"]
            return LightStep(**place, flicker=Flicker(**flicker) if on else None)
        if word == "settle":
            return SettleStep(**place, **merged(given, self.sequence.defaults.settle))
        if word in ("solve", "check"):
            settings = merged(given, self.sequence.defaults.solve)
            settings.pop("drift_mm")
            limits = {name: limit for name, limit in settings.pop("limits").items() if limit is not None}
            distortion = distortion_terms(settings.pop("distortion"))
            checked = settings.pop("calibration", None)
            return SolveStep(**place, **settings, distortion=distortion, limits=limits, checked=checked)
        if word == "wait":
            return WaitStep(**place, **dict(given))
        if word == "prompt":
            return PromptStep(**place, **dict(given))
        return ReportStep(**place)

    def _number(self, path: DocumentPath) -> dict[str, Any]:
        return {"number": len(self.steps) + 1, "where": self.document.where(path), "path": path}

    def _unique(self, name: str) -> str:
        """Return a name that no other pose has; add a number in parentheses if necessary."""
        free, requests = name, self._names.get(name, 0)
        while free in self._names:
            requests += 1
            free = f"{name} ({requests})"
        self._names[name] = max(requests, 1)
        self._names.setdefault(free, 1)
        return free
