"""Rows of the report's tables about the run as a whole: item, inputs, software, alerts, deviations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from bench.base.failure import Failure
from bench.record.device_end import DeviceEnd
from bench.record.events import LedgerPlace
from bench.record.results import (
    Numbers,
    ParallaxData,
    ReadingsUse,
    Results,
    RunData,
    StatedCheck,
    StatedPassport,
)
from bench.report.pose_tables import gates
from bench.wording.camera_check import check_sentences
from bench.wording.causes import cause_sentences
from bench.wording.earlier_runs import earlier_runs
from bench.wording.goals import goals_missed
from bench.wording.numbers import NOTHING, exact, moment, number, plus_minus, value_text, with_uncertainty
from bench.wording.target_words import words_of
from calib.model.result_parts import GimbalEstimate

Rows = list[tuple[str, str]]


_ORIGINS = {
    "sequence": "file named by the sequence",
    "station": "file named by the station",
    "station certificate": "stated in the station file",
    "command line": "file named on the command line",
}


_NO_BORESIGHT = "not determined: two axes of the stage must move, and the sign of no axis may be wrong"
_UNIT_ENDINGS = {"_hz": "Hz", "_c": "°C", "_v": "V", "_percent": "%", "_lux": "lx", "_us": "µs", "_s": "s"}


def passport_rows(passport: StatedPassport | None) -> Rows:
    """List what the results state about the collimator's passport; none without a passport."""
    if not passport:
        return []
    sigma = passport.sigma
    kept = ("x", "y", "r") if len(passport.values) > 1 else tuple(passport.values)
    values = [
        f"{name} = {exact(value)} mm, standard uncertainty {exact(sigma[name])} mm"
        for name, value in passport.values.items()
        if name in kept
    ]
    if others := [name for name in passport.values if name not in kept]:
        values.append(f"and {', '.join(others)}")
    stated = [
        f"number {passport.number}" if passport.number else "",
        f"of the collimator {passport.collimator}" if passport.collimator else "",
        f"dated {passport.date}" if passport.date else "",
        f"valid until {passport.valid_until}" if passport.valid_until else "",
        f"at {passport.temperature_c:g} °C" if passport.temperature_c is not None else "",
        f"{_ORIGINS.get(passport.source, passport.source)} ({passport.name})",
    ]
    rows = [
        ("Collimator passport", ", ".join(part for part in stated if part)),
        ("Values of the passport", "; ".join(values)),
        ("SHA-256 of the passport", passport.sha256),
    ]
    if passport.source != "station certificate":  # which has no file of its own
        rows.append(("Seal of the passport", passport.sealed_by or "none: the file is not sealed"))
    return rows


def readings_rows(readings: ReadingsUse | None, estimate: GimbalEstimate | None) -> Rows:
    """List whether the gimbal's readings entered the calibration, with what statement, or why they did not."""
    if not readings:
        return []
    what = f"compared with the result only. {readings.why_not}"
    if readings.entered:
        what = f"entered the adjustment as measurements{_agreement(estimate)}"
    rows = [("Gimbal readings", what)]
    stated, bound = readings.statement, readings.bound
    if stated:
        text = (
            f"reading {exact(stated.reading_sigma_deg)}°, scale {exact(stated.scale_sigma)}, "
            f"eccentricity {exact(stated.eccentricity_deg)}° (standard uncertainties; source: {stated.source})"
        )
        rows.append(("Uncertainty of the readings", text + (f"; {_bound(bound)}" if bound else "")))
    return rows


def check_rows(check: StatedCheck | None) -> Rows:
    """List what the check of a stated calibration found: one row, or none without a check."""
    if check is None:
        return []
    stated = check.stated
    sentences = [*check_sentences(check)]
    if not stated.get("uncertainty"):
        sentences.append("U is that of the new views alone: the file states no uncertainty.")
    return [(f"Check of the calibration {stated.get('name', '')}", " ".join(sentences))]


def boresight_rows(results: Results) -> Rows:
    """List how the camera is turned against the stage's flange and the faces of its mount, if readings took part."""
    calibration = results["calibration"]
    estimate, boresight = calibration.get("gimbal"), calibration.get("boresight")
    if boresight is None:
        return [("Boresight", _NO_BORESIGHT)] if estimate and estimate.entered else []
    turned = _degrees("xyz", boresight["vector_deg"], boresight["expanded_deg"])
    looks = _degrees(("right", "down"), boresight["right_down_deg"], boresight["sight_expanded_deg"])
    faces = [
        (
            f"Boresight: middle of the image against the face {face.name}",
            _degrees(("angle",), [face.angle_deg], [face.expanded_deg]),
        )
        for face in results.get("mount_faces", ())
    ]
    return [
        ("Boresight: the camera on the stage's flange, rotation vector", turned),
        ("Boresight: the middle of the image looks", f"{looks} of the flange's axis"),
        *faces,
    ]


def _degrees(names: Sequence[str], values: Sequence[float], expanded: Sequence[float]) -> str:
    """Return angles with their U."""
    texts = [with_uncertainty(value, own) for value, own in zip(values, expanded, strict=True)]
    pairs = zip(names, texts, strict=True)
    return ", ".join(f"{name} {value}° \N{PLUS-MINUS SIGN} {own}°" for name, (value, own) in pairs)


def parallax_rows(parallax: ParallaxData | None) -> Rows:
    """List where the entrance pupil is, and the parallax that follows, or why the parallax test has no result."""
    if not parallax:
        return []
    if "why_not" in parallax:
        return [("Parallax test: no result", str(parallax["why_not"]))]
    says = [str(sentence).replace(" +- ", " \N{PLUS-MINUS SIGN} ") for sentence in parallax["says"]]
    off = parallax["pupil_off_pivot_mm"]
    shown = plus_minus(off["value"], 2 * off["sigma"], "mm")
    rows = [
        ("Entrance pupil in front of the pivot", f"{shown} (k = 2)"),
        ("Parallax: how the beam moves when the camera turns", " ".join(says)),
    ]
    if without := parallax["without_rim"]:
        rows.append(("Poses with the rim out of view", ", ".join(without)))
    return rows


def _agreement(estimate: GimbalEstimate | None) -> str:
    """Return how the readings agree with the stars."""
    if not estimate:
        return ""
    text = (
        f"; chi-square {number(estimate.chi_square, 3)} with {estimate.degrees_of_freedom} degrees of freedom, "
        f"{number(3600 * estimate.rms_deg, 2)} arc seconds RMS"
    )
    if estimate.scatter <= 1:
        return text
    entered = f"; entered with a standard uncertainty of {number(estimate.reading_sigma_deg, 3)}°"
    return f"{text}{entered}, because they scatter more than stated"


def _bound(bound: Numbers) -> str:
    shown = {name: exact(value) for name, value in bound.items()}
    text = (
        f"parallax bounded by a defocus of {shown['defocus']}, standard uncertainty {shown['defocus_sigma']}, and a"
        f" pupil {shown['pupil_off_pivot_mm']} mm off the pivot, standard uncertainty"
        f" {shown['pupil_off_pivot_sigma_mm']} mm"
    )
    if "pupil_beside_axes_mm" in bound:
        text += f" (beside the axes {shown['pupil_beside_axes_mm']} mm)"
    if "parallax" not in bound:
        return text
    share, sigma = (number(100 * bound[name], 2) for name in ("parallax", "parallax_sigma"))
    return f"{text}: {share} % of the focal length, standard uncertainty {sigma} %"


def conditions(of_parts: Mapping[str, Any]) -> list[tuple[str, str]]:
    """List the settings of light and camera, and the temperature."""
    return [
        (f"{part}: {_readable(key)}", _with_unit(key, value))
        for part, settings in of_parts.items()
        for key, value in settings.items()
    ]


def devices(of_parts: Mapping[str, Any]) -> list[tuple[str, str, str, str, str]]:
    """List name, model, serial number, firmware and details that the devices reported."""
    rows = []
    for part, identities in of_parts.items():
        for identity in identities if isinstance(identities, list) else [identities]:
            if "serial" not in identity:  # settings, not a device
                continue
            facts = dict(identity)
            name = f"{part}: {facts.pop('name')}" if "name" in facts else part
            model = " ".join(str(facts.pop(key)) for key in ("maker", "model") if facts.get(key))
            serial, firmware = value_text(facts.pop("serial")), value_text(facts.pop("firmware", None))
            details = ", ".join(
                f"{_readable(key)} {value_text(value)}" for key, value in facts.items() if value is not None
            )
            rows.append((name, model or NOTHING, serial, firmware, details))
    return rows


def connections(identified: Mapping[str, Any]) -> list[tuple[str, str]]:
    """List what the devices answered about their cables; empty if the run did not ask."""
    return [(_readable(name), str(value)) for name, value in (identified.get("connections") or {}).items()]


def left(ends: Sequence[DeviceEnd]) -> list[tuple[str, str, str]]:
    """List device, state, and answer (or what may be the case) after the last step that needs devices."""
    return [(end.device, end.state, " ".join(filter(None, (end.said, end.advice)))) for end in ends]


def _readable(key: str) -> str:
    for ending in _UNIT_ENDINGS:
        key = key.removesuffix(ending)
    return key.replace("_", " ")


def _with_unit(key: str, value: Any) -> str:
    unit = next((f" {unit}" for ending, unit in _UNIT_ENDINGS.items() if key.endswith(ending)), "")
    printed = value_text(value)
    return printed if printed == NOTHING else printed + unit


def identification(results: Results) -> list[tuple[str, str]]:
    """Identify what was calibrated, by whom, where and when (ISO/IEC 17025, 7.8.2.1)."""
    run = results["run"]
    camera = (results.get("devices") or {}).get("camera") or {}
    ledger, collimator = run.get("ledger"), run.get("collimator")
    item = " ".join(str(camera[key]) for key in ("maker", "model", "sensor") if camera.get(key))
    return [
        ("Item", item or NOTHING),
        ("Serial number", value_text(camera.get("serial"))),
        ("Firmware", value_text(camera.get("firmware"))),
        ("Lens", value_text(camera.get("lens"))),
        *([("Collimator", _collimator(collimator))] if collimator else []),
        *([("Target", _target(run["target"]))] if run.get("target") else []),
        ("Laboratory", value_text(run.get("laboratory"))),
        ("Operator", value_text(run.get("operator"))),
        ("Sequence", value_text(run.get("sequence"))),
        ("Station", value_text(run.get("station"))),
        *_times(run),
        *(_ledger_rows(ledger) if ledger else []),
    ]


def inputs(results: Results) -> list[tuple[str, str]]:
    """List what the calibration used besides its recordings: the passport of the collimator, the gimbal's readings."""
    readings = results.get("gimbal_readings")
    if readings and words_of(results).is_board and not readings.entered:
        readings = None  # the board was moved, not the camera
    return [
        *passport_rows(results.get("passport")),
        *readings_rows(readings, results["calibration"].get("gimbal")),
    ]


def _times(run: RunData) -> list[tuple[str, str]]:
    """List when the run was, or when files were calibrated without devices."""
    if run.get("offline"):
        of_run = [("Calibrated from run", str(run["of_run"]))] if run.get("of_run") else []
        return [*of_run, ("Calibrated, without devices", moment(run.get("calibrated_utc")))]
    return [("Started", moment(run.get("started_utc"))), ("Finished", moment(run.get("finished_utc")))]


def _collimator(details: Mapping[str, Any]) -> str:
    """Return in one line what the station file says about the collimator."""
    parts = []
    if "serial" in details:
        parts.append(f"serial number {details['serial']}")
    if "nominal_r_mm" in details:
        parts.append(f"nominal focal length {details['nominal_r_mm']:g} mm")
    certificate = details.get("certificate")
    if isinstance(certificate, Mapping):
        parts.append(f"certificate {certificate['number']}")
    elif certificate:
        parts.append(f"certificate {certificate}")
    if "temperature_c" in details:
        parts.append(f"at {details['temperature_c']:g} °C")
    return ", ".join(parts) or NOTHING


def _target(details: Mapping[str, str]) -> str:
    """Return in one line what the station file says about the target as an object."""
    serial = [f"serial number {details['serial']}"] if "serial" in details else []
    return ", ".join([*serial, *([str(details["description"])] if "description" in details else [])])


def software(results: Results) -> list[tuple[str, str]]:
    """List the programs that computed the result, and the seed of a simulated bench."""
    run = results["run"]
    plugins = run.get("plugins") or {}
    rows = [
        (str(name), f"{version} (plug-in: {', '.join(plugins[name])})" if name in plugins else str(version))
        for name, version in (run.get("software") or {}).items()
    ]
    if run.get("seed") is not None:
        rows.append(("seed", str(run["seed"])))
    return rows


def alerts(results: Results) -> list[str]:
    """List what a reader must know before use: doubts, gates and goals that were not met, every deviation."""
    calibration = results["calibration"]
    known = {*calibration.get("remarks", ()), *cause_sentences(results.get("causes", ()))}
    doubts = [note for note in calibration["notes"] if note not in known]
    details = [
        f"Gate {row.name}: {row.verdict} ({row.values}, limit {row.limit}; {row.count} passed)."
        for row in gates(results.get("gates") or [])
        if row.verdict != "pass"
    ]
    missed = goals_missed(results.get("untils") or [])
    return details + missed + doubts + deviations(results)


def deviations(results: Results) -> list[str]:
    """List the errors that ended the run before it was resumed, and every departure from the sequence."""
    failures = [_failure_text(error) for error in results.get("failures") or []]
    return failures + [str(deviation) for deviation in results.get("deviations") or []]


def _failure_text(error: Failure) -> str:
    place = f" ({error.where})" if error.where else ""
    return f"The run failed and was resumed. {error.kind}{place}: {error.what}"


def _ledger_rows(ledger: LedgerPlace) -> list[tuple[str, str]]:
    place = f"{ledger['number']} of this bench; earlier runs of this camera: {earlier_runs(ledger)}"
    rows = [("Number of the run", place), ("Line of the ledger", ledger["head"])]
    return rows + [("Ledger", f"BROKEN. {fault}") for fault in ledger.get("faults") or []]
