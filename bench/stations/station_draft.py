"""Drafts a new station file for the chosen drivers, with the ports and cameras that are connected.

A value that the computer cannot find out (scales, limits, unknown serial numbers) is an example or a placeholder, with
a comment. A draft is a valid file, but no run starts until all placeholders are replaced (`placeholders`).
"""

from __future__ import annotations

from bench.stations.discovery import Discovery
from bench.stations.placeholders import UNKNOWN_PORT, UNKNOWN_SCALE, UNKNOWN_SERIAL, UNKNOWN_SOURCE

_AXIS_END = "limits_deg: [-12, 12], speed_deg_s: 10, acceleration_deg_s2: 50"
_SERIAL_NOTE = "# another device on this port is refused before anything moves"
STAGE_SECTIONS = {
    "zaber_ascii": f"""\
  driver: zaber_ascii
  port: {{stage_port}}
  axes:   # microsteps_per_deg: from the data sheet of the stage; never guess it
    pan: {{{{device: 1, serial: {UNKNOWN_SERIAL}, microsteps_per_deg: {UNKNOWN_SCALE}, {_AXIS_END}}}}}
    tilt: {{{{device: 2, serial: {UNKNOWN_SERIAL}, microsteps_per_deg: {UNKNOWN_SCALE}, {_AXIS_END}}}}}
""",
    "ximc": f"""\
  driver: ximc
  axes:   # one controller for each axis; full steps per degree from the data sheet
    pan: {{{{port: {{stage_port}}, serial: {UNKNOWN_SERIAL}, steps_per_deg: 80, {_AXIS_END}}}}}
""",
    "grbl": f"""\
  driver: grbl
  port: {{stage_port}}
  serial: {UNKNOWN_SERIAL}   # name given to the board with $I=...
  axes:   # zero_deg: angle at machine position 0; all limits lie below it
    pan: {{{{letter: X, steps_per_deg: 80, zero_deg: 15, {_AXIS_END}}}}}
    tilt: {{{{letter: Y, steps_per_deg: 80, zero_deg: 15, {_AXIS_END}}}}}
""",
    "esp30x": f"""\
  driver: esp30x
  port: {{stage_port}}
  axes:
    pan: {{{{number: 1, serial: {UNKNOWN_SERIAL}, {_AXIS_END}}}}}
    tilt: {{{{number: 2, serial: {UNKNOWN_SERIAL}, {_AXIS_END}}}}}
""",
}


CAMERA_SECTIONS = {
    "metavision": "serial: {serial}   # text, with all zeros",
    "neuromorphic_evk4": "serial: {serial}   # text, with all zeros",
    "opencv": "source: {source}   # or the URL of a network camera\n{known}  pictures: 8   # averaged at each pose",
    "recorded": "path: recordings   # *.raw, replayed in the order of their names\n  serial: {serial}",
    "pictures": "path: pictures   # replayed in the order of their names\n  pictures: 8   # at each pose",
}
"""Keys that each camera driver needs."""


def draft_station(name: str, found: Discovery, *, stage: str, camera: str | None = None) -> str:
    """Write a new station file.

    Parameters
    ----------
    name
        Name of the bench.
    found
        What is connected. The first port is used for the stage, the second for the light.
    stage
        Driver of the stage: a key of ``STAGE_SECTIONS``.
    camera
        Driver of the camera: a key of ``CAMERA_SECTIONS``; None for the first connected camera, event cameras first.

    Returns
    -------
    str
        Text of the file.
    """
    ports = [port.name for port in found.ports]
    stage_port, light_port = [*ports, UNKNOWN_PORT, UNKNOWN_PORT][:2]
    others = "".join(f"# connected: {port.name}  {port.what}\n" for port in found.ports)
    return (
        f"format: starbench/station/1\nname: {name}\nlaboratory: Your laboratory\n\n"
        f"{others}"
        f"stage:   {_SERIAL_NOTE}\n{STAGE_SECTIONS[stage].format(stage_port=stage_port)}\n"
        f"light:\n  driver: scpi\n  port: {light_port}\n  serial: {UNKNOWN_SERIAL}\n"
        "  low_v: 0\n  high_v: 2.5   # voltage at which the lamp has full brightness\n\n"
        f"camera:\n{_camera(found, camera)}"
        "  lens: which, and how it is locked\n\n"
        "target: {squares: [50, 72], pitch_mm: 4.0138889, tag_id: 3, tag_square: [23, 34]}\n"
        "disk: {min_free_gb: 5}\n"
    )


def _camera(found: Discovery, family: str | None) -> str:
    """Write the camera section for the first connected camera that can be used."""
    usable = [one for one in found.cameras if not one.trouble and (one.serial or one.source)]
    first = next(
        (one for wanted in CAMERA_SECTIONS for one in usable if one.driver == (family or wanted)), None
    )
    driver = family or (first.driver if first else "metavision")
    serial = first.serial if first else ""
    keys = CAMERA_SECTIONS[driver].format(
        serial=serial or UNKNOWN_SERIAL,
        source=first.source if first else UNKNOWN_SOURCE,
        known=f"  serial: {serial}\n" if serial else "",
    )
    return f"  driver: {driver}\n  {keys}\n"
