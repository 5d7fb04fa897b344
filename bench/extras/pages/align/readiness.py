"""The checks that a run makes before it moves, made while a person aligns: green or red, each with its remedy.

The devices are asked as by a run, and one recording is judged as there. Nothing moves, the light stays as it is.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from bench.base.failure import FORESEEN, Failure
from bench.extras.pages.align.open_bench import ANSWER_S, Bench
from bench.extras.pages.align.session import Session
from bench.measure.camera_kinds import camera_kind
from bench.measure.gates import ADVICE, Gate
from bench.plan.plan import Plan, load_documents, make_plan
from bench.record.as_data import as_data
from bench.record.events import RecordedData
from bench.stations.placeholders import find_placeholders
from drivers.light import LightSettings
from sequences.schema import RecordConfig
from sequences.script import Flicker, Gates, LightStep, Pose, RecordStep

Verdict = Literal["good", "bad", "open"]
"""``good`` and ``bad`` as checked; ``open`` if it could not be checked yet."""
Found = tuple[Verdict, str, str]
"""Verdict of a check, what it found, and what to do."""
_NO_REMEDY = "Correct this, then check again."
_SEE_FIGURES = "Compare the figures with what is expected beside them, then check again."
_SILENT = ("It did not answer in time.", "Check again. If this stays, press Try again.")


@dataclass(frozen=True)
class Check:
    """One check and what it found."""

    name: str  # What was checked, in a few words
    verdict: Verdict
    found: str
    remedy: str = ""  # What to do; empty if nothing is to be done

    def as_data(self) -> dict[str, str]:
        """Return the check as the page shows it."""
        return asdict(self)


def check_readiness(
    session: Session, *, sequence: str | None = None, station_file: str | None = None
) -> list[Check]:
    """Make all checks of a sequence on the station, or of the bench only; ``station_file`` None: the session's."""
    bench = session.bench
    checks = [_station(session), *_stage(bench), *_light(bench), *_camera(bench)]
    if sequence is None:
        return [*checks, *_recording(session, bench, None)]
    of_sequence, plan = _sequence(sequence, station_file or session.station.file)
    step, flicker = _first_recording(plan)
    checks += _recording(session, bench, step)
    if flicker is not None:
        checks.append(_light_of_sequence(session, bench, flicker))
    return [*checks, of_sequence]


def _station(session: Session) -> Check:
    missing = find_placeholders(session.station.tree)
    if missing:
        lines = "; ".join(f"line {fault.line}: {fault.path}" for fault in missing[:5])
        return Check("station file", "bad", f"Values are missing ({lines}).", "Fill them in.")
    return Check("station file", "good", f"{session.station.file} is complete.")


def _stage(bench: Bench) -> list[Check]:
    stage = bench.devices.stage
    if bench.stage.moving:
        return [Check("stage", "open", "The stage moves.", "Wait, then check again.")]

    def identity() -> Found:
        serials = ", ".join(f"{axis.name} {axis.serial or 'without serial'}" for axis in stage.identify())
        return "good", f"The controllers answer: {serials}.", ""

    def faults() -> Found:
        # As in a run: an axis that is not homed warns about that, so its faults are read after homing.
        if not stage.is_homed():
            return "open", "The stage is not homed; a run homes it first.", "Press Home."
        if stage_faults := list(stage.faults()):
            return "bad", f"{'; '.join(stage_faults)}.", "Clear the cause, then home the stage."
        return "good", "Homed; the controllers report no fault.", ""

    return [_made("stage: identity", identity), _made("stage: faults", faults)]


def _light(bench: Bench) -> list[Check]:
    light = bench.devices.light

    def identity() -> Found:
        light_identity = light.identify()
        serial = f", serial {light_identity.serial}" if light_identity.serial else ""
        return "good", f"{light_identity.maker} {light_identity.model}{serial} answers.", ""

    def faults() -> Found:
        if light_faults := list(light.faults()):
            return "bad", f"{'; '.join(light_faults)}.", "Look at the light, and remove the cause."
        return "good", "The light reports no fault.", ""

    return [_made("light: identity", identity), _made("light: faults", faults)]


def _camera(bench: Bench) -> list[Check]:
    control, camera = bench.camera, bench.devices.camera

    def identity() -> Found:
        result = bench.loop.on_camera(camera.identify).result(timeout=ANSWER_S)
        return "good", f"{result.maker} {result.model}, serial {result.serial}, answers.", ""

    def settings() -> Found:
        if control.reasons:
            return "bad", f"{'; '.join(control.reasons)}.", "Restart the camera."
        return "good", "Every setting reads back as it was set.", ""

    return [_made("camera: identity", identity), _made("camera: settings", settings)]


def _recording(session: Session, bench: Bench, step: RecordStep | None) -> list[Check]:
    """Make one recording as a run does it, and judge it by the gates of a step, or those that a step has by default."""
    reading = bench.light.reading
    if not reading.on or reading.settings is None:
        return [Check("recording", "open", "The light is off.", "Switch the light on, then check again.")]
    if bench.stage.moving:
        return [Check("recording", "open", "The stage moves.", "Wait, then check again.")]
    kind = camera_kind(session.station.value)
    frequency_hz = reading.settings.frequency_hz
    folder = Path(tempfile.mkdtemp(prefix="starbench-check-"))
    step = step or _step(reading.settings.waveform)
    path = folder / f"check{kind.ending}"
    try:
        facts = bench.loop.on_camera(
            lambda: kind.record(bench.devices.camera, path, step, frequency_hz)
        ).result(timeout=ANSWER_S + 2 * step.window_ms * 1e-3)
        measured = kind.measure(path, step, frequency_hz, session.station.value.target.pattern(), None)
        gates, others = kind.judge(as_data(facts, RecordedData), step, frequency_hz, measured)
    except TimeoutError:
        return [Check("recording", "bad", *_SILENT)]
    except FORESEEN as error:
        failure = Failure.of(error)
        return [Check("recording", "bad", failure.what, failure.remedy)]
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    checks = []
    if measured.fault:
        checks.append(
            Check(
                "recording: stars",
                "bad",
                measured.fault,
                _SEE_FIGURES,
            )
        )
    checks += [_gate(gate) for gate in gates if not (measured.fault and gate.name == "stars")]
    return checks + [Check("recording", "bad", f"{other}.", _NO_REMEDY) for other in others]


def _step(waveform: Any) -> RecordStep:
    """Return a record step with the values that a sequence has by default."""
    settings = dict(RecordConfig())
    settings["gates"] = Gates.from_settings(dict(settings["gates"]), waveform)
    return RecordStep(0, "align", (), Pose(0, "present pose", {}), **settings)


def _gate(gate: Gate) -> Check:
    value = f"{gate.value:.4g} {gate.unit}".strip()
    limit = gate.limit.replace(">=", "at least").replace("<=", "at most")
    measured = f"{value}; a run needs {limit} {gate.unit}".strip() + "."
    remedy = ADVICE.get(gate.name, _SEE_FIGURES)
    remedy = f"{remedy[0].upper()}{remedy[1:]}".rstrip(".") + "."
    bad = gate.verdict == "fail"
    return Check(f"recording: {gate.name}", "bad" if bad else "good", measured, remedy if bad else "")


def _sequence(sequence: str, station_file: str) -> tuple[Check, Plan | None]:
    """Plan a sequence on the station, without devices."""
    try:
        plan = make_plan(*load_documents(sequence, station_file))
    except FORESEEN as error:
        return Check("sequence", "bad", Failure.of(error).what, "Correct the file."), None
    if plan.faults:
        more = f" And {len(plan.faults) - 1} more." if len(plan.faults) > 1 else ""
        return Check("sequence", "bad", f"{plan.faults[0]}{more}", "Correct the file."), plan
    length = f"{len(plan.poses)} poses, about {plan.duration_s / 60:.0f} min."
    return Check("sequence", "good", length), plan


def _first_recording(plan: Plan | None) -> tuple[RecordStep | None, Flicker | None]:
    """Return the first step of a plan that records, and the light that it has then."""
    flicker = None
    for step in plan.script if plan is not None else ():
        if isinstance(step, LightStep):
            flicker = step.flicker
        elif isinstance(step, RecordStep):
            return step, flicker
    return None, None


def _light_of_sequence(session: Session, bench: Bench, wanted: Flicker) -> Check:
    """Compare the light of a sequence with the present one, with which the recording was made."""
    wanted = camera_kind(session.station.value).light_for(wanted)
    settings = bench.light.reading.settings
    expected = session.station.value.light.settings(wanted)
    name = "light of the sequence"
    if settings == expected:
        return Check(name, "good", "The light is set as the sequence sets it.")
    of_light = _light_text(settings) if settings else "no settings"
    text = f"The sequence has {_light_text(expected)}; the light has {of_light}."
    return Check(
        name, "open", text, "Set the light as the sequence does, or write it into the sequence; check again."
    )


def _light_text(settings: LightSettings) -> str:
    if settings.waveform == "steady":
        return f"a steady {settings.high_v:.3g} V"
    flicker = f"{settings.waveform} {settings.frequency_hz:g} Hz, duty {settings.duty_percent:g} %"
    return f"{flicker}, {settings.high_v:.3g} V"


def _made(name: str, check: Callable[[], Found]) -> Check:
    """Make a check; an error of its device is its result."""
    try:
        return Check(name, *check())
    except TimeoutError:
        return Check(name, "bad", *_SILENT)
    except FORESEEN as error:
        failure = Failure.of(error)
        return Check(name, "bad", failure.what, failure.remedy or _NO_REMEDY)
