"""Knows one Zaber axis as the station file has it, and sees that the controller agrees. Moves nothing."""

from __future__ import annotations

import math
from dataclasses import dataclass

from drivers.errors import DeviceRefused, OutsideLimits
from drivers.stage import AxisLimits, motion
from drivers.stage.zaber_chain import ZaberChain

SPEED_UNITS = 1.6384
"""maxspeed = 1.6384 x microsteps/s (ASCII Protocol Manual, setting maxspeed)."""
ACCELERATION_UNITS = 1.6384e-4
"""accel = 1.6384 / 10000 x microsteps/s^2 (ASCII Protocol Manual, setting accel)."""
_SCALE_AGREES = 1e-6


@dataclass(frozen=True, kw_only=True)
class ZaberAxis:
    """One axis as the station file describes it.

    Attributes
    ----------
    name
        "pan", "tilt" or "roll".
    device, axis
        Address of the device in the chain, and number of the axis on it.
    serial
        Serial number of the device; empty when it need not be checked.
    microsteps_per_deg
        Counts a degree; negative when the counter falls as the angle grows. Never guessed from a model.
    zero_deg
        Angle at which the controller's counter is 0: angle = zero_deg + count / microsteps_per_deg.
    limits
        Soft limits, speed and acceleration.
    tolerance_deg
        How far from its target the counter may rest.
    encoder_tolerance_deg
        How far the encoder, where there is one, may differ from the counter.
    """

    name: str
    device: int
    serial: str
    microsteps_per_deg: float
    limits: AxisLimits
    axis: int = 1
    zero_deg: float = 0.0
    tolerance_deg: float = 0.002
    encoder_tolerance_deg: float = 0.05

    def microsteps(self, angle_deg: float) -> int:
        """Return the count nearest to an angle."""
        return round((angle_deg - self.zero_deg) * self.microsteps_per_deg)

    def angle_deg(self, microsteps: float) -> float:
        """Return the angle of a count."""
        return self.zero_deg + microsteps / self.microsteps_per_deg


def check_scale(chain: ZaberChain, axis: ZaberAxis) -> None:
    """See that scale and limits agree with what the controller says of its turn and travel.

    Raises OutsideLimits.
    """
    turn = _setting(chain, axis, "limit.cycle.dist")
    expected = abs(axis.microsteps_per_deg) * 360.0
    if turn and abs(turn - expected) > max(1.0, _SCALE_AGREES * expected):
        raise OutsideLimits(
            f"the station's scale gives {expected:.0f} microsteps a turn, the controller says {turn}.",
            where=axis.name,
            remedy="Correct microsteps_per_deg in the station file.",
        )
    present = _setting(chain, axis, "limit.min"), _setting(chain, axis, "limit.max")
    motion.check_travel(axis.name, _travel(axis), present, "microsteps")


def program(chain: ZaberChain, axis: ZaberAxis) -> None:
    """Set limits, speed and acceleration where they differ (they are kept in non-volatile memory).

    Raises OutsideLimits for a speed or an acceleration below the controller's unit (its acceleration 0 means
    none at all: full speed at once), DeviceRefused when a setting reads back otherwise.
    """
    lowest, highest = _travel(axis)
    scale = abs(axis.microsteps_per_deg)
    wanted = {
        "limit.min": lowest,
        "limit.max": highest,
        "maxspeed": math.floor(axis.limits.speed_deg_s * scale * SPEED_UNITS),
        "accel": math.floor(axis.limits.acceleration_deg_s2 * scale * ACCELERATION_UNITS),
    }
    if not (wanted["maxspeed"] and wanted["accel"]):
        raise OutsideLimits(
            f"{axis.limits.speed_deg_s:g} deg/s or {axis.limits.acceleration_deg_s2:g} deg/s^2 is less than the"
            " controller can count.",
            where=axis.name,
            remedy="Raise speed_deg_s or acceleration_deg_s2 in the station file.",
        )
    for name, value in wanted.items():
        if _setting(chain, axis, name) == value:
            continue
        chain.query(axis.device, axis.axis, f"set {name} {value}")
        got = chain.number(axis.device, axis.axis, f"get {name}")
        if got != value:
            raise DeviceRefused(
                f"{name} was set to {value}, but reads {got}.",
                where=axis.name,
                remedy="Change speed, acceleration or limits in the station file to what it can do.",
            )


def _setting(chain: ZaberChain, axis: ZaberAxis, name: str) -> int | None:
    return chain.setting(axis.device, axis.axis, name)


def _travel(axis: ZaberAxis) -> tuple[int, int]:
    ends = (axis.microsteps(axis.limits.lowest_deg), axis.microsteps(axis.limits.highest_deg))
    return min(ends), max(ends)
