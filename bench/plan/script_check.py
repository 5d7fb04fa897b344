"""Checks a sequence against a station: axes, limits, light, windows, order of steps. Finds all faults at once.

With a fault the run cannot succeed; a remark is something that the operator should know.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from typing import NamedTuple

from bench.base.bounded_json import leaves
from bench.plan.passports import NO_PASSPORT, setting_path
from bench.simulated import fault_of_simulation
from bench.stations.sections import FrameCameraSection
from bench.stations.station import Station
from bench.stations.station_fields import SIMULATED_PREFIX
from calib.calibration import REFERENCE_MODELS, CalibrationOptions
from sequences.reader import Located
from sequences.schema import AXES, Sequence
from sequences.script import (
    ChooseStep,
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
from sequences.solve_schema import LENS_FAMILIES
from sequences.tree import DocumentPath, Fault, Tree

FEWEST_POSES = 2
"""Fewest directions from which a focal length can be determined."""
SOME_LENS_TERMS = tuple(term for family in LENS_FAMILIES for term in family)
"""Coefficients that ``distortion: auto`` may choose."""
SMALLEST_SHARE_PERCENT = 1.0
"""A duty or level up to this is remarked: 0.5 and 1 are what half and all are as shares."""
LEAST_SPREAD_DEG = 1.0
"""Poses that are all nearer to each other are remarked: 20 degrees to each side are less than 1 in radians."""
PAST_THE_RIM_DEG = 1.5
"""A pose that looks farther past the rim is remarked: half angle and zero of the stage are known to a degree or so, and
the parallax test looks one degree past the rim, to see it."""
WHOLE_PERIOD_SLACK = 0.02
"""A window may be shorter than a period by this fraction and still mean a whole period (16.6 ms at 60 Hz)."""


class Findings(NamedTuple):
    """What was found."""

    faults: tuple[Fault, ...]  # Why the run cannot succeed
    remarks: tuple[Fault, ...]


def check_script(
    document: Located[Sequence],
    steps: tuple[Step, ...],
    station: Station,
    with_passport: frozenset[int] = frozenset(),
    *,
    whole: bool = True,
) -> Findings:
    """Check a sequence's steps; for solve steps ``with_passport``, by number, one pose is enough.

    The order of the steps is judged only if they are ``whole``: no fault of the sequence has left out a step.
    """
    faults = [
        *angle_faults(document.tree, station),
        *_light_faults(document, steps, station),
        *_recording_faults(document, steps, station),
        *(_order_faults(document, steps, station, with_passport) if whole else ()),
        *_solve_faults(document, steps),
        *_limit_faults(document, steps, station),
    ]
    remarks = {
        *_remarks(document, steps),
        *_unit_remarks(document, steps),
        *_steady_remarks(document, steps, station),
        *_beam_remarks(document, steps, station),
    }
    return Findings(tuple(sorted(set(faults))), tuple(sorted(remarks)))


def angle_faults(sequence: Tree, station: Station) -> list[Fault]:
    """Return angles outside the station's limits, and axes it does not have; the sequence may have other faults.

    A grid's angles lie between those in the file; one that is not there is 0, which every station reaches.
    """
    axes = station.axes
    faults = Tree(sequence.file)
    for path, text in leaves(sequence.value):
        axis = next((axis for axis in AXES if f"{axis}_deg" in path), None)
        if axis is None or path[-1] == "count" or not isinstance(text, str):
            continue
        spot = sequence.values[path]
        if axis not in axes:
            message = f"the stage of the station has no {axis} axis; it has {', '.join(axes)}."
            faults.add_fault(spot, path, message)
            continue
        (lowest, highest), angle = axes[axis].limits_deg, _number(text)
        if angle is not None and not lowest <= angle <= highest:
            limits = f"the limits of the station, {lowest:g} to {highest:g} deg"
            faults.add_fault(spot, path, f"{axis} {angle:g} deg is outside {limits}.")
    return faults.faults


def _number(text: str) -> float | None:
    """Read a finite number; None for another text, which is reported as a fault of the sequence itself."""
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
                path = setting_path(document, step.path, "frequency_hz", "light")
                message = f"{frequency:g} Hz is outside the range of the station's light, {lowest:g} to {highest:g} Hz."
                yield document.fault(path, message)


def _flickers(flicker: Flicker, station: Station) -> bool:
    """Whether the light will flicker: for a frame camera it is always steady."""
    return flicker.waveform != "steady" and not isinstance(station.camera, FrameCameraSection)


def _recording_faults(
    document: Located[Sequence], steps: tuple[Step, ...], station: Station
) -> Iterator[Fault]:
    flicker: Flicker | None = None
    takes_pictures = isinstance(station.camera, FrameCameraSection)
    for step in steps:
        if isinstance(step, LightStep):
            flicker = step.flicker
        if not isinstance(step, RecordStep):
            continue
        if flicker is None:
            yield document.fault(
                step.path, "this recording is in the dark: switch the light on first (light:)."
            )
        elif not takes_pictures:  # pictures need neither periods nor triggers
            yield from _event_recording_faults(document, step, flicker, station)


def _event_recording_faults(
    document: Located[Sequence], step: RecordStep, flicker: Flicker, station: Station
) -> Iterator[Fault]:
    """Yield why an event camera would see nothing of this light, or miss its periods or triggers."""
    if flicker.waveform == "steady":
        yield document.fault(
            step.path,
            "an event camera does not see a steady light: let it flicker (waveform: square).",
        )
        return
    periods = step.window_ms * 1e-3 * flicker.frequency_hz
    if periods < 1 - WHOLE_PERIOD_SLACK:
        path = setting_path(document, step.path, "window_ms", "record")
        message = f"{step.window_ms:g} ms is shorter than a period of {flicker.frequency_hz:g} Hz"
        yield document.fault(path, f"{message}: use at least {1e3 / flicker.frequency_hz:.2f} ms.")
    if step.gates.require_triggers and not station.light.sync_output:
        path = setting_path(document, step.path, "gates", "record")
        message = (
            "sync triggers are required, but the station's light has no sync output (sync_output: false)."
        )
        yield document.fault(path, message)


def _order_faults(
    document: Located[Sequence], steps: tuple[Step, ...], station: Station, with_passport: frozenset[int]
) -> Iterator[Fault]:
    directions: set[tuple[tuple[str, float], ...]] = set()
    solved = reported = False
    for step in steps:
        if reported:
            yield document.fault(step.path, "no step may follow the report, which seals the run.")
        if isinstance(step, RecordStep):
            chosen = (("number", float(step.pose.index)),) if step.pose.chosen_in_run else ()
            directions.add((*step.pose.angles_deg.items(), *chosen))
        is_enough = len(directions) >= FEWEST_POSES
        if isinstance(step, ChooseStep) and not is_enough and station.expected is None:
            yield document.fault(
                step.path,
                f"no pose can be chosen here: record at least {FEWEST_POSES} poses before (start:), or add an "
                "expected section to the station.",
            )
        if isinstance(step, SolveStep) and not directions:
            yield document.fault(step.path, "no pose is recorded before this solve.")
        elif isinstance(step, SolveStep) and not is_enough and step.number not in with_passport:
            yield document.fault(
                step.path,
                f"only one direction is recorded. Record at least {FEWEST_POSES} directions, or use a passport "
                "that holds the collimator's centre. A certificate of its focal length is not enough.",
            )
        if isinstance(step, ReportStep) and not solved:
            yield document.fault(step.path, "no solve precedes this report, so there is no result to report.")
        solved = solved or isinstance(step, SolveStep)
        reported = reported or isinstance(step, ReportStep)


def _solve_faults(document: Located[Sequence], steps: tuple[Step, ...]) -> Iterator[Fault]:
    """Yield limits on parameters that the solve does not estimate, and passports that it cannot use."""
    for step in steps:
        if isinstance(step, SolveStep):
            if step.model in REFERENCE_MODELS and step.passport not in (None, NO_PASSPORT):
                yield document.fault(
                    setting_path(document, step.path, "passport", "solve"),
                    f"the {step.model} model is a method of reference, and uses no passport: use another model.",
                )
            estimated = _estimated(step)
            for name in step.limits:
                _, sigma, parameter = name.partition("sigma_")
                if sigma and parameter.removesuffix("_px").removesuffix("_mm") not in estimated:
                    path = (*setting_path(document, step.path, "limits", "solve"), name)
                    yield document.fault(
                        path, "this solve does not estimate the parameter, so it has no uncertainty."
                    )


def _estimated(step: SolveStep) -> set[str]:
    """Return the parameters that a solve estimates."""
    lens = SOME_LENS_TERMS if step.distortion == "auto" else step.distortion
    return {"fx", "fy", "cx", "cy", *lens} | ({"x", "y", "r"} if step.model != "planar" else set())


def _limit_faults(document: Located[Sequence], steps: tuple[Step, ...], station: Station) -> Iterator[Fault]:
    """Yield limits of results that this run cannot judge: it would end without PASS or FAIL."""
    stated: list[tuple[DocumentPath, str, str]] = [
        (("limits", at, "result"), limit.result, "") for at, limit in enumerate(document.value.limits)
    ]
    stated += [(("steps",), limit.result, f"the station limits {limit.result}: ") for limit in station.limits]
    if not stated:
        return
    if not any(isinstance(step, ReportStep) for step in steps):
        yield document.fault(
            ("steps",), "limits need a solve step and a report step: without them, nothing is judged."
        )
        return
    last = [step for step in steps if isinstance(step, SolveStep)][-1:]
    estimated = set().union(*map(_estimated, last))
    if last and last[0].model in {None, "auto", "joint"}:  # whatever terms the step names
        from calib.joint.posed import lens_names  # needed for this alone

        estimated |= set(lens_names(last[0].distortion))
    for path, result, prefix in stated:
        if last and result not in estimated:
            yield document.fault(path, f"{prefix}the last solve does not estimate this result.")


def _remarks(document: Located[Sequence], steps: tuple[Step, ...]) -> Iterator[Fault]:
    last: Step | None = None
    unsolved: RecordStep | None = None
    for step in steps:
        if isinstance(step, RecordStep):
            unsolved = step
            if isinstance(last, MoveStep):
                yield document.fault(
                    step.path, "recorded directly after a move: no step waits until the stage has settled."
                )
        elif isinstance(step, SolveStep):
            unsolved = None
            options = CalibrationOptions(step.model or "auto", loss=step.loss, huber_px=step.huber_px)
            if options.unused:
                yield document.fault(setting_path(document, step.path, "loss", "solve"), options.unused)
        if isinstance(step, MoveStep | SettleStep | WaitStep | RecordStep):
            last = step
    if unsolved is not None:
        yield document.fault(unsolved.path, "recorded after the last solve: no result uses this recording.")
    if not any(isinstance(step, ReportStep) for step in steps):
        yield document.fault(("steps",), "there is no report step: the run ends without a report.")


def _unit_remarks(document: Located[Sequence], steps: tuple[Step, ...]) -> Iterator[Fault]:
    """Yield where a value looks as if it were in another unit: radians, or a share in place of per cent."""
    angles: list[tuple[float, ...]] = []
    for step in steps:
        if isinstance(step, LightStep) and step.flicker is not None:
            for name in ("duty_percent", "level_percent"):
                value = getattr(step.flicker, name)
                if value <= SMALLEST_SHARE_PERCENT:
                    path = setting_path(document, step.path, name, "light")
                    yield document.fault(path, f"{value:g} means {value:g} per cent; all is 100.")
        elif isinstance(step, RecordStep):
            angles.append(tuple(step.pose.angles_deg.get(axis, 0.0) for axis in AXES))
        elif isinstance(step, SolveStep) and 0 < (widest := _widest_deg(angles)) < LEAST_SPREAD_DEG:
            yield document.fault(
                step.path,
                f"all poses lie within {widest:.2g} degrees. Angles are in degrees, not in radians. Such poses hardly"
                " tell the lens from the collimator: spread them over the field.",
            )


def _widest_deg(angles: list[tuple[float, ...]]) -> float:
    """Return the longest way of an axis over all poses."""
    return max((max(of_axis) - min(of_axis) for of_axis in zip(*angles, strict=True)), default=0.0)


def _steady_remarks(
    document: Located[Sequence], steps: tuple[Step, ...], station: Station
) -> Iterator[Fault]:
    """Yield a remark for each flicker that is replaced by steady light, because the camera is a frame camera."""
    for step in steps:
        flicker = step.flicker if isinstance(step, LightStep) else None
        if flicker is not None and flicker.waveform != "steady" and not _flickers(flicker, station):
            yield document.fault(step.path, "the station has a frame camera: the light is steady instead.")


def _beam_remarks(document: Located[Sequence], steps: tuple[Step, ...], station: Station) -> Iterator[Fault]:
    """Yield a remark for each pose whose middle of the image lies outside the beam, if the station states the beam."""
    if station.expected is None:
        return
    half_angle_deg = station.expected.half_angle_deg
    for step in steps:
        if isinstance(step, RecordStep) and not step.pose.chosen_in_run:
            off_axis_deg = off_axis(step.pose.angles_deg)
            if off_axis_deg > half_angle_deg + PAST_THE_RIM_DEG:
                yield document.fault(
                    step.path,
                    f"pose {step.pose.index} ({step.pose.name}) looks past the beam: {off_axis_deg:.1f} degrees from"
                    f" its axis, and the beam ends at {half_angle_deg:g}. Much of the image stays dark.",
                )


def off_axis(angles_deg: Mapping[str, float]) -> float:
    """Return the angle between the axes of camera and beam, degrees, if they agree at the stage's zero.

    Its cosine is cos(pan) cos(tilt), the last element of Rz(roll) Rx(tilt) Ry(pan).
    """
    pan, tilt = (math.radians(angles_deg.get(axis, 0.0)) for axis in ("pan", "tilt"))
    return math.degrees(math.acos(math.cos(pan) * math.cos(tilt)))


def find_simulation_faults(station: Located[Station]) -> list[Fault]:
    """Return what is wrong with the section ``simulation``, which only the simulators know; empty if nothing is."""
    value = station.value
    if value.simulation is None:
        return []
    simulated = any(port.startswith(SIMULATED_PREFIX) for port in value.stage.ports)
    fault = fault_of_simulation(value.simulated_world, value.axes if simulated else ())
    if fault is None:
        return []
    keys = re.findall(r"[^.\[\]]+", fault[0])
    path = ("simulation", *(int(key) if key.isdigit() else key for key in keys))
    return [station.fault(path, fault[1])]
