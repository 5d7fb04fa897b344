"""Rows of the report about statements and what all others say of them, and about sizes of errors in the views.

Each function takes ``calibration`` of results.json and returns printed text; none for results without these parts.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from bench.records.results import AmplitudeData, CalibrationData, WitnessData
from bench.report.text import NOTHING, fixed, number, with_uncertainty

_UNUSUAL, _CONTRADICTION = 2.0, 4.0
"""Sizes of an innovation, in units of its standard uncertainty."""
_DOUBTED = 0.3
"""Probability of a fault from which on a statement is named in the notes (`calib.joint.words`)."""


@dataclass(frozen=True)
class WitnessRow:
    """A statement as printed."""

    name: str
    source: str
    stated: str
    expected: str
    innovation: str
    fault: str
    verdict: str  # ``pass``, ``marginal`` or ``fail``


def witness_rows(calibration: CalibrationData) -> list[WitnessRow]:
    """List the statements, those that are most at odds with the others first."""
    found = sorted(
        calibration.get("witnesses") or [],
        key=lambda one: (-one["fault_probability"], -abs(one["innovation"])),
    )
    return [_row(one) for one in found]


def amplitude_rows(calibration: CalibrationData) -> list[tuple[str, str]]:
    """List the sizes of the errors that the adjustment estimated, with their uncertainty and what was expected."""
    return [(one["name"], _size(one)) for one in calibration.get("amplitudes") or []]


def _row(one: WitnessData) -> WitnessRow:
    size = abs(one["innovation"])
    doubted = one["fault_probability"] >= _DOUBTED or size >= _CONTRADICTION
    return WitnessRow(
        one["name"],
        one["source"],
        _value(one["stated"], one["sigma"], one["unit"]),
        _value(one["expected"], one["expected_sigma"], one["unit"]),
        fixed(one["innovation"], 1),
        f"{100 * one['fault_probability']:.0f} %",
        "fail" if doubted else "marginal" if size > _UNUSUAL else "pass",
    )


def _value(value: float | None, sigma: float | None, unit: str) -> str:
    if value is None or sigma is None or not math.isfinite(sigma):
        return NOTHING
    shown, uncertainty = with_uncertainty(value, sigma)
    return f"{shown} \N{PLUS-MINUS SIGN} {uncertainty} {'' if unit == '1' else unit}".strip()


def _size(one: AmplitudeData) -> str:
    unit = {"urad": " \N{MICRO SIGN}rad", "1": ""}.get(one["unit"], f" {one['unit']}")
    factor, expected = number(math.exp(one["log_sigma"]), 2), number(one["expected"], 2)
    return f"{number(one['value'], 2)}{unit}, known to a factor of {factor}; expected {expected}{unit}"
