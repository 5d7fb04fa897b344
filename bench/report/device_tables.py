"""Rows of the report's tables about the devices: identities, connections, settings, and how each was left.

Each function takes a part of results.json and returns rows of printed text. The rows are empty if the part is missing;
the page then omits the table.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from bench.base.device_ends import DeviceEnd
from bench.report.text import NOTHING, value_text

_UNIT_ENDINGS = {"_hz": "Hz", "_c": "°C", "_v": "V", "_percent": "%", "_lux": "lx", "_us": "µs", "_s": "s"}


@dataclass(frozen=True)
class DeviceRow:
    """The identity that one device reported, as printed."""

    name: str
    model: str
    serial: str
    firmware: str
    details: str


def conditions(found: Mapping[str, Any]) -> list[tuple[str, str]]:
    """List the settings of light and camera, and the temperature.

    found: ``conditions`` of results.json.
    """
    rows = []
    for part, settings in found.items():
        if isinstance(settings, Mapping):
            rows += [(f"{part}: {_readable(key)}", _with_unit(key, value)) for key, value in settings.items()]
        else:
            rows.append((_readable(part), _with_unit(part, settings)))
    return rows


def devices(found: Mapping[str, Any]) -> list[DeviceRow]:
    """List the identities that the devices reported.

    found: ``devices`` of results.json.
    """
    rows = []
    for part, identities in found.items():
        for identity in identities if isinstance(identities, list) else [identities]:
            if "serial" not in identity:  # settings, not a device
                continue
            facts = dict(identity)
            name = f"{part}: {facts.pop('name')}" if "name" in facts else part
            model = " ".join(str(facts.pop(key)) for key in ("maker", "model") if facts.get(key))
            serial, firmware = value_text(facts.pop("serial")), value_text(facts.pop("firmware", None))
            details = ", ".join(
                f"{_readable(key)} {value_text(value)}" for key, value in facts.items() if value is not None
            )
            rows.append(DeviceRow(name, model or NOTHING, serial, firmware, details))
    return rows


def connections(found: Mapping[str, Any]) -> list[tuple[str, str]]:
    """List what the devices answered about the cables between them and to the computer.

    found: ``devices`` of results.json.
    Returns: Name and value; empty if the run did not ask.
    """
    return [(_readable(name), str(value)) for name, value in (found.get("connections") or {}).items()]


def left(found: Sequence[Mapping[str, str]]) -> list[tuple[str, str, str]]:
    """List how each device was left after the last step that needs devices.

    found: ``devices_left`` of results.json.
    Returns: Device, state, and what it answered, or what may be the case.
    """
    ends = [DeviceEnd.from_dict(end) for end in found]
    return [(end.device, end.state, " ".join(filter(None, (end.said, end.advice)))) for end in ends]


def _readable(key: str) -> str:
    for ending in _UNIT_ENDINGS:
        key = key.removesuffix(ending)
    return key.replace("_", " ")


def _with_unit(key: str, value: Any) -> str:
    printed = value_text(value)
    if printed == NOTHING:
        return printed
    for ending, unit in _UNIT_ENDINGS.items():
        if key.endswith(ending):
            return f"{printed} {unit}"
    return printed
