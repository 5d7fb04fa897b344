"""Read and write the text header of a RAW file: lines of ``% key value``.

Every maker's reader takes the sensor's size from ``format EVT3;height=720;width=1280``, else from
``geometry 1280x720``, else from the sensor that ``system_ID`` stands for.

Source: Prophesee, "RAW File Format", https://docs.prophesee.ai/stable/data/file_formats/raw.html.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Final

from drivers.camera import CameraIdentity
from drivers.errors import NotARecording

MAX_HEADER_BYTES: Final = 65536
"""Longest header that is read."""

MAX_SIDE_PX: Final = 2048
"""Largest width and height of a sensor: EVT3 addresses have 11 bits."""

_COPY_AGAIN: Final = "Copy the file again from the computer that recorded it, or record it again."

_SIZE_OF_SYSTEM: Final = {"49": (1280, 720)}  # an IMX636 behind an EVK3 or EVK4

_MAGIC: Final = (
    (b"\x89HDF", "an HDF5 file"),
    (b"\x89PNG", "a PNG image"),
    (b"\xff\xd8\xff", "a JPEG image"),
    (b"\x1f\x8b", "a gzip archive"),
    (b"PK\x03\x04", "a zip archive"),
    (b"#!AER-DAT", "an AEDAT file"),
    (b"\x93NUMPY", "a NumPy array"),
    (b"II*\x00", "a TIFF image"),
    (b"MM\x00*", "a TIFF image"),
    (b"%PDF", "a PDF document"),
)


@dataclass(frozen=True)
class RawHeader:
    """The contents of a header."""

    # Every key and its text, white space as single blanks; of a repeated key the last text.
    fields: Mapping[str, str]
    # width, height: Size of the sensor, px.
    width: int
    height: int
    text: bytes

    @property
    def size_bytes(self) -> int:
        """Length of the header, which is the offset of the first word."""
        return len(self.text)


def parse_header(start: bytes, *, where: str) -> RawHeader:
    """Read the header in the first 65536 bytes of a file.

    Raises `NotARecording` if this is no RAW header, it does not end, it names another encoding than EVT3, or it does
    not state the size.
    """
    if not start.startswith(b"% ") or start.startswith(b"% Data file containing"):
        raise NotARecording(
            f"This is not a RAW recording: it is {_looks_like(start)}.",
            where=where,
            remedy='Give a file that an event camera recorded; it starts with "% ".',
        )
    fields, size_bytes = header_fields(start)
    if size_bytes is None:
        raise NotARecording(
            f"The header does not end within {MAX_HEADER_BYTES} bytes.", where=where, remedy=_COPY_AGAIN
        )
    width, height = _size(fields, where)
    return RawHeader(fields, width, height, start[:size_bytes])


def header_fields(start: bytes) -> tuple[dict[str, str], int | None]:
    """Read lines ``% key value`` in a file's first 65536 bytes, and the header's length, None if it does not end."""
    fields: dict[str, str] = {}
    at = 0
    while start[at : at + 2] == b"% ":
        end = start.find(b"\n", at)
        if end < 0 or end >= MAX_HEADER_BYTES - 1:
            return fields, None
        key, _, value = " ".join(start[at + 2 : end].decode("utf-8", "replace").split()).partition(" ")
        at = end + 1
        if key == "end":
            break
        fields[_printable(key)] = _printable(value)
    return fields, at


def _printable(text: str) -> str:
    """Replace what no text file should hold: control characters would reach terminals and other file formats."""
    return "".join(letter if letter.isprintable() else "\ufffd" for letter in text)


def _looks_like(start: bytes) -> str:
    """Describe a file that is no RAW file."""
    if not start:
        return "empty"
    if start.startswith(b"% Data file containing"):
        return "a DAT file"
    for magic, name in _MAGIC:
        if start.startswith(magic):
            return name
    if not start.strip(b"\0"):
        return "nothing but zeros"
    head = start[:512]
    if all(byte in b"\t\r\n" or 32 <= byte < 127 for byte in head):
        return "a text file"
    return "binary data without a RAW header"


def _size(fields: Mapping[str, str], where: str) -> tuple[int, int]:
    """Return width and height; check that all fields agree and that the encoding is EVT3."""
    encoding, *options = fields.get("format", "").split(";")
    version = fields.get("evt", "")
    if encoding not in ("", "EVT3") or version not in ("", "3.0") or not encoding + version:
        held = encoding or (f"EVT {version}" if version else "an encoding that its header does not name")
        raise NotARecording(
            f"The file holds {held}; Starbench reads only EVT3.",
            where=where,
            remedy="Record in the format EVT3, or convert the file with the camera maker's tools.",
        )
    by_format = dict(option.partition("=")[::2] for option in options)
    sizes = {}
    if "width" in by_format and "height" in by_format:
        sizes["format"] = _pixels(by_format["width"], by_format["height"], where)
    if "geometry" in fields:
        sizes["geometry"] = _pixels(*fields["geometry"].partition("x")[::2], where)
    if not sizes and fields.get("system_ID") in _SIZE_OF_SYSTEM:
        sizes["system_ID"] = _SIZE_OF_SYSTEM[fields["system_ID"]]
    if not sizes:
        raise NotARecording(
            "The header does not state the sensor's size.",
            where=where,
            remedy='Add a line such as "% geometry 1280x720" to a copy of the file.',
        )
    if len(set(sizes.values())) > 1:
        stated = ", ".join(f"{key} states {width} x {height}" for key, (width, height) in sizes.items())
        raise NotARecording(f"The header contradicts itself: {stated}.", where=where, remedy=_COPY_AGAIN)
    return next(iter(sizes.values()))


def _pixels(width: str, height: str, where: str) -> tuple[int, int]:
    """Return both sides as numbers, within what EVT3 can address."""
    sides = [int(side) if re.fullmatch(r"[0-9]{1,4}", side) else 0 for side in (width, height)]
    if not all(0 < side <= MAX_SIDE_PX for side in sides):
        raise NotARecording(
            f"The header states an invalid size of the sensor: {width!r} x {height!r}.",
            where=where,
            remedy=_COPY_AGAIN,
        )
    return sides[0], sides[1]


def render_header(camera: CameraIdentity, recorded_at: datetime) -> bytes:
    """Write the header, up to ``% end``, of a new recording, made at a time in UTC by an EVK4 or a camera like it."""
    fields = {
        "camera_integrator_name": camera.maker,
        "date": recorded_at.strftime("%Y-%m-%d %H:%M:%S"),
        "evt": "3.0",
        "format": f"EVT3;height={camera.height};width={camera.width}",
        "geometry": f"{camera.width}x{camera.height}",
        "integrator_name": camera.maker,
        "plugin_integrator_name": camera.maker,
        "plugin_name": "hal_plugin_prophesee",
        "sensor_generation": "4.2",
        "sensor_name": camera.sensor,
        "serial_number": camera.serial,
        "system_ID": "49",
    }
    lines = [f"% {key} {' '.join(value.split())}\n" for key, value in fields.items()]
    return "".join([*lines, "% end\n"]).encode("ascii", "replace")
