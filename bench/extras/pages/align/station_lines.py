"""What the station file must state so that a run has what was found: lines to copy. Nothing is written."""

from __future__ import annotations

from collections.abc import Mapping

from bench.base.encoding import plain_number
from bench.stations.cameras import OpenCvCameraConfig
from bench.stations.stages_and_lights import GardasoftLightConfig, ScpiLightConfig
from bench.stations.station import Station
from bench.stations.station_text import TextLightConfig


def station_lines(
    station: Station,
    *,
    position_deg: Mapping[str, float],
    camera: Mapping[str, float],
    level_percent: float,
) -> list[str]:
    """Return path and YAML text of each value that differs from the station file, a line each.

    ``position_deg``, by axis, shall become zero, and ``level_percent`` 100 %; ``camera`` are its changed settings.
    """
    under = "camera" if isinstance(station.camera, OpenCvCameraConfig) else "camera.biases"
    return [
        *(line for name, angle_deg in position_deg.items() for line in _zero_lines(station, name, angle_deg)),
        *(f"{under}.{name}: {plain_number(value, 6)}" for name, value in camera.items()),
        *_level_lines(station, level_percent / 100),
    ]


def _zero_lines(station: Station, name: str, angle_deg: float) -> list[str]:
    """Return zero and limits of an axis such that the present angle becomes 0; none beyond its limits."""
    axis, angle_deg = station.axes[name], round(angle_deg, 4)
    low, high = (limit - angle_deg for limit in axis.limits_deg)
    if angle_deg == 0 or not low <= 0 <= high:
        return []
    place = f"stage.axes.{name}"
    return [
        f"{place}.zero_deg: {plain_number(axis.zero_deg - angle_deg, 4)}",
        f"{place}.limits_deg: [{plain_number(low, 4)}, {plain_number(high, 4)}]",
    ]


def _level_lines(station: Station, share: float) -> list[str]:
    """Return the full level of the light such that the present level becomes 100 %."""
    match station.light:
        case _ if share == 1:
            return []
        case ScpiLightConfig() as light:
            return [f"light.high_v: {plain_number(light.low_v + (light.high_v - light.low_v) * share, 4)}"]
        case GardasoftLightConfig() | TextLightConfig() as light:
            return [f"light.full_percent: {plain_number(light.full_percent * share, 3)}"]
        case _:
            return []
