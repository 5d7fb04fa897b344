"""Read and write the text header of Prophesee's files: lines of ``% key value``.

Every maker's reader takes the sensor's size from ``format EVT3;height=720;width=1280``, else from
``geometry 1280x720`` or ``Height`` and ``Width``, else from the sensor that ``system_ID`` stands for.

Sources: Prophesee, "RAW File Format", https://docs.prophesee.ai/stable/data/file_formats/raw.html. The sensors of
``system_ID``: OpenEB (device_system_id.h, psee_raw_file_header.cpp).
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Final, NamedTuple

from drivers.camera import CameraIdentity
from drivers.camera.file_kinds import is_dat, kind_of_file
from drivers.errors import NotARecording

MAX_HEADER_BYTES: Final = 65536
"""Longest header that is read; cameras write some hundred bytes."""

MAX_SIDE_PX: Final = 2048
"""Largest width and height of a sensor: EVT3 addresses have 11 bits."""

_OF_INDEX: Final = frozenset({"index_version", "magic_number", "ts_shift_us"})
"""Keys of OpenEB's index of a recording (i_events_stream.cpp); no recording has one of them."""
_COPY_AGAIN: Final = "Copy the file again from the computer that recorded it."
_CORRECT: Final = "Correct its header in a copy of the file."
GIVE_SIZE: Final = (
    "State the size, px: `convert --sensor-size WIDTHxHEIGHT`, or `calibrate --image-size WIDTHxHEIGHT`."
)
_FIRST_LITTLE_ENDIAN: Final = 55
"""Smallest ``system_ID`` whose EVT2.1 words are little-endian if the header does not say it."""
_ENCODINGS: Final = {
    **dict.fromkeys(("2.0", "2"), "EVT2"),
    "2.1": "EVT21",
    **dict.fromkeys(("3.0", "3"), "EVT3"),
    **dict.fromkeys(("4.0", "4"), "EVT4"),
}
"""Encodings by the older key ``evt``."""


class Sensor(NamedTuple):
    """A sensor that ``system_ID`` stands for, and what it sends if the header does not say it."""

    encoding: str
    width: int  # px
    height: int  # px


_VGA: Final = Sensor("EVT2", 640, 480)  # Gen3.0 and Gen3.1
_HD_EVT2: Final = Sensor("EVT2", 1280, 720)  # Gen4.0 and Gen4.1 behind a CCAM3 or an EVK2
_HD: Final = Sensor("EVT3", 1280, 720)  # Gen4.0, Gen4.1, IMX636, IMX646
_STACKED_VGA: Final = Sensor("EVT3", 640, 512)  # IMX637, IMX647
_GENX320: Final = Sensor("EVT21", 320, 320)
SENSOR_OF_SYSTEM: Final[Mapping[str, Sensor]] = {
    **dict.fromkeys(("21", "23", "25", "28", "29", "33", "34", "35", "41"), _VGA),
    **dict.fromkeys(("151", "153", "161", "162"), _VGA),  # the same behind an EVK: 128 more
    "40": Sensor("EVT3", 640, 480),
    **dict.fromkeys(("26", "31", "39", "154"), _HD_EVT2),
    **dict.fromkeys(("30", "32", "46", "48", "49", "50", "53", "58", "66"), _HD),
    **dict.fromkeys(("52", "54"), _STACKED_VGA),
    **dict.fromkeys(("55", "59", "64"), _GENX320),
}


@dataclass(frozen=True)
class RawHeader:
    """The contents of a header."""

    # Every key and its text, white space as single blanks; of a repeated key the last text.
    fields: Mapping[str, str]
    # "EVT2", "EVT21" (32-bit halves in the order low, high), "EVT21-legacy" (high, low) or "EVT3"
    encoding: str
    width: int  # Of the sensor, px
    height: int  # Of the sensor, px
    text: bytes

    @property
    def size_bytes(self) -> int:
        """Length of the header, which is the offset of the first word."""
        return len(self.text)


def parse_header(
    start: bytes, *, where: str, sensor_size: tuple[int, int] | None = None, evt3_only: bool = True
) -> RawHeader:
    """Read the header in the first 65536 bytes of a RAW file; ``sensor_size``, px, is for one that does not state it.

    Raises `NotARecording` if this is no RAW header, it does not end, it names an encoding that is not read, or the size
    is missing.
    """
    if not start.startswith(b"% ") or is_dat(start):
        what, remedy = kind_of_file(start)
        raise NotARecording(
            f"This is not a RAW recording: it is {what}.",
            where=where,
            remedy=remedy or 'Give a file that an event camera recorded; it starts with "% ".',
        )
    fields, size_bytes = header_fields(start)
    if size_bytes is None:
        is_cut = len(start) < MAX_HEADER_BYTES
        end = (
            "ends within its header"
            if is_cut
            else f"has a header that does not end within {MAX_HEADER_BYTES} bytes"
        )
        raise NotARecording(f"The file {end}.", where=where, remedy=_COPY_AGAIN)
    if _OF_INDEX & fields.keys():
        raise NotARecording(
            "This file holds no events. It is the index that Metavision writes beside a recording.",
            where=where,
            remedy="Give the recording itself, whose name is the same without .tmp_index.",
        )
    encoding = encoding_of(fields)
    if encoding not in {"EVT2", "EVT21", "EVT21-legacy", "EVT3"}:
        raise NotARecording(
            f"The file holds {encoding or 'an encoding that its header does not name'}; Starbench reads EVT3, EVT2 and"
            " EVT2.1.",
            where=where,
            remedy="Convert the file with the camera maker's tools, or record in the format EVT3.",
        )
    if evt3_only and encoding != "EVT3":
        raise NotARecording(
            f"The file holds {encoding.removesuffix('-legacy')}; only EVT3 is read here.",
            where=where,
            remedy="Convert it first: starbench convert FILE evt3.raw",
        )
    width, height = stated_size(fields, where, sensor_size)
    return RawHeader(fields, encoding, width, height, start[:size_bytes])


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


def encoding_of(fields: Mapping[str, str]) -> str:
    """Return which words a header announces, such as "EVT3", or "" if it does not tell."""
    fields = _small(fields)
    stated, *options = fields.get("format", "").split(";")
    sensor = _sensor_of_system(fields)
    version = fields.get("evt", "")
    by_version = _ENCODINGS.get(version, f"EVT {version}" if version else "")
    encoding = stated.upper().replace("EVT2.1", "EVT21") or by_version or (sensor.encoding if sensor else "")
    if encoding != "EVT21":
        return encoding
    order = _options(options).get("endianness") or fields.get("endianness")
    if order is None and _is_of_maker(fields) and fields.get("system_id", "").isdecimal():
        order = "legacy" if 0 < int(fields["system_id"]) < _FIRST_LITTLE_ENDIAN else None
    return "EVT21-legacy" if order == "legacy" else encoding


def _small(fields: Mapping[str, str]) -> dict[str, str]:
    """Return fields with their keys in small letters: writers differ in ``Date``, ``Height`` and others."""
    return {key.lower(): value for key, value in fields.items()}


def _options(parts: Sequence[str]) -> dict[str, str]:
    """Return the options ``key=value`` of ``format``."""
    return {key: value for key, _, value in (part.strip().partition("=") for part in parts)}


def _is_of_maker(fields: Mapping[str, str]) -> bool:
    """Return whether the maker of the sensors wrote the file: only then ``system_ID`` is one of its numbers."""
    keys = ("integrator_name", "camera_integrator_name", "plugin_integrator_name")
    return all(fields.get(key, "Prophesee") == "Prophesee" for key in keys)


def _sensor_of_system(fields: Mapping[str, str]) -> Sensor | None:
    return SENSOR_OF_SYSTEM.get(fields.get("system_id", "")) if _is_of_maker(fields) else None


def stated_size(
    fields: Mapping[str, str],
    where: str,
    given: tuple[int, int] | None,
    *,
    others: Mapping[str, tuple[int, int]] | None = None,
    most_px: int = MAX_SIDE_PX,
) -> tuple[int, int]:
    """Return width and height, px, as a header, the user and ``others``, by name, state them: all must agree.

    The sensor that ``system_ID`` stands for is asked last.
    """
    fields = _small(fields)
    sizes = dict(others or {})
    for key, sides in (
        ("format", _options(fields.get("format", "").split(";")[1:])),
        ("Width and Height", fields),
    ):
        if "width" in sides and "height" in sides:
            sizes[key] = _pixels(sides["width"], sides["height"], where, most_px)
    if "geometry" in fields:
        sizes["geometry"] = _pixels(*fields["geometry"].partition("x")[::2], where, most_px)
    sensor = _sensor_of_system(fields)
    if not sizes and sensor and not given:
        return sensor.width, sensor.height
    return agreed_size(sizes, given, where)


def agreed_size(
    sizes: Mapping[str, tuple[int, int]], given: tuple[int, int] | None, where: str
) -> tuple[int, int]:
    """Return the size of the sensor on which what a file states (by name) and what the user says agree."""
    every = {**sizes, **({"your option": given} if given else {})}
    if not every:
        raise NotARecording("The file does not state the sensor's size.", where=where, remedy=GIVE_SIZE)
    if len(set(every.values())) > 1:
        stated = ", ".join(f"{key} states {width} x {height}" for key, (width, height) in every.items())
        raise NotARecording(
            f"The sizes of the sensor contradict each other: {stated}.",
            where=where,
            remedy="Leave out your option." if len(set(sizes.values())) == 1 else _CORRECT,
        )
    return next(iter(every.values()))


def _pixels(width: str, height: str, where: str, most_px: int) -> tuple[int, int]:
    """Return both sides as numbers, within what the words can address."""
    sides = [int(side) if re.fullmatch(r" *[0-9]{1,5} *", side) else 0 for side in (width, height)]
    if not all(0 < side <= most_px for side in sides):
        raise NotARecording(
            f"The header states an invalid size of the sensor: {width!r} x {height!r}.",
            where=where,
            remedy=_CORRECT,
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
    return render_fields(fields)


def render_fields(fields: Mapping[str, str]) -> bytes:
    """Write a header of keys and texts, up to ``% end``, on whose lines no text can write another line."""
    lines = [f"% {'_'.join(key.split())} {' '.join(value.split())}\n" for key, value in fields.items()]
    return "".join([*lines, "% end\n"]).encode("ascii", "replace")
