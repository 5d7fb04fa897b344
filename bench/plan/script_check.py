"""Whether a script makes sense on a station: every fault at its place in the sequence, all of them at once.

Knows what goes together - axes, limits, light, windows, the order of steps - and nothing of time or disk. A
fault means the run cannot succeed; a remark means it can, and somebody should know.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from bench.stations.station import Station
from bench.stations.station_cameras import FrameCameraConfig
from sequences.reader import Located
from sequences.schema import AXES, Sequence
from sequences.script import (
    Flicker,
    LightStep,
    MoveStep,
    RecordStep,
    ReportStep,
    SettleStep,
    SolveStep,
    Step,
    WaitStep,
)
from sequences.tree import DocumentPath, Fault, Tree

FEWEST_POSES = 2
"""Directions without which no model's focal length is determined."""
WHOLE_PERIOD_SLACK = 0.02
"""A window this share shorter than a period still means a whole one (16.6 ms at 60 Hz)."""


class Findings(NamedTuple):
    """What was found: faults forbid the run, remarks do not."""

    faults: tuple[Fault, ...]
    remarks: tuple[Fault, ...]


def check_script(document: Located[Sequence], steps: tuple[Step, ...], station: Station) -> Findings:
    """Compare a script with a station.

    Parameters
    ----------
    document
        The sequence, for the places of what is found.
    steps
        Its steps, flattened.
    station
        The station.
    """
    faults = [
        *angle_faults(document.tree, station),
        *_light_faults(document, steps, station),
        *_recording_faults(document, steps, station),
        *_order_faults(document, steps),
        *_limit_faults(document, steps),
    ]
    return Findings(
        tuple(sorted(set(faults))),
        tuple(sorted({*_remarks(document, steps), *_steady_remarks(document, steps, station)})),
    )


def angle_faults(sequence: Tree, station: Station) -> list[Fault]:
    """Compare every angle a sequence says anywhere with the station; also one that is not a sequence yet.

    A grid's angles lie between those written, and an angle not written is 0, which every station reaches.
    """
    axes = station.axes
    faults = Tree(sequence.file)
    for path, text in _texts(sequence.value, ()):
        axis = next((axis for axis in AXES if f"{axis}_deg" in path), None)
        if axis is None or path[-1] == "count":
            continue
        spot = sequence.values[path]
        if axis not in axes:
            faults.add_fault(spot, path, f"the station's stage has no {axis} axis; it has {', '.join(axes)}.")
        elif (angle := _number(text)) is not None and not axes[axis].limits_deg[0] <= angle <= axes[
            axis
        ].limits_deg[1]:
            lowest, highest = axes[axis].limits_deg
            message = f"{axis} {angle:g} deg lies outside the station's {lowest:g} to {highest:g} deg."
            faults.add_fault(spot, path, message)
    return faults.faults


def _texts(value: Any, path: DocumentPath) -> Iterator[tuple[DocumentPath, str]]:
    """Go through all texts of a document, with their paths."""
    if isinstance(value, str):
        yield path, value
    elif isinstance(value, Mapping):
        for key, inner in value.items():
            yield from _texts(inner, (*path, key))
    elif isinstance(value, list):
        for i, inner in enumerate(value):
            yield from _texts(inner, (*path, i))


def _number(text: str) -> float | None:
    """Read a finite number; what is none is a fault of the sequence alone."""
    try:
        number = float(text)
    except ValueError:
        return None
    return number if math.isfinite(number) else None


def _light_faults(document: Located[Sequence], steps: tuple[Step, ...], station: Station) -> Iterator[Fault]:
    lowest, highest = station.light.frequency_range_hz
    for step in steps:
        if isinstance(step, LightStep) and step.flicker is not None and _flickers(step.flicker, station):
            frequency = step.flicker.frequency_hz
            if not lowest <= frequency <= highest:
                path = _said(document, step.path, "frequency_hz", "light")
                message = (
                    f"{frequency:g} Hz lies outside the {lowest:g} to {highest:g} Hz of the station's light."
                )
                yield document.fault(path, message)


def _flickers(flicker: Flicker, station: Station) -> bool:
    """Whether a flicker remains one: a frame camera's light burns steadily."""
    return flicker.waveform != "steady" and not isinstance(station.camera, FrameCameraConfig)


def _recording_faults(
    document: Located[Sequence], steps: tuple[Step, ...], station: Station
) -> Iterator[Fault]:
    flicker: Flicker | None = None
    takes_pictures = isinstance(station.camera, FrameCameraConfig)
    for step in steps:
        if isinstance(step, LightStep):
            flicker = step.flicker
        if not isinstance(step, RecordStep):
            continue
        if flicker is None:
            yield document.fault(step.path, "a recording in the dark: switch the light on first (light:).")
            continue
        if takes_pictures:
            continue  # in steady light: periods and triggers mean nothing
        if flicker.waveform == "steady":
            yield document.fault(
                step.path,
                "an event camera sees nothing of a steady light: let it flicker (waveform: square).",
            )
            continue
        periods = step.window_ms * 1e-3 * flicker.frequency_hz
        if periods < 1 - WHOLE_PERIOD_SLACK:
            path = _said(document, step.path, "window_ms", "record")
            message = f"{step.window_ms:g} ms hold no whole period of {flicker.frequency_hz:g} Hz"
            yield document.fault(path, f"{message}: {1e3 / flicker.frequency_hz:.4g} ms at least.")
        if step.gates.require_triggers and not station.light.sync_output:
            path = _said(document, step.path, "gates", "record")
            message = "sync triggers are required, and the station's light gives none (sync_output: false)."
            yield document.fault(path, message)


def _order_faults(document: Located[Sequence], steps: tuple[Step, ...]) -> Iterator[Fault]:
    directions: set[tuple[tuple[str, float], ...]] = set()
    solved = reported = False
    for step in steps:
        if reported:
            yield document.fault(step.path, "a step after the report, which has sealed the run.")
        if isinstance(step, RecordStep):
            directions.add(tuple(step.pose.angles_deg.items()))
        elif isinstance(step, SolveStep):
            solved = True
            if not directions:
                yield document.fault(step.path, "nothing is recorded before this solve.")
            elif len(directions) < FEWEST_POSES:
                yield document.fault(
                    step.path, f"one direction is recorded; it takes {FEWEST_POSES} or more."
                )
        elif isinstance(step, ReportStep):
            reported = True
            if not solved:
                yield document.fault(step.path, "a report before any solve has no result to show.")


def _limit_faults(document: Located[Sequence], steps: tuple[Step, ...]) -> Iterator[Fault]:
    """Find limits on parameters that the solve does not estimate."""
    for step in steps:
        if isinstance(step, SolveStep):
            estimated = {"fx", "fy", "cx", "cy", *step.distortion}
            estimated |= {"x", "y", "r"} if step.model != "planar" else set()
            for name in step.limits:
                _, sigma, parameter = name.partition("sigma_")
                if sigma and parameter.removesuffix("_px").removesuffix("_mm") not in estimated:
                    path = (*_said(document, step.path, "limits", "solve"), name)
                    yield document.fault(path, "this solve does not estimate it, so it has no uncertainty.")


def _remarks(document: Located[Sequence], steps: tuple[Step, ...]) -> Iterator[Fault]:
    last: Step | None = None
    unsolved: RecordStep | None = None
    for step in steps:
        if isinstance(step, RecordStep):
            unsolved = step
            if isinstance(last, MoveStep):
                yield document.fault(
                    step.path, "recorded right after a move: nothing waits for it to settle."
                )
        elif isinstance(step, SolveStep):
            unsolved = None
        if isinstance(step, MoveStep | SettleStep | WaitStep | RecordStep):
            last = step
    if unsolved is not None:
        yield document.fault(unsolved.path, "recorded after the last solve: no result will use it.")
    if not any(isinstance(step, ReportStep) for step in steps):
        yield document.fault(("steps",), "no report step: the run ends without a report.")


def _steady_remarks(
    document: Located[Sequence], steps: tuple[Step, ...], station: Station
) -> Iterator[Fault]:
    """Say where a flicker will be none, because the camera takes pictures."""
    for step in steps:
        flicker = step.flicker if isinstance(step, LightStep) else None
        if flicker is not None and flicker.waveform != "steady" and not _flickers(flicker, station):
            yield document.fault(
                step.path, "the station's camera takes pictures: the light burns steadily instead."
            )


def _said(document: Located[Sequence], path: DocumentPath, key: str, word: str) -> DocumentPath:
    """Find where a step's setting is written: at the step, above it in the defaults, or nowhere."""
    places = ((*path, key), ("defaults", word, key))
    return next((place for place in places if place in document.tree.values), path)
