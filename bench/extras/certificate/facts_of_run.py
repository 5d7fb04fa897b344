"""What a certificate takes from results.json; nothing of this is typed by hand. No file, no clock.

Calculated numbers have nine digits, so that they are the same on another computer.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from datetime import datetime
from typing import Any

from bench.extras.certificate.budget_rows import expanded, nine_digits, print_plain, print_result, with_unit
from bench.extras.certificate.certificate_data import (
    Camera,
    Condition,
    Covariance,
    Deviation,
    FurtherResult,
    Result,
    sha256,
)
from bench.extras.certificate.lab_config import ItemConfig
from bench.extras.certificate.limits import limits_of_others
from bench.record.events import LightSettingsData
from bench.record.measured_facts import GateData
from bench.record.results import (
    BoresightData,
    CalibrationData,
    CameraConditions,
    Direction,
    Results,
    WorstCorner,
)
from bench.record.stored_calibration import camera_covariance, camera_of
from bench.wording.parameters import unit_of
from calib.uncertainty.projection_uncertainty import URAD_PER_ARCSEC, projection_uncertainty

PROBABILITY = 0.9545  # Of a normal distribution within two sigmas (JCGM 100, table G.1)
_NAMES = {
    "fx": "focal length along x",
    "fy": "focal length along y",
    "cx": "principal point, x",
    "cy": "principal point, y",
    "p1": "decentring distortion, first",
    "p2": "decentring distortion, second",
}
_DEGREE = "\N{DEGREE SIGN}C"
_SUFFIXES = {
    "_hz": "Hz",
    "_percent": "%",
    "_v": "V",
    "_ms": "ms",
    "_us": "\N{MICRO SIGN}s",
    "_db": "dB",
    "_deg": "\N{DEGREE SIGN}",
    "_c": _DEGREE,
}
"""Units by the end of a setting's name."""


def results_of(results: Results, customer_supplied: frozenset[str] = frozenset()) -> tuple[Result, ...]:
    """Return the camera's values, each with its expanded uncertainty, in the order of results.json."""
    calibration = results["calibration"]
    return tuple(
        _result(calibration, symbol, float(value), supplied=symbol in customer_supplied)
        for symbol, value in calibration["camera"].items()
    )


def _result(calibration: CalibrationData, symbol: str, value: float, *, supplied: bool) -> Result:
    own, unit = expanded(calibration, symbol), unit_of(symbol)
    shown, uncertainty = print_result(value, own.U)
    return Result(
        symbol=symbol,
        name=_NAMES.get(symbol, f"coefficient {symbol} of the distortion"),
        value=value,
        unit=unit,
        u=nine_digits(own.u),
        U=float(uncertainty),
        k=nine_digits(own.k),
        p=PROBABILITY,
        nu_eff=None if own.nu_eff is None else nine_digits(own.nu_eff),
        printed_value=shown,
        printed_uncertainty=uncertainty,
        text=f"{with_unit(shown, unit)} \N{PLUS-MINUS SIGN} {with_unit(uncertainty, unit)}",
        customer_supplied=supplied,
    )


def covariance_of(results: Results) -> Covariance:
    """Return the joint covariance of results.json."""
    calibration = results["calibration"]
    symbols = tuple(calibration["camera"])
    names, matrix = calibration["covariance"]["names"], calibration["covariance"]["matrix"]
    at = {symbol: names.index(symbol) for symbol in symbols}
    return Covariance(
        symbols,
        tuple(unit_of(symbol) for symbol in symbols),
        tuple(tuple(nine_digits(float(matrix[at[i]][at[j]])) for j in symbols) for i in symbols),
    )


def further_of(results: Results) -> tuple[FurtherResult, ...]:
    """Return the numbers about the calibration: uncertainty of the projection, residuals, number of views."""
    calibration = results["calibration"]
    projection, rows = results.get("projection"), _at_centre(calibration)
    if projection is not None:
        worst, name = projection.worst_corner, "expanded uncertainty of the projection"
        rows += _projection("projection_median", f"{name}, median over the image", projection.median)
        in_corner = f"{name} in the worst corner ({worst.corner})"
        rows += _projection("projection_worst_corner", in_corner, worst)
    rows += _boresight(calibration.get("boresight"))
    rows.append(_further("rms", "RMS of the residuals (no accuracy)", float(calibration["rms_px"]), "px"))
    rows.append(_further("mean", "mean of the residuals (no accuracy)", float(calibration["mean_px"]), "px"))
    rows.append(
        FurtherResult(
            "views", "number of views", float(len(calibration["views"])), "1", str(len(calibration["views"]))
        )
    )
    return tuple(rows)


def _at_centre(calibration: CalibrationData) -> list[FurtherResult]:
    """Return the expanded uncertainty of the projection in the centre of the image."""
    covariance = camera_covariance(calibration["camera"], calibration.get("covariance"))
    if covariance is None:
        return []
    projection_map = projection_uncertainty(
        camera_of(calibration["camera"], calibration["image_size"]), covariance
    )
    row, column = (size // 2 for size in projection_map.sigma_px.shape)
    k = float(calibration["coverage_factor"])
    centre = Direction(
        k * float(projection_map.sigma_px[row, column]),
        k * float(projection_map.sigma_arcsec[row, column]) * URAD_PER_ARCSEC,
    )
    return _projection(
        "projection_centre", "expanded uncertainty of the projection in the centre of the image", centre
    )


def _boresight(boresight: BoresightData | None) -> Iterator[FurtherResult]:
    """Yield the rotation of the camera against the stage's flange, each angle followed by its U."""
    if boresight is None:
        return
    turned = [(f"rotation vector from flange to camera, {axis}", axis) for axis in "xyz"]
    looks = [(f"middle of the image, {where} of the flange's axis", where) for where in ("right", "down")]
    angles = zip(
        (*turned, *looks),
        (*boresight["vector_deg"], *boresight["right_down_deg"]),
        (*boresight["expanded_deg"], *boresight["sight_expanded_deg"]),
        strict=True,
    )
    for (name, short), value, own_u in angles:
        text, own = print_result(value, own_u)
        yield FurtherResult(
            f"boresight_{short}", f"boresight: {name}", nine_digits(value), "deg", with_unit(text, "deg")
        )
        yield FurtherResult(
            f"boresight_{short}_expanded",
            f"boresight: expanded uncertainty of that angle ({short})",
            nine_digits(own_u),
            "deg",
            with_unit(own, "deg"),
        )


def _projection(id_: str, name: str, direction: Direction | WorstCorner) -> list[FurtherResult]:
    return [
        _further(id_, name, direction.expanded_px, "px"),
        _further(id_, name, direction.expanded_urad / URAD_PER_ARCSEC, "arcsec"),
    ]


def _further(id_: str, name: str, value: float, unit: str) -> FurtherResult:
    return FurtherResult(id_, name, nine_digits(value), unit, with_unit(print_plain(value), unit))


def is_unnamed(results: Results) -> bool:
    """Return whether the camera did not report a serial number. The laboratory then identifies it."""
    return not results["devices"]["camera"].get("serial")


def _light_and_camera(results: Results) -> tuple[LightSettingsData, CameraConditions]:
    """Return the settings of light and camera as the run read them back; empty if it did not."""
    conditions = results.get("conditions")
    return (conditions["light"], conditions["camera"]) if conditions else ({}, {})


def camera_identity(results: Results, item: ItemConfig) -> Camera:
    """Return the camera as it identified itself in the run, or else as section ``item`` of lab.yaml does."""
    camera = dict(results["devices"]["camera"])
    if is_unnamed(results):
        camera |= {"maker": item.maker, "model": item.model, "serial": item.serial or ""}
    _, settings = _light_and_camera(results)
    biases = settings.get("biases") or {}
    stated = json.dumps(biases, sort_keys=True, separators=(",", ":")).encode()
    return Camera(
        **{name: str(camera.get(name) or "") for name in ("maker", "model", "sensor", "serial", "firmware")},
        image_size=tuple(int(size) for size in results["calibration"]["image_size"]),
        biases=tuple(f"{name} = {biases[name]}" for name in sorted(biases)),
        biases_sha256=sha256(stated) if biases else "",
    )


def conditions_of(results: Results) -> tuple[Condition, ...]:
    """Return the recorded conditions: temperatures, light, event rate, camera settings."""
    light, camera = _light_and_camera(results)
    attempts = [taken for pose in results["poses"] for taken in pose["attempts"] if taken["accepted"]]
    rows = [
        _range("camera temperature", [attempt.get("temperature_c") for attempt in attempts], _DEGREE),
        _value(
            "collimator temperature (station)",
            (results["run"].get("collimator") or {}).get("temperature_c"),
            _DEGREE,
        ),
        _range(
            "measured frequency of the light", [pose.get("flicker_hz") for pose in results["poses"]], "Hz"
        ),
        _text("light", [_setting(name, value) for name, value in sorted(light.items())]),
        _range("event rate", [attempt.get("event_rate_mev_s") for attempt in attempts], "Mev/s"),
        _value("illumination", camera.get("illumination_lux"), "lx"),
        _text(
            "settings of the camera",
            [
                _setting(name, value)
                for name, value in sorted(camera.items())
                if name not in ("biases", "temperature_c", "illumination_lux")
            ],
        ),
    ]
    return tuple(row for row in rows if row is not None)


def _setting(name: str, value: Any) -> str:
    """Return a setting in words, such as ``frequency 60 Hz``."""
    if isinstance(value, Mapping):
        return (
            f"{name.replace('_', ' ')}: {', '.join(_setting(inner, value[inner]) for inner in sorted(value))}"
        )
    suffix = next((ending for ending in _SUFFIXES if name.endswith(ending)), "")
    shown = name.removesuffix(suffix).replace("_", " ")
    if isinstance(value, bool) or value is None:
        return f"{shown} {'none' if value is None else 'on' if value else 'off'}"
    text = f"{value:g}" if isinstance(value, float) else str(value)
    return f"{shown} {text} {_SUFFIXES.get(suffix, '')}".rstrip()


def _value(name: str, value: float | None, unit: str) -> Condition | None:
    return None if value is None else Condition(name, nine_digits(float(value)), unit, None, None, "", "run")


def _text(name: str, parts: list[str]) -> Condition | None:
    return Condition(name, None, "1", None, None, "; ".join(parts), "run") if parts else None


def _range(name: str, values: list[float | None], unit: str) -> Condition | None:
    """Return one value if all are printed alike, else the range in words."""
    known = sorted(float(value) for value in values if value is not None)
    if not known:
        return None
    low, high = (f"{end:.6g}" for end in (known[0], known[-1]))
    if low == high:
        return Condition(name, float(low), unit, None, None, "", "run")
    return Condition(name, None, unit, None, None, f"{low} to {high} {unit}", "run")


def deviations_of(results: Results) -> tuple[Deviation, ...]:
    """Return what in the run differed from its sequence: deviations, failures, poses without result, failed gates."""
    texts = [str(text) for text in (*(results.get("deviations") or ()), *(results.get("holds") or ()))]
    texts += [f"The run was interrupted: {failure.what}" for failure in results.get("failures") or []]
    if resumed := int(results["run"].get("resumed") or 0):
        texts.append(f"The run was resumed {resumed} time{'s' if resumed > 1 else ''}.")
    texts += [
        f"Pose {pose['index']} ({pose['name']}) has no accepted recording and does not enter the result."
        for pose in results["poses"]
        if not any(attempt["accepted"] for attempt in pose["attempts"])
    ]
    texts += [
        f"Limit not met: {_gate_name(gate)} is {gate['value']} {gate['unit']}".rstrip()
        + f", limit {gate['limit']}."
        for gate in results.get("gates") or []
        if gate["verdict"] == "fail"
    ]
    texts += limits_of_others(results)
    return tuple(Deviation(text, "run") for text in dict.fromkeys(texts))


def _gate_name(gate: GateData) -> str:
    """Return the name of a gate, with its pose."""
    if "pose" not in gate:
        return str(gate["name"])
    return f"pose {gate['pose']}: {gate['gate']}"


def utc_seconds(moment: str) -> str:
    """Return a time in ISO 8601, with its zone, in UTC to whole seconds.

    >>> utc_seconds("2026-11-21T01:06:35.918509Z")
    '2026-11-21T01:06:35Z'
    """
    return datetime.fromisoformat(moment).strftime("%Y-%m-%dT%H:%M:%SZ")
