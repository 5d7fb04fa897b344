"""What a station file must state, from what a session of aligning found: zero, limits, biases, light.

The module computes with values only; `bench.align.write_down` edits the file.
"""

from __future__ import annotations

from collections.abc import Mapping

from bench.base.errors import ControlRefused
from bench.stations.station import Station
from bench.stations.station_lights import GardasoftLightConfig, ScpiLightConfig
from bench.stations.station_text import TextLightConfig
from sequences.tree import DocumentPath


def station_values(
    station: Station,
    *,
    position_deg: Mapping[str, float] | None = None,
    biases: Mapping[str, int] | None = None,
    frame: Mapping[str, float | None] | None = None,
    level_percent: float | None = None,
) -> tuple[dict[DocumentPath, str], list[str]]:
    """Return what a station file must state, from what a session found.

    position_deg: Present angle by axis, degrees, which shall become zero; None leaves the zeros as they are.
    biases: Offsets of the biases; None leaves them as they are.
    frame: Exposure and gain of a frame camera by name; None leaves them as they are.
    level_percent: Level of the light that shall become 100 %; None leaves it as it is.
    Raises ControlRefused: If the present position cannot become zero.
    """
    values: dict[DocumentPath, str] = {}
    notes = []
    for name, angle_deg in (position_deg or {}).items():
        values |= _zero_values(station, name, angle_deg)
    if position_deg:
        notes.append(
            "The limits move with the zero, so that the stage may turn to the same directions as before. The new zero"
            " counts from the next start of align or of a run."
        )
    if biases is not None:
        now = station.camera.biases.model_dump() if hasattr(station.camera, "biases") else {}
        changed = {name: value for name, value in biases.items() if now.get(name) != value}
        values |= {("camera", "biases", name): str(value) for name, value in changed.items()}
    for name, setting in (frame or {}).items():
        if setting is not None and setting != getattr(station.camera, name, None):
            values["camera", name] = plain_number(setting, 6)
    if level_percent is not None and level_percent != 100:
        match station.light:
            case ScpiLightConfig() as light:
                high_v = light.low_v + (light.high_v - light.low_v) * level_percent / 100
                values["light", "high_v"] = plain_number(high_v, 4)
            case GardasoftLightConfig() | TextLightConfig() as light:
                values["light", "full_percent"] = plain_number(light.full_percent * level_percent / 100, 3)
        notes.append(f"The present level, {level_percent:g} %, becomes 100 % of this station.")
    return values, notes


def _zero_values(station: Station, name: str, angle_deg: float) -> dict[DocumentPath, str]:
    """Return zero and limits of an axis such that the present angle becomes 0."""
    axis = station.axes[name]
    angle_deg = round(angle_deg, 4)
    if angle_deg == 0:
        return {}
    low, high = (round(limit - angle_deg, 4) for limit in axis.limits_deg)
    if not low <= 0 <= high:
        raise ControlRefused(
            f"{name} is at {angle_deg:g} deg, outside its limits; this cannot become zero.",
            where=name,
            remedy="Turn the axis back into its limits first.",
        )
    place = ("stage", "axes", name)
    return {
        (*place, "zero_deg"): plain_number(axis.zero_deg - angle_deg, 4),
        (*place, "limits_deg"): f"{plain_number(low, 4)} {plain_number(high, 4)}",
    }


def plain_number(value: float, digits: int) -> str:
    """Return a number as a person writes it into a file.

    digits: Largest number of digits after the point.
    Returns: Without needless zeros.

    Examples
    --------
    >>> plain_number(2.50, 4), plain_number(-0.00001, 4), plain_number(10, 2)
    ('2.5', '0', '10')
    """
    text = f"{value:.{digits}f}".rstrip("0").rstrip(".")
    return "0" if text in ("", "-0") else text
