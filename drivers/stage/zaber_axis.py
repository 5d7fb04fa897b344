"""Describe one Zaber axis as in the station file, and check that the controller agrees with it. Moves nothing.

Source: "Zaber ASCII Protocol Manual", https://www.zaber.com/protocol-manual, settings ``maxspeed``, ``accel``,
``limit.min``, ``limit.max`` and ``limit.cycle.dist``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from drivers.errors import OutsideLimits
from drivers.stage import motion
from drivers.stage.watched import Axis, reads_otherwise
from drivers.stage.zaber_chain import ZaberChain

SPEED_UNITS = 1.6384
"""maxspeed = 1.6384 x microsteps/s (ASCII Protocol Manual, setting maxspeed)."""
ACCELERATION_UNITS = 1.6384e-4
"""accel = 1.6384 / 10000 x microsteps/s^2 (ASCII Protocol Manual, setting accel)."""
_SCALE_AGREES = 1e-6


@dataclass(frozen=True, kw_only=True)
class ZaberAxis(Axis):
    """One axis as the station file describes it."""

    device: int
    # Microsteps per degree; negative when the counter falls as the angle grows. Never guessed from a model.
    microsteps_per_deg: float
    axis: int = 1

    @property
    def scale(self) -> float:
        """Microsteps per degree."""
        return self.microsteps_per_deg


def check_scale(chain: ZaberChain, axis: ZaberAxis) -> None:
    """Check that scale and limits agree with the controller's turn and travel.

    Raises OutsideLimits: The scale gives another number of microsteps a turn, or the limits lie beyond the
      travel.
    """
    turn = _setting(chain, axis, "limit.cycle.dist")
    expected = abs(axis.microsteps_per_deg) * 360.0
    if turn and abs(turn - expected) > max(1.0, _SCALE_AGREES * expected):
        raise OutsideLimits(
            f"the scale in the station file gives {expected:.0f} microsteps a turn, the controller has {turn}.",
            where=axis.name,
            remedy="Correct microsteps_per_deg in the station file.",
        )
    present = _setting(chain, axis, "limit.min"), _setting(chain, axis, "limit.max")
    motion.check_travel(axis.name, _travel(axis), present, "microsteps")


def program(chain: ZaberChain, axis: ZaberAxis) -> None:
    """Set limits, speed and acceleration where they differ, and read them back.

    Only settings that differ are sent, because the controller keeps them in non-volatile memory.

    Raises OutsideLimits: Speed or acceleration is below the controller's unit. Its acceleration 0 would mean
      full speed at once.
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
            f"{axis.limits.speed_deg_s:g} deg/s or {axis.limits.acceleration_deg_s2:g} deg/s^2 is below the"
            " controller's smallest step.",
            where=axis.name,
            remedy="Raise speed_deg_s or acceleration_deg_s2 in the station file.",
        )
    for name, value in wanted.items():
        if _setting(chain, axis, name) == value:
            continue
        chain.query(axis.device, axis.axis, f"set {name} {value}")
        got = chain.query_integer(axis.device, axis.axis, f"get {name}")
        if got != value:
            remedy = (
                "Change speed, acceleration or limits in the station file to what the controller supports."
            )
            raise reads_otherwise(axis, name, value, got, remedy)


def _setting(chain: ZaberChain, axis: ZaberAxis, name: str) -> int | None:
    return chain.query_setting(axis.device, axis.axis, name)


def _travel(axis: ZaberAxis) -> tuple[int, int]:
    ends = (axis.to_counts(axis.limits.lowest_deg), axis.to_counts(axis.limits.highest_deg))
    return min(ends), max(ends)
