"""Rows of the report about what a calibration used: passport of the collimator, readings and parallax, input files.

The functions take the parts of results.json as plain mappings, also of results that older versions wrote without them.
"""

from __future__ import annotations

from collections.abc import Sequence

from bench.records.results import (
    GimbalEstimateData,
    GimbalReadingsData,
    ParallaxBound,
    ParallaxData,
    PassportData,
    SourceData,
)
from bench.report.text import exact, number, with_uncertainty

Rows = list[tuple[str, str]]


_ORIGINS = {
    "sequence": "file named by the sequence",
    "station": "file named by the station",
    "station certificate": "stated in the station file",
    "command line": "file named on the command line",
}


def passport_rows(passport: PassportData | None) -> Rows:
    """List what the results state about the collimator's passport.

    passport: ``passport`` of results.json; None if no passport was used.
    Returns: Name and value; none without a passport.
    """
    if not passport:
        return []
    sigma = passport["sigma"]
    kept = ("x", "y", "r") if len(passport["values"]) > 1 else tuple(passport["values"])
    values = [
        f"{name} = {exact(value)} mm, standard uncertainty {sigma[name]:.2g} mm"
        for name, value in passport["values"].items()
        if name in kept
    ]
    if others := [name for name in passport["values"] if name not in kept]:
        values.append(f"and {', '.join(others)}")
    stated = [
        f"number {passport['number']}" if passport["number"] else "",
        f"of the collimator {passport['collimator']}" if passport["collimator"] else "",
        f"dated {passport['date']}" if passport["date"] else "",
        f"valid until {passport['valid_until']}" if passport["valid_until"] else "",
        f"at {passport['temperature_c']:g} °C" if passport["temperature_c"] is not None else "",
        f"{_ORIGINS.get(passport['source'], passport['source'])} ({passport['name']})",
    ]
    return [
        ("Collimator passport", ", ".join(part for part in stated if part)),
        ("Values of the passport", "; ".join(values)),
        ("SHA-256 of the passport", str(passport["sha256"])),
        *_seal_rows(passport),
    ]


def _seal_rows(passport: PassportData) -> Rows:
    """Return the seal of a passport; no row for the values of a station's certificate and of an earlier version."""
    if passport["source"] == "station certificate" or "sealed_by" not in passport:
        return []
    return [("Seal of the passport", str(passport["sealed_by"] or "none: the file is not sealed"))]


def readings_rows(readings: GimbalReadingsData | None, estimate: GimbalEstimateData | None) -> Rows:
    """List whether the readings of the gimbal entered the calibration, with what statement, or why not.

    readings: ``gimbal_readings`` of results.json; None if the calibration had no readings.
    estimate: ``calibration.gimbal`` of results.json; None if the readings took no part.
    Returns: Name and value; one row, or two if the station states the uncertainty of the readings.
    """
    if not readings:
        return []
    rows: Rows = []
    if readings["entered"]:
        rows.append(("Gimbal readings", f"entered the adjustment as measurements{_agreement(estimate)}"))
    else:
        rows.append(("Gimbal readings", f"compared with the result only. {readings['why_not']}"))
    stated, bound = readings["statement"], readings["bound"]
    if stated:
        text = (
            f"reading {stated['reading_sigma_deg']:g}°, scale {stated['scale_sigma']:g}, "
            f"eccentricity {stated['eccentricity_deg']:g}° (standard uncertainties; source: {stated['source']})"
        )
        rows.append(("Uncertainty of the readings", text + (f"; {_bound(bound)}" if bound else "")))
    return rows


def parallax_rows(parallax: ParallaxData | None) -> Rows:
    """List where the entrance pupil is, and the parallax that follows, or why the parallax test has no result.

    parallax: ``parallax`` of results.json; None if the rims in view do not determine it.
    Returns: Name and value; none without a result.
    """
    if not parallax:
        return []
    if "why_not" in parallax:
        return [("Parallax test: no result", str(parallax["why_not"]))]
    says = [str(sentence).replace(" +- ", " \N{PLUS-MINUS SIGN} ") for sentence in parallax["says"]]
    off = parallax["pupil_off_pivot_mm"]
    value, expanded = with_uncertainty(off["value"], 2 * off["sigma"])
    rows = [
        ("Entrance pupil in front of the pivot", f"{value} \N{PLUS-MINUS SIGN} {expanded} mm (k = 2)"),
        ("Parallax: how the beam moves when the camera turns", " ".join(says)),
    ]
    if without := parallax["without_rim"]:
        rows.append(("Poses with the rim out of view", ", ".join(without)))
    return rows


def source_rows(sources: Sequence[SourceData]) -> list[tuple[str, str, str, str]]:
    """List the input files of a calibration without devices.

    sources: ``sources`` of results.json.
    Returns: View, size in bytes, path and SHA-256 of each file.
    """
    return [
        (str(one["view"]), number(one["size_bytes"], 12), str(one["path"]), str(one["sha256"]))
        for one in sources
    ]


def _agreement(estimate: GimbalEstimateData | None) -> str:
    """Return how the readings agree with the stars."""
    if not estimate:
        return ""
    enlarged = (
        f"; entered with a standard uncertainty of {estimate['reading_sigma_deg']:.3g}°, because they scatter more "
        "than stated"
        if estimate["scatter"] > 1
        else ""
    )
    return (
        f"; chi-square {estimate['chi_square']:.3g} with {estimate['degrees_of_freedom']} degrees of freedom, "
        f"{3600 * estimate['rms_deg']:.2g} arc seconds RMS{enlarged}"
    )


def _bound(bound: ParallaxBound) -> str:
    text = (
        f"parallax bounded by a defocus of {bound['defocus']:g}, standard uncertainty {bound['defocus_sigma']:g}, "
        f"and a pupil {bound['pupil_off_pivot_mm']:g} mm off the pivot, standard uncertainty "
        f"{bound['pupil_off_pivot_sigma_mm']:g} mm"
    )
    if "parallax" not in bound:
        return text
    share, sigma = 100 * bound["parallax"], 100 * bound["parallax_sigma"]
    shown = number(share, 2)
    return f"{text}: {shown} % of the focal length, standard uncertainty {sigma:.2g} %"
