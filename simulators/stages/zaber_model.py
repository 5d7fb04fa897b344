"""A Zaber controller of the X-RST kind: identity, factory settings, and ranges and units of settings.

Reference: Zaber's ASCII Protocol Manual, firmware 7.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from simulators.stages.mechanics import Mechanics

#: Unit of the settings: maxspeed = 1.6384 x microsteps/s, accel = 1.6384 x microsteps/s^2 / 10000
#: (ASCII Protocol Manual, settings maxspeed and accel).
SPEED_UNIT = 1.6384

#: Largest values of the speed and acceleration settings.
_MAX_SPEED_SETTING = 16_777_216
_MAX_ACCELERATION_SETTING = 32_767


@dataclass(frozen=True)
class ZaberModel:
    """Identity of a controller, and the axis behind it."""

    mechanics: Mechanics
    serial: str
    lowest: int
    highest: int
    # device_id, firmware, build: Answers to ``get deviceid``, ``get version`` and ``get version.build``.
    device_id: int = 50958
    firmware: str = "7.38"
    build: str = "17403"
    # speed_deg_s, acceleration_deg_s2: Ramp settings at power-up, degrees/s and degrees/s^2.
    speed_deg_s: float = 40.0
    acceleration_deg_s2: float = 200.0
    # Speed towards the reference sensor, degrees/s; the last part is ten times slower.
    home_speed_deg_s: float = 20.0
    boot_s: float = 0.5  # Time without answers after a restart, s
    encoder: bool = True  # Whether the shaft has an encoder

    def factory_settings(self) -> dict[str, int]:
        """Return the factory settings."""
        scale = self.mechanics.counts_per_deg * SPEED_UNIT
        return {
            "comm.alert": 0,
            "comm.checksum": 0,
            "maxspeed": round(self.speed_deg_s * scale),
            "limit.approach.maxspeed": round(self.home_speed_deg_s * scale),
            "accel": round(self.acceleration_deg_s2 * scale / 10_000.0),
            "limit.min": self.lowest,
            "limit.max": self.highest,
        }


def setting_range(name: str, settings: Mapping[str, int]) -> tuple[int, int]:
    """Return the range of a setting."""
    ranges = {
        "comm.alert": (0, 1),
        "comm.checksum": (0, 1),
        "maxspeed": (1, _MAX_SPEED_SETTING),
        "limit.approach.maxspeed": (1, _MAX_SPEED_SETTING),
        "accel": (1, _MAX_ACCELERATION_SETTING),
        "limit.min": (-1_000_000_000, settings["limit.max"]),
        "limit.max": (settings["limit.min"], 1_000_000_000),
    }
    return ranges[name]
