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
    """Identity of a controller, and the axis behind it.

    Attributes
    ----------
    mechanics
        Mechanical properties.
    serial
        Serial number.
    lowest, highest
        Soft limits at power-up, microsteps.
    device_id, firmware, build
        Answers to ``get deviceid``, ``get version`` and ``get version.build``.
    speed_deg_s, acceleration_deg_s2
        Ramp settings at power-up, degrees/s and degrees/s^2.
    home_speed_deg_s
        Speed towards the reference sensor, degrees/s; the last part is ten times slower.
    boot_s
        Time without answers after a restart, s.
    encoder
        Whether the shaft has an encoder.
    """

    mechanics: Mechanics
    serial: str
    lowest: int
    highest: int
    device_id: int = 50958
    firmware: str = "7.38"
    build: str = "17403"
    speed_deg_s: float = 40.0
    acceleration_deg_s2: float = 200.0
    home_speed_deg_s: float = 20.0
    boot_s: float = 0.5
    encoder: bool = True

    def factory_settings(self) -> dict[str, int]:
        """Return the factory settings.

        Returns
        -------
        dict
            Values by name, in the units of the protocol.
        """
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
    """Return the range of a setting.

    Parameters
    ----------
    name
        Name of the setting.
    settings
        Present values, by name.

    Returns
    -------
    tuple of int
        Lowest and highest value, in the units of the protocol.
    """
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
