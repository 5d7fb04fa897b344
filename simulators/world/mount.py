"""How the camera's mount moves on its own: it shakes, and it creeps away from where the axes point it.

    pan(t) = rate (t_on + t) + amplitude sin(2 pi (f t + phase)), tilt alike

with t since the start of a recording and t_on between switching on and that start. What has crept until then is taken
in steps of 0.05 arc seconds, and the phases are the recording's own: it is the same whenever it is taken at one step.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

from simulators.world.truth import MountTruth
from simulators.world.world import AxisName

STEP_ARCSEC: Final = 0.05


def moves(mount: MountTruth) -> bool:
    """Whether it does not stand still."""
    return shakes(mount) or mount.drift_arcsec_per_min != (0.0, 0.0)


def shakes(mount: MountTruth) -> bool:
    """Whether it vibrates."""
    return mount.vibration_arcsec > 0.0 and mount.vibration_hz > 0.0


def crept_arcsec(mount: MountTruth, on_s: float) -> tuple[float, float]:
    """How far pan and tilt have crept since the bench was switched on, in whole steps."""
    pan, tilt = (
        round(round(rate * on_s / 60.0 / STEP_ARCSEC) * STEP_ARCSEC, 2) for rate in mount.drift_arcsec_per_min
    )
    return pan, tilt


def disturbed(
    angles_deg: Mapping[AxisName, float],
    mount: MountTruth,
    crept: tuple[float, float],
    phases: tuple[float, float],
    t_s: float,
) -> dict[AxisName, float]:
    """Angles at which the camera really stands.

    Parameters
    ----------
    angles_deg
        Of the axes.
    crept
        Of ``crept_arcsec`` at the recording's start.
    phases
        Of the vibration about pan and tilt then, in periods.
    t_s
        Time since the recording's start.
    """
    angles = dict(angles_deg)
    names: tuple[AxisName, AxisName] = ("pan", "tilt")
    for name, rate, start, phase in zip(names, mount.drift_arcsec_per_min, crept, phases, strict=True):
        arcsec = start + rate * t_s / 60.0
        if shakes(mount):
            arcsec += mount.vibration_arcsec * math.sin(2.0 * math.pi * (mount.vibration_hz * t_s + phase))
        angles[name] += arcsec / 3600.0
    return angles
