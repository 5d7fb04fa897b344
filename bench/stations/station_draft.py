"""Drafts a new station file for the chosen drivers, with the ports and cameras that are connected.

What the computer cannot find out is an example or a placeholder, with a comment; the draft is valid, but no run starts
until `placeholders` are replaced.
"""

from __future__ import annotations

import json
import re

from jinja2 import Template

from bench.stations.discovery import DRAFT, Discovery
from bench.stations.placeholders import UNKNOWN_PORT, UNKNOWN_SOURCE

CAMERAS = ("metavision", "neuromorphic_evk4", "opencv", "recorded", "pictures")
"""Drivers of cameras; of those connected, the first of them is drafted."""


def draft_station(
    name: str, found: Discovery, *, stage: str, light: str = "scpi", camera: str | None = None
) -> str:
    """Write a new station file; the first adapter is the stage's, the second the light's.

    ``camera`` is one of `CAMERAS`; None for the first connected one in their order.
    """
    # A port of the computer itself mostly has nothing behind it: it is listed, and not chosen.
    ports = [port.name for port in found.ports if not port.device.startswith("/dev/ttyS")]
    stage_port, light_port = [*ports, UNKNOWN_PORT, UNKNOWN_PORT][:2]
    usable = [one for one in found.cameras if not one.trouble and (one.serial or one.source)]
    wanted = CAMERAS if camera is None else [camera]
    first = next((one for driver in wanted for one in usable if one.driver == driver), None)
    draft = Template(DRAFT.read_text(encoding="utf-8"), trim_blocks=True, keep_trailing_newline=True)
    return draft.render(
        name=_as_yaml(name),
        ports=found.ports,
        stage=stage,
        stage_port=stage_port,
        light=light,
        light_port=light_port,
        camera=camera or (first.driver if first else CAMERAS[0]),
        serial=first.serial if first else "",
        source=first.source if first else UNKNOWN_SOURCE,
    )


def _as_yaml(text: str) -> str:
    """Return a text as YAML: in quotes, if it has more than letters, digits, blanks and some harmless signs."""
    return text if re.fullmatch(r"[A-Za-z][\w ,./-]*(?<! )", text) else json.dumps(text, ensure_ascii=False)
