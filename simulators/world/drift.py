"""What changes while nobody touches the bench: the temperature of the camera, and the pointing of its mount.

The law of the temperature is `truth.LAW`. A sensor reports its temperature in steps of 0.01 degrees, and the world
follows those steps: all recordings at one step are the same. The mount vibrates, and it drifts away from the angles of
the axes:

    pan(t) = rate (t_on + t) + amplitude sin(2 pi (f t + phase)), tilt alike

with t since the start of a recording and t_on between switching on and that start. The drift until that start is
rounded to steps of 0.05 arc seconds, and the phases belong to the recording: recordings at the same step are the same.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Final, TypeVar

from simulators.world.truth import REFERENCE_C, MountTruth, ThermalTruth, Truth

_Axis = TypeVar("_Axis", bound=str)

STEP_C: Final = 0.01  # Step in which a sensor reports its temperature
STEP_ARCSEC: Final = 0.05  # Less than a thousandth of a pixel


def temperature_c(thermal: ThermalTruth, on_s: float) -> float:
    """Return the temperature of the camera at a time after it was switched on.

    Room plus self-heating times 1 - exp(-t / warm-up), as a body with one heat capacity (Newton's law of cooling).

    >>> temperature_c(ThermalTruth(warm_up_min=10.0), 600.0)
    34.88
    """
    warm = 1.0
    if thermal.warm_up_min > 0.0:
        warm = -math.expm1(-max(0.0, on_s) / (60.0 * thermal.warm_up_min))
    exact = thermal.room_c + thermal.room_c_per_h * on_s / 3600.0 + thermal.self_heating_c * warm
    return round(round(exact / STEP_C) * STEP_C, 2)


def truth_at_temperature(truth: Truth, thermal: ThermalTruth, at_c: float) -> Truth:
    """Return the truth with the focal lengths of a temperature; the same object if they are unchanged."""
    stretch = 1.0 + 1e-6 * thermal.focal_ppm_per_c * (at_c - REFERENCE_C)
    if stretch == 1.0:
        return truth
    camera = replace(truth.camera, fx=truth.camera.fx * stretch, fy=truth.camera.fy * stretch)
    return replace(truth, camera=camera)


def has_motion(mount: MountTruth) -> bool:
    """Return whether the mount moves at all."""
    return vibrates(mount) or mount.drift_arcsec_per_min != (0.0, 0.0)


def vibrates(mount: MountTruth) -> bool:
    """Return whether the mount vibrates."""
    return mount.vibration_arcsec > 0.0 and mount.vibration_hz > 0.0


def drift_since_on_arcsec(mount: MountTruth, on_s: float) -> tuple[float, float]:
    """Return the drift since the bench was switched on, in whole steps of `STEP_ARCSEC`."""
    pan, tilt = (
        round(round(rate * on_s / 60.0 / STEP_ARCSEC) * STEP_ARCSEC, 2) for rate in mount.drift_arcsec_per_min
    )
    return pan, tilt


def moved_angles_deg(
    angles_deg: Mapping[_Axis, float],
    mount: MountTruth,
    start_drift_arcsec: tuple[float, float],
    phases: tuple[float, float],
    t_s: float,
) -> dict[_Axis, float]:
    """Return the angles at which the camera really points: drift linear in time plus a sinusoid of vibration (own).

    The drift of pan and tilt at the recording's start comes from ``drift_since_on_arcsec``; the phases are those of the
    vibration about pan and tilt at that start, in periods.
    """
    angles = dict(angles_deg)
    pan, tilt = (name for name in angles if name in {"pan", "tilt"})
    for name, rate, start, phase in zip(
        (pan, tilt), mount.drift_arcsec_per_min, start_drift_arcsec, phases, strict=True
    ):
        arcsec = start + rate * t_s / 60.0
        if vibrates(mount):
            arcsec += mount.vibration_arcsec * math.sin(2.0 * math.pi * (mount.vibration_hz * t_s + phase))
        angles[name] += arcsec / 3600.0
    return angles
