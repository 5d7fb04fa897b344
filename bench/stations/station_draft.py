"""Drafts a new station file for the chosen drivers, with the ports and cameras that are connected.

What the computer cannot find out is an example or a placeholder, with a comment; the draft is valid, but no run starts
until `placeholders` are replaced.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from jinja2 import Template

from bench.stations.asked_devices import NAMED_BY_MAKER, AskedLight, AskedStage
from bench.stations.discovery import DRAFT, Discovery
from bench.stations.placeholders import Unknown

CAMERAS = ("metavision", "neuromorphic_evk4", "opencv", "recorded", "pictures")
"""Drivers of cameras; of those connected, the first of them is drafted."""


@dataclass(frozen=True)
class StandIns:
    """Devices of the simulated bench, which take the place of real ones in a new station file."""

    simulation: Mapping[str, Any]  # The section of this name
    camera_serial: str
    high_v: float  # Voltage of the lamp's full brightness, V
    scale: float | None  # Counts per degree of the stage, by its data sheet; None if its controller states it


def free_ports(discovery: Discovery) -> list[str]:
    """Return the ports that may belong to stage and light.

    A port of the computer itself mostly has nothing behind it: it is listed, and not chosen.
    """
    return [port.name for port in discovery.ports if not port.device.startswith("/dev/ttyS")]


def ports_to_ask(discovery: Discovery, stage: str) -> list[str]:
    """Return the ports at which a stage of this driver may be asked for."""
    word = NAMED_BY_MAKER.get(stage)
    named = {
        port.name for port in discovery.ports if word and word.lower() in f"{port.name} {port.what}".lower()
    }
    return [port for port in free_ports(discovery) if word is None or port in named]


def draft_station(
    discovery: Discovery,
    *,
    stage: str,
    light: str = "scpi",
    camera: str | None = None,
    asked: tuple[AskedStage | None, AskedLight | None] = (None, None),
    stand_ins: StandIns | None = None,
    certified: str | None = None,
) -> str:
    """Write a new station file; ``asked`` is what stage and light answered, None where they did not.

    Without an answer, the first free port is the stage's, the second the light's. ``camera`` is one of `CAMERAS`; None
    for the first connected one in their order. ``certified`` is which length a certificate of the collimator states.
    """
    asked_stage, asked_light = asked
    taken = {*(asked_stage.ports if asked_stage else ()), *([asked_light.port] if asked_light else [])}
    ports = iter([*(port for port in free_ports(discovery) if port not in taken), Unknown.PORT, Unknown.PORT])
    stage_port = asked_stage.port if asked_stage else next(ports)
    light_port = asked_light.port if asked_light else next(ports)
    usable = [
        listed for listed in discovery.cameras if not listed.trouble and (listed.serial or listed.source)
    ]
    wanted = CAMERAS if camera is None else [camera]
    first = next((listed for driver in wanted for listed in usable if listed.driver == driver), None)
    draft = Template(DRAFT.read_text(encoding="utf-8"), trim_blocks=True, keep_trailing_newline=True)
    return draft.render(
        ports=discovery.ports,
        stage=stage,
        stage_port="sim:gimbal" if stand_ins and not asked_stage else stage_port,
        axes=asked_stage.axes if asked_stage else (),
        light=light,
        light_port="sim:light" if stand_ins else light_port,
        asked_light=asked_light,
        camera=camera or (first.driver if first else CAMERAS[0]),
        serial=first.serial if first else "",
        source=first.source if first else Unknown.SOURCE,
        stand_ins=stand_ins,
        certified=certified,
        simulation=json.dumps(stand_ins.simulation) if stand_ins else "",
    )
