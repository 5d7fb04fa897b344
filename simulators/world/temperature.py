"""How warm the camera is at any time, and what of the truth follows it.

The law is `truth.LAW`. A sensor tells its temperature in steps of 0.01 degrees, and the world follows those: whatever
is recorded at one step is the same.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

from simulators.world.truth import REFERENCE_C, ThermalTruth, Truth

STEP_C: Final = 0.01


def temperature_c(thermal: ThermalTruth, on_s: float) -> float:
    """Temperature of the camera, so long after it was switched on.

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


def warmed(truth: Truth, at_c: float) -> Truth:
    """Give the truth at a temperature; the same object if nothing follows it."""
    stretch = 1.0 + 1e-6 * truth.thermal.focal_ppm_per_c * (at_c - REFERENCE_C)
    if stretch == 1.0:
        return truth
    camera = replace(truth.camera, fx=truth.camera.fx * stretch, fy=truth.camera.fy * stretch)
    return replace(truth, camera=camera)


def brightness(thermal: ThermalTruth, at_c: float) -> float:
    """Light of the lamp at a temperature, in that at the reference."""
    return max(0.0, 1.0 + 1e-2 * thermal.lamp_percent_per_c * (at_c - REFERENCE_C))


def matters(thermal: ThermalTruth) -> bool:
    """Whether anything follows the temperature."""
    return thermal.focal_ppm_per_c != 0.0 or thermal.lamp_percent_per_c != 0.0
