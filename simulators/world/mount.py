"""Motion of the camera's mount: it vibrates, and it drifts away from the angles of the axes.

    pan(t) = rate (t_on + t) + amplitude sin(2 pi (f t + phase)), tilt alike

with t since the start of a recording and t_on between switching on and that start. The drift until that start is
rounded to steps of 0.05 arc seconds, and the phases belong to the recording: recordings at the same step are the same.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

from simulators.world.truth import MountTruth
from simulators.world.world import AxisName

STEP_ARCSEC: Final = 0.05


def has_motion(mount: MountTruth) -> bool:
    """Return whether the mount moves at all.

    mount: True motion of the mount.
    Returns: True if it vibrates or drifts.
    """
    return vibrates(mount) or mount.drift_arcsec_per_min != (0.0, 0.0)


def vibrates(mount: MountTruth) -> bool:
    """Return whether the mount vibrates.

    mount: True motion of the mount.
    Returns: True if amplitude and frequency are positive.
    """
    return mount.vibration_arcsec > 0.0 and mount.vibration_hz > 0.0


def drift_since_on_arcsec(mount: MountTruth, on_s: float) -> tuple[float, float]:
    """Return the drift since the bench was switched on, in whole steps of `STEP_ARCSEC`.

    mount: True motion of the mount.
    """
    pan, tilt = (
        round(round(rate * on_s / 60.0 / STEP_ARCSEC) * STEP_ARCSEC, 2) for rate in mount.drift_arcsec_per_min
    )
    return pan, tilt


def true_angles_deg(
    angles_deg: Mapping[AxisName, float],
    mount: MountTruth,
    start_drift_arcsec: tuple[float, float],
    phases: tuple[float, float],
    t_s: float,
) -> dict[AxisName, float]:
    """Return the angles at which the camera really points.

    mount: True motion of the mount.
    start_drift_arcsec: Drift of pan and tilt at the recording's start, arc seconds, from
      ``drift_since_on_arcsec``.
    phases: Phases of the vibration about pan and tilt at the recording's start, in periods.
    t_s: Time since the recording's start.
    Returns: Angles by name, degrees, with drift and vibration added.
    """
    angles = dict(angles_deg)
    names: tuple[AxisName, AxisName] = ("pan", "tilt")
    for name, rate, start, phase in zip(
        names, mount.drift_arcsec_per_min, start_drift_arcsec, phases, strict=True
    ):
        arcsec = start + rate * t_s / 60.0
        if vibrates(mount):
            arcsec += mount.vibration_arcsec * math.sin(2.0 * math.pi * (mount.vibration_hz * t_s + phase))
        angles[name] += arcsec / 3600.0
    return angles
