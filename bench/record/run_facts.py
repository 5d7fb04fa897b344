"""What the index keeps of a run: the facts of its row, its parameters, and details.

`results.json` is read only if its hash is the one in the journal. Nothing is written.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, TypedDict

from bench.base.errors import BenchError
from bench.record.coverage import Estimate, estimates, parameters_data
from bench.record.events import (
    CauseData,
    DeviceData,
    Event,
    LightSettingsData,
    UntilDecided,
    VerdictData,
    Written,
)
from bench.record.history import Attempt, History
from bench.record.journal_line import Entry
from bench.record.run_folder import PASSPORT_COPY, RESULTS, SEQUENCE_COPY, STATION_COPY
from bench.record.stored_run import StoredRun

IN_LEDGER, NOT_IN_LEDGER, NO_LEDGER = "entered", "not in the ledgers", "no ledger"


@dataclass(frozen=True)
class IndexedRun:
    """A run as a list of runs states it; the defaults are those of a run without a journal."""

    folder: str = ""
    id: str = ""
    sequence: str = ""  # Name of the sequence
    station: str = ""  # Name of the station
    camera: str = ""  # Serial number of the camera; empty while none has answered
    operator: str | None = None  # Name of the operator, if it is known
    simulated: bool = False  # Whether any device is simulated
    rehearsal: bool = False  # Whether it is a rehearsal
    begun_utc: str = ""  # Time of the start, ISO 8601
    how: str = ""  # ``finished``, ``aborted``, ``failed``, ``running``, or ``cut off``
    sealed: bool = False  # Whether it is sealed
    accepted: int = 0  # Number of recorded poses
    recordings: int = 0  # Number of recordings made for them, also lost ones
    deviations: int = 0  # Number of deviations from the sequence
    # Temperature of the camera, mean of the accepted recordings, degrees Celsius; None if the camera does not
    # report it.
    temperature_c: float | None = None
    model: str | None = None  # Model of its calibration; None without one
    rms_px: float | None = None  # Root mean square of the residuals, px; None without a calibration
    parameters: Mapping[str, Estimate] = field(default_factory=dict)  # By name
    # The common k of its expanded uncertainties; None without a calibration, or if an earlier version made it.
    coverage_factor: float | None = None
    verdict: VerdictData | None = None  # Of its report; None without one
    causes: Sequence[CauseData] = ()  # What a person did to the bench, the most probable first
    ledger_number: int | None = None  # Its number in the ledger of its bench; None for a rehearsal
    ledger_head: str | None = None  # Hash of its line in the ledger; None for a rehearsal

    @property
    def kind(self) -> str:
        """What it is: ``measured``, ``simulated`` or ``rehearsed``."""
        return "rehearsed" if self.rehearsal else "simulated" if self.simulated else "measured"

    def to_dict(self) -> dict[str, Any]:
        """Return the run as JSON carries it."""
        return {**vars(self), "parameters": parameters_data(self.parameters)}


@dataclass(frozen=True)
class RunPlace:
    """Where a run stands in the ledgers."""

    bench: str = ""  # Name of the bench; empty if no ledger enters the run
    ledger: str = ""  # Identity of the ledger; empty as ``bench``
    # ``entered``, ``not in the ledgers``, or ``no ledger`` for a rehearsal and for a run without a place.
    state: str = NO_LEDGER


def run_facts(history: History, folder: Path) -> IndexedRun:
    """Return the row of a run in a list of runs, by its journal. ``how`` is empty if the journal has no end."""
    solved, started = history.solved, history.started
    return IndexedRun(
        folder=str(folder),
        id=started.get("id", folder.name),
        sequence=started.get("sequence", ""),
        station=started.get("station", ""),
        camera=history.devices.get("camera", {}).get("serial", ""),
        operator=started.get("operator"),
        simulated=bool(started.get("simulated", False)),
        rehearsal=bool(started.get("rehearsal", False)),
        begun_utc=history.started_utc,
        how=history.ended,
        accepted=len(history.accepted()),
        recordings=len(history.attempts) + sum(history.lost.values()),
        deviations=len(history.deviations),
        temperature_c=_mean(_reported(history, "temperature_c")),
        model=solved.get("model"),
        rms_px=solved.get("rms_px"),
        parameters=estimates(solved),
        coverage_factor=solved.get("coverage_factor"),
        verdict=history.verdict,
        causes=list(solved.get("causes", ())),
        ledger_number=history.ledger.get("number"),
        ledger_head=history.ledger.get("head"),
    )


class RunConditions(TypedDict):
    """Conditions of the accepted recordings of a run; None if not known."""

    temperature_min_c: float | None
    temperature_max_c: float | None
    illumination_lux: float | None
    light_frequency_hz: float | None
    flicker_hz: float | None
    events: int | None
    recordings_bytes: int | None
    stars: int


class ResultFacts(TypedDict):
    """What of a run only ``results.json`` states, and what is wrong with that file; None if not known."""

    laboratory: str | None
    collimator_serial: str | None
    target_serial: str | None
    passport_number: str | None
    degrees_of_freedom: float | None
    corner_expanded_px: float | None
    conformity: Literal["PASS", "FAIL"] | None
    results_fault: str | None


class JournalDetails(RunConditions):
    """What the journal states beyond the row of the index; None if not known."""

    ended_utc: str | None
    camera_type: str  # Maker and model, also of stages and light; may be empty
    camera_sensor: str | None
    camera_firmware: str | None
    camera_lens: str | None
    image_width_px: int | None
    image_height_px: int | None
    stage_types: Sequence[str]
    stage_serials: Sequence[str]
    light_type: str
    light_serial: str | None
    converged: bool | None
    parameters: Sequence[str]
    resumed: int
    recordings_lost: int
    poses_skipped: int
    seed: int | None
    software: Mapping[str, str]
    sequence_sha256: str | None
    station_sha256: str | None
    passport_sha256: str | None
    journal_head: str | None
    deviations: Sequence[str]
    untils: Sequence[UntilDecided]  # What each ``until`` decided, in order
    # What a person did to the bench, the most probable first; an earlier version kept none.
    results_sha256: str | None  # As the journal states it
    warnings: Sequence[str]


class RunDetails(JournalDetails, ResultFacts):
    """What the table of runs has beyond the row of the index; None if not known."""


def journal_details(
    history: History, entries: Sequence[Entry], parameters: Mapping[str, Estimate]
) -> JournalDetails:
    """Return the details of a run that its journal states; ``parameters`` are those of its `run_facts`."""
    camera, light = history.devices.get("camera", {}), history.devices.get("light", {})
    stages = [identity for identity in history.devices.get("stage", ()) if isinstance(identity, Mapping)]
    hashes = history.started.get("sha256", {})
    return {
        "ended_utc": entries[-1].utc if history.ended and entries else None,
        "camera_type": _type_of(camera),
        "camera_sensor": _text(camera.get("sensor")),
        "camera_firmware": _text(camera.get("firmware")),
        "camera_lens": _text(camera.get("lens")),
        "image_width_px": camera.get("width"),
        "image_height_px": camera.get("height"),
        "stage_types": [_type_of(stage) for stage in stages],
        "stage_serials": [_text(stage.get("serial")) or "" for stage in stages],
        "light_type": _type_of(light),
        "light_serial": _text(light.get("serial")),
        "converged": history.solved.get("converged"),
        "parameters": list(parameters),
        "resumed": history.resumed,
        "recordings_lost": sum(history.lost.values()),
        "poses_skipped": len(history.skipped),
        "seed": history.started.get("seed"),
        "software": dict(history.started.get("software", {})),
        "sequence_sha256": hashes.get(SEQUENCE_COPY),
        "station_sha256": hashes.get(STATION_COPY),
        "passport_sha256": hashes.get(PASSPORT_COPY),
        "journal_head": entries[-1].hash if entries else None,
        "deviations": list(history.deviations),
        "untils": list(history.decisions),
        **_conditions(history),
        "results_sha256": _named_hash(entries),
        "warnings": _warnings(history, parameters),
    }


def with_results(details: JournalDetails, folder: Path) -> RunDetails:
    """Return the details of a run with those of its ``results.json``, if that is the file which the journal names."""
    results, fault = _results(details["results_sha256"], folder)
    try:
        facts = _from_results(results, fault)
    except (AttributeError, LookupError, TypeError, ValueError):
        results, fault = None, f"{RESULTS} was written by another program."
        facts = _from_results(results, fault)
    notes = _part(_part(results).get("calibration")).get("notes", [])
    warnings = [str(note) for note in notes] if isinstance(notes, list) else []
    warnings += [*details["warnings"], *([fault] if fault else [])]
    return {**details, **facts, "warnings": warnings}


def _conditions(history: History) -> RunConditions:
    warm, accepted = _reported(history, "temperature_c"), list(history.accepted().values())
    first = accepted[0].stored.get("light", {}) if accepted else LightSettingsData()
    checks = [attempt.checked for attempt in accepted if attempt.checked is not None]
    flicker = [_part(check.get("measured")).get("flicker_hz") for check in checks]
    return {
        "temperature_min_c": min(warm, default=None),
        "temperature_max_c": max(warm, default=None),
        "illumination_lux": _mean(_reported(history, "illumination_lux")),
        "light_frequency_hz": first.get("frequency_hz"),
        "flicker_hz": _mean([float(hz) for hz in flicker if hz is not None]),
        "events": _total(accepted, "events"),
        "recordings_bytes": _total(accepted, "bytes"),
        "stars": sum(int(check.get("stars", 0)) for check in checks),
    }


def _from_results(stored: Mapping[str, Any] | None, fault: str | None) -> ResultFacts:
    results = _part(stored)
    run, calibration = _part(results.get("run")), _part(results.get("calibration"))
    corner = _part(_part(results.get("projection")).get("worst_corner"))
    conformity = _part(results.get("conformity"))
    passed = conformity.get("passed")
    return {
        "laboratory": _text(run.get("laboratory")),
        "collimator_serial": _text(_part(run.get("collimator")).get("serial")),
        "target_serial": _text(_part(run.get("target")).get("serial")),
        "passport_number": _text(_part(results.get("passport")).get("number")),
        "degrees_of_freedom": calibration.get("degrees_of_freedom"),
        "corner_expanded_px": corner.get("expanded_px"),
        "conformity": None if passed is None else "PASS" if passed else "FAIL",
        "results_fault": fault,
    }


def _warnings(history: History, parameters: Mapping[str, Estimate]) -> list[str]:
    warnings = [f"The ledger had a break: {row}" for row in history.ledger.get("faults", ())]
    warnings += [f"The computer was too busy: {history.busy}."] if history.busy else []
    unusable = [name for name, row in parameters.items() if not (math.isfinite(row.value) and row.sigma > 0)]
    return [*warnings, *(f"{name} has no usable value or uncertainty." for name in unusable)]


def _named_hash(entries: Sequence[Entry]) -> str | None:
    """Return the hash of results.json in the last line about written files."""
    for entry in reversed(entries):
        if entry.event == Event.WRITTEN:
            return _text(_part(entry.of(Written).get("files")).get(RESULTS))
    return None


def _results(named: str | None, folder: Path) -> tuple[Mapping[str, Any] | None, str | None]:
    """Return results.json of a hash, None where it cannot be used, and what is wrong with it as a sentence."""
    if named is None:
        return None, None
    run = StoredRun(folder)
    try:
        if hashlib.sha256(run.results_bytes).hexdigest() != named:
            return None, f"{RESULTS} was changed: its SHA-256 is not the one in the journal."
        results = run.results_as_written
    except BenchError as error:
        return None, f"{RESULTS} cannot be read: {error.what}"
    return results, None


def _type_of(device: DeviceData) -> str:
    """Return maker and model of a device."""
    return " ".join(text for key in ("maker", "model") if (text := _text(device.get(key))))


def _part(part: object) -> Mapping[str, Any]:
    """Return a part of what a file holds; an empty one where the file has none, or something else there."""
    return part if isinstance(part, Mapping) else {}


def _text(value: object) -> str | None:
    return None if value is None or value == "" else str(value)


def _reported(history: History, name: Literal["temperature_c", "illumination_lux"]) -> list[float]:
    """Return a number that the camera reported with each accepted recording, where it did."""
    stored = [attempt.stored.get("facts", {}).get(name) for attempt in history.accepted().values()]
    return [float(t) for t in stored if isinstance(t, int | float) and math.isfinite(t)]


def _mean(known: Sequence[float]) -> float | None:
    return sum(known) / len(known) if known else None


def _total(accepted: Sequence[Attempt], name: Literal["events", "bytes"]) -> int | None:
    known = [attempt.stored.get("facts", {}).get(name) for attempt in accepted]
    return sum(int(n) for n in known if n is not None) if any(n is not None for n in known) else None
