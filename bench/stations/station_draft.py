"""Drafts a new station file for the chosen drivers, with the ports and cameras that are connected.

What the computer cannot find out is an example or a placeholder, with a comment; the draft is valid, but no run starts
until `placeholders` are replaced.
"""

from __future__ import annotations

import json
import os
import re
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from serial.tools import list_ports

from bench.stations.station_fields import (
    UNKNOWN_BOARD,
    UNKNOWN_LABORATORY,
    UNKNOWN_NUMBER,
    UNKNOWN_PORT,
    UNKNOWN_SERIAL,
    UNKNOWN_SOURCE,
)
from drivers.camera import FoundCamera
from drivers.camera.discovery import find_cameras
from drivers.camera.usb_permission import slow_cameras, unreadable_cameras

# Lists the serial ports and cameras of this computer, their names for a station file, and what is missing
# to use them.
#
# It reads the lists of the operating system and sends no byte to a device, so that nothing can move or
# switch.

BY_ID = Path("/dev/serial/by-id")


@dataclass(frozen=True)
class FoundPort:
    """A serial port."""

    name: str  # Name for a station file: below ``/dev/serial/by-id``, if the system provides it
    device: str  # The system's name, which may belong to another device after a restart
    what: str
    serial: str  # Serial number of the adapter, not of the device behind it
    note: str  # Why the port cannot be used; empty if it can


@dataclass(frozen=True)
class Discovery:
    """What is connected."""

    ports: tuple[FoundPort, ...]
    cameras: tuple[FoundCamera, ...]
    missing: tuple[str, ...]  # Sentences that say what is missing in order to find or use more

    def to_dict(self) -> dict[str, Any]:
        """Return the discovery as ``--json`` prints it."""
        return asdict(self)


def discover(by_id: Path = BY_ID) -> Discovery:
    """List the serial ports, in the order of their system names, and the cameras of this computer."""
    names = {os.path.realpath(link): str(link) for link in by_id.iterdir()} if by_id.is_dir() else {}
    ports = tuple(_port(info, names) for info in sorted(list_ports.comports(), key=lambda info: info.device))
    cameras, missing = find_cameras()
    missing += [*unreadable_cameras(), *slow_cameras()]
    if not ports:
        missing.append("No serial port was found: connect the adapters of stage and light.")
    if not cameras:
        missing.append(
            "No camera was found: connect one. A network camera is named by its URL (driver: opencv)."
        )
    return Discovery(ports, tuple(cameras), tuple(missing))


def _port(info: Any, names: dict[str, str]) -> FoundPort:
    allowed = os.access(info.device, os.R_OK | os.W_OK)
    return FoundPort(
        name=names.get(os.path.realpath(info.device), info.device),
        device=info.device,
        what=info.description if info.description not in {None, "n/a"} else "",
        serial=info.serial_number or "",
        note=""
        if allowed
        else "no permission: add your user to the group of the port (often dialout) and log in again",
    )


_AXIS_END = "limits_deg: [-12, 12], speed_deg_s: 10, acceleration_deg_s2: 50"
_SERIAL_NOTE = "# another device on this port is refused before anything moves"
STAGE_SECTIONS = {
    "zaber_ascii": f"""\
  driver: zaber_ascii
  port: {{stage_port}}
  axes:   # microsteps_per_deg: from the data sheet of the stage; never guess it
    pan: {{{{device: 1, serial: {UNKNOWN_SERIAL}, microsteps_per_deg: {UNKNOWN_NUMBER}, {_AXIS_END}}}}}
    tilt: {{{{device: 2, serial: {UNKNOWN_SERIAL}, microsteps_per_deg: {UNKNOWN_NUMBER}, {_AXIS_END}}}}}
""",
    "ximc": f"""\
  driver: ximc
  axes:   # one controller for each axis; full steps per degree from the data sheet
    pan: {{{{port: {{stage_port}}, serial: {UNKNOWN_SERIAL}, steps_per_deg: {UNKNOWN_NUMBER}, {_AXIS_END}}}}}
    # tilt: its own controller, with the same keys
""",
    "grbl": f"""\
  driver: grbl
  port: {{stage_port}}
  # A board has no serial number. Give it a name once: send $I=gimbal-1 with any terminal program, and write it here.
  serial: {UNKNOWN_BOARD}
  axes:   # zero_deg: angle at machine position 0; all limits lie below it. steps_per_deg: as $100 (X), $101 (Y)
    pan: {{{{letter: X, steps_per_deg: {UNKNOWN_NUMBER}, zero_deg: 15, {_AXIS_END}}}}}
    tilt: {{{{letter: Y, steps_per_deg: {UNKNOWN_NUMBER}, zero_deg: 15, {_AXIS_END}}}}}
""",
    "esp30x": f"""\
  driver: esp30x
  port: {{stage_port}}
  axes:
    pan: {{{{number: 1, serial: {UNKNOWN_SERIAL}, {_AXIS_END}}}}}
    tilt: {{{{number: 2, serial: {UNKNOWN_SERIAL}, {_AXIS_END}}}}}
""",
    "thorlabs_apt": f"""\
  driver: thorlabs_apt
  axes:   # 136533.333 for a K10CR1; 1919.6418579 for a PRM1Z8 on a KDC101 (docs/devices/thorlabs.md)
    pan: {{{{port: {{stage_port}}, serial: {UNKNOWN_SERIAL}, counts_per_deg: {UNKNOWN_NUMBER}, {_AXIS_END}}}}}
    # tilt: its own controller, with the same keys
""",
    "dynamixel": f"""\
  driver: dynamixel
  port: {{stage_port}}
  axes:   # 11.377778 without a gear, negative if the counter falls; zero_count: docs/devices/dynamixel.md
    pan: {{{{id: 1, model: XL430-W250, counts_per_deg: {UNKNOWN_NUMBER}, zero_count: 2048, {_AXIS_END}}}}}
    tilt: {{{{id: 2, model: XL430-W250, counts_per_deg: {UNKNOWN_NUMBER}, zero_count: 2048, {_AXIS_END}}}}}
""",
    "text": f"""\
  driver: text
  protocol: flir_ptu   # or a file of your own that describes the device: docs/devices-by-description.md
  port: {{stage_port}}
  serial: {UNKNOWN_SERIAL}
  axes:   # counts_per_deg: 3600 / resolution in arc seconds; negative if the counter falls
    pan: {{{{address: P, counts_per_deg: {UNKNOWN_NUMBER}, {_AXIS_END}}}}}
    tilt: {{{{address: T, counts_per_deg: {UNKNOWN_NUMBER}, {_AXIS_END}}}}}
""",
}


LIGHT_SECTIONS = {
    "scpi": f"""\
  driver: scpi
  dialect: keysight   # or: numbered (SOUR1: as 33500B, Rigol DG), siglent
  port: {{light_port}}   # of a generator on the network: socket://ADDRESS:5025 (Rigol: 5555)
  serial: {UNKNOWN_SERIAL}   # leave it out if the generator reports 0
  low_v: 0
  high_v: {UNKNOWN_NUMBER}   # voltage at which the lamp has full brightness; a higher one may destroy the lamp
""",
    "gardasoft": """\
  driver: gardasoft
  port: {light_port}
  # model: RT420F-20   # other models on this port are then refused
  channel: 1   # the lamp's channel
  sync_channel: 2   # the channel that goes to the camera's trigger input
""",
    "text": f"""\
  driver: text
  protocol: microcontroller_light   # or a file of your own: docs/devices-by-description.md
  port: {{light_port}}
  serial: {UNKNOWN_SERIAL}
""",
}
"""Sections of the light by driver."""

CAMERA_SECTIONS = {
    "metavision": "serial: {serial}   # text, with all zeros",
    "neuromorphic_evk4": "serial: {serial}   # text, with all zeros",
    "opencv": "source: {source}   # or the URL of a network camera\n{known}  pictures: 8   # averaged at each pose",
    "recorded": "path: recordings   # *.raw, replayed in the order of their names\n  serial: {serial}",
    "pictures": "path: pictures   # replayed in the order of their names\n  pictures: 8   # at each pose",
}
"""Keys that each camera driver needs."""


COMMON_SECTIONS = """\
# The printed pattern. `starbench target` says what it is good for, and draws it (docs/target.md).
target:
  # serial: R-1                   # of the target; it is drawn on it
  squares: [50, 72]
  pitch_mm: 4.0138889             # as measured or as made, not as ordered
  segments: 16
  tag_family: 36h11
  tag_id: 3
  tag_square: [23, 34]
  tag_squares: 4
  polarity: positive

# A flat board at finite distance that stands there in place of the target and the collimator (docs/boards.md).
# board: {kind: checkerboard, columns: 11, rows: 7, pitch_mm: 20}

# Without a certificate of the focal length, and without the section `gimbal`, the focal length of the camera is known
# to some per cent only, because views cannot show a distortion of the collimator.
# collimator:
#   serial: C-17
#   nominal_r_mm: 255                     # focal length by the data sheet; only printed
#   certificate: {r_mm: 255.03, uncertainty_mm: 0.1, k: 2, number: T-2041, date: 2026-02-11, temperature_c: 20}
#   temperature_c: 20                     # of the collimator on this bench
#   defocus: {value: 0.0, sigma: 0.005}   # from a parallax test

# gimbal:                                 # from the data sheet or certificate of the stages
#   reading_sigma_deg: 0.002
#   scale_sigma: 2.0e-4
#   source: data sheet
#   pupil_off_pivot_mm: {value: 0, sigma: 0.5}    # `starbench run parallax_test` measures it

# budget:                                 # from the drawing and the material of the target
#   print_scale: {value: 2.0e-5, distribution: rectangular, source: drawing}
#   print_bow: {value_mm: 0.01, radius_mm: 40, distribution: rectangular, source: drawing}
#   thermal: {expansion_per_c: 9.0e-6, reference_c: 20, sigma_c: 1, source: data sheet of the glass}

# Approximate values. With them, `starbench plan` forecasts the uncertainty of the result.
# expected:
#   focal_px: 3300                        # 1000 x focal length in mm / 4.86 um (IMX636)
#   r_mm: 255                             # focal length of the collimator
#   half_angle_deg: 12                    # half angle of the beam that leaves the collimator

# What makes a run hold, and when it goes on. Delete what you do not want (docs/stations.md, Interlocks).
interlocks:
  disk_space: {min_free_gb: 2, release_gb: 4, max_hold_s: 14400}
  # device_lost: {retry_s: 5, max_hold_s: 900}    # the stage then moves again without a request
  # camera_temperature: {max_c: 60, release_c: 55, max_hold_s: 3600}
  # event_rate: {max_mev_s: 150, release_mev_s: 5, max_hold_s: 1800}
  # door: {path: /sys/class/gpio/gpio17/value, closed: "1", max_hold_s: 600}

# messages:                               # what is sent when a run holds, fails or ends
#   webhooks: [{url_env: BENCH_CHAT}]

# ledger:                                 # the newest line of the ledger, kept on another disk or share as well
#   anchor: /mnt/office/bench.heads

# limits:                                 # of the results: each run then says PASS or FAIL
#   - {result: fx, lower: 3300, upper: 3390, specification: drawing 4711}

# check_standard:                         # one camera whose control chart watches the bench
#   serial: "00051234"
#   every_days: 7

disk: {min_free_gb: 5}
"""
"""Sections that do not depend on the drivers."""


def draft_station(
    name: str, found: Discovery, *, stage: str, light: str = "scpi", camera: str | None = None
) -> str:
    """Write a new station file; the first adapter is the stage's, the second the light's.

    ``camera`` is a key of ``CAMERA_SECTIONS``; None for the first connected camera, event cameras first.
    """
    # A port of the computer itself mostly has nothing behind it: it is listed, and not chosen.
    ports = [port.name for port in found.ports if not port.device.startswith("/dev/ttyS")]
    stage_port, light_port = [*ports, UNKNOWN_PORT, UNKNOWN_PORT][:2]
    others = "".join(f"# connected: {port.name}  {port.what}\n" for port in found.ports)
    return (
        f"format: starbench/station/1\nname: {_as_yaml(name)}\n"
        f"laboratory: {UNKNOWN_LABORATORY}   # printed in the report\n\n"
        f"{others}"
        f"stage:   {_SERIAL_NOTE}\n{STAGE_SECTIONS[stage].format(stage_port=stage_port)}\n"
        f"light:\n{LIGHT_SECTIONS[light].format(light_port=light_port)}\n"
        f"camera:\n{_camera(found, camera)}"
        "  # lens: which, and how it is locked   # for the report\n\n"
        f"{COMMON_SECTIONS}"
    )


def _as_yaml(text: str) -> str:
    """Return a text as YAML: in quotes, if it has more than letters, digits, blanks and some harmless signs."""
    return text if re.fullmatch(r"[A-Za-z][\w ,./-]*(?<! )", text) else json.dumps(text, ensure_ascii=False)


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
