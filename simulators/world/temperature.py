"""Temperature of the camera over time, and the parts of the truth that follow it.

The law is `truth.LAW`. A sensor reports its temperature in steps of 0.01 degrees, and the world follows those steps:
all recordings at one step are the same.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

from simulators.world.truth import REFERENCE_C, ThermalTruth, Truth

STEP_C: Final = 0.01


def temperature_c(thermal: ThermalTruth, on_s: float) -> float:
    """Return the temperature of the camera at a time after it was switched on.

    Returns: Temperature in steps of `STEP_C`, degrees Celsius.

    Examples
    --------
    >>> temperature_c(ThermalTruth(warm_up_min=10.0), 600.0)
    34.88
    """
    warm = 1.0
    if thermal.warm_up_min > 0.0:
        warm = -math.expm1(-max(0.0, on_s) / (60.0 * thermal.warm_up_min))
    exact = thermal.room_c + thermal.room_c_per_h * on_s / 3600.0 + thermal.self_heating_c * warm
    return round(round(exact / STEP_C) * STEP_C, 2)


def truth_at_temperature(truth: Truth, at_c: float) -> Truth:
    """Return the truth at a temperature.

    Returns: With focal lengths of that temperature; the same object if they are unchanged.
    """
    stretch = 1.0 + 1e-6 * truth.thermal.focal_ppm_per_c * (at_c - REFERENCE_C)
    if stretch == 1.0:
        return truth
    camera = replace(truth.camera, fx=truth.camera.fx * stretch, fy=truth.camera.fy * stretch)
    return replace(truth, camera=camera)


def lamp_brightness(thermal: ThermalTruth, at_c: float) -> float:
    """Return the lamp's light at a temperature, relative to that at the reference temperature.

    Returns: At least 0; 1 at the reference temperature.
    """
    return max(0.0, 1.0 + 1e-2 * thermal.lamp_percent_per_c * (at_c - REFERENCE_C))


def has_effect(thermal: ThermalTruth) -> bool:
    """Return whether anything depends on the temperature.

    Returns: True if the focal lengths or the lamp's light do.
    """
    return thermal.focal_ppm_per_c != 0.0 or thermal.lamp_percent_per_c != 0.0
