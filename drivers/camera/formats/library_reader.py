"""Read files of other programs through their libraries: the program of the process that `library_process` starts.

    python -m drivers.camera.formats.library_reader KIND PATH

It limits its own memory first. The file is read twice: once to count the events and to collect the edges; and its
events are written as messages.

- NumPy's ``.npz``, as `event_files` writes it.
- iniVation's AEDAT4, through the package ``aedat``.
- ROS bags, of ROS 1 and ROS 2, through the package ``rosbags``; no ROS is needed. Messages:
  ``dvs_msgs/EventArray`` and ``prophesee_event_msgs/EventArray`` (one struct an event), and
  ``event_camera_msgs/EventPacket`` with the encodings ``evt3`` (the camera's words, with its edges) and ``mono``.

The times of the last two count from 1970; a recording of Starbench begins at 0. The second before the first event
becomes 0, and stands in the header as ``time_origin_us``.

Source: event_camera_msgs, https://github.com/ros-event-camera/event_camera_msgs (encodings of EventPacket).
"""

from __future__ import annotations

import json
import sys
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import numpy as np

from drivers.camera.event_arrays import (
    Events,
    EventSource,
    Piece,
    Triggers,
    as_events,
    as_triggers,
    empty_events,
    empty_triggers,
    origin_us,
    require_one_length,
    require_ratio,
    source_of_stream,
)
from drivers.camera.formats import library_process
from drivers.camera.raw_header import MAX_SIDE_PX
from drivers.errors import CameraSoftwareMissing, DriverError, RecordingCorrupt

_PIECE: Final = 500_000
_NAMED: Final = {"npz": "NumPy file", "aedat4": "AEDAT4 file", "bag": "ROS bag"}


def main(kind: str, path: Path) -> None:
    """Read a file and write the messages; the last one says that it is the end, or what is wrong."""
    _limit_memory()
    try:
        source = _open(kind, path)
        for begin in range(0, len(source.triggers.t), _PIECE):
            _write({}, triggers=source.triggers.part(begin, begin + _PIECE))
        size = {"count": source.count, "width": source.width, "height": source.height}
        _write({**size, "header": dict(source.header)})
        for events in source.pieces():
            for begin in range(0, len(events.t), _PIECE):
                _write({}, events.part(begin, begin + _PIECE))
        _write({"end": True})
    except CameraSoftwareMissing as error:
        _write({"kind": "missing", "error": error.what, "remedy": error.remedy})
    except RecordingCorrupt as error:
        what = error.what.removesuffix(f" (byte {error.offset}).")  # the reader of this names the place again
        _write({"kind": "corrupt", "error": what, "remedy": error.remedy, "offset": error.offset})
    except DriverError as error:
        _write({"kind": "other", "error": error.what, "remedy": error.remedy})
    except MemoryError:
        _write({"kind": "memory"})
    except ValueError as error:
        _write({"kind": "unreadable", "error": " ".join(str(error).split())[:300]})
    except BaseException as error:  # a panic of compiled code is no Exception
        why = " ".join(str(error).split())[:200]
        _write({"kind": "unreadable", "error": f"it is no readable {_NAMED[kind]} ({why})"})
        raise


def _limit_memory() -> None:
    try:
        import resource
    except ImportError:  # Windows
        return
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    most = (
        library_process.MOST_BYTES
        if hard == resource.RLIM_INFINITY
        else min(library_process.MOST_BYTES, hard)
    )
    resource.setrlimit(resource.RLIMIT_AS, (most, hard))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _open(kind: str, path: Path) -> EventSource:
    return {"npz": _from_npz, "aedat4": _from_aedat4, "bag": _from_bag}[kind](path)


def _write(text: Mapping[str, Any], events: Events | None = None, triggers: Triggers | None = None) -> None:
    events, triggers = events or empty_events(0), triggers or empty_triggers(0)
    told = json.dumps(text).encode()
    out = sys.stdout.buffer
    out.write(library_process.HEAD.pack(len(told), len(events.t), len(triggers.t)) + told)
    for array in (*events, *triggers):
        out.write(np.ascontiguousarray(array).tobytes())
    out.flush()


def _from_npz(path: Path) -> EventSource:
    """Open NumPy's ``.npz``, as `event_files` writes it. Only plain numbers are read."""
    with zipfile.ZipFile(path) as archive:
        require_ratio(sum(one.file_size for one in archive.infolist()), path.stat().st_size, "it")
    with np.load(path, allow_pickle=False) as file:
        width, height = (int(side) for side in _array(file, "size"))
        columns = {name: _array(file, name) for name in Events._fields}
        require_one_length({name: len(column) for name, column in columns.items()})
        events = as_events(**columns)
        triggers = as_triggers({name: _array(file, f"trigger_{name}") for name in Triggers._fields})

    def stream() -> Iterator[Piece]:
        yield events, triggers

    return source_of_stream(stream, (width, height), {})


def _array(file: Mapping[str, Any], name: str) -> Any:
    if name not in file:
        raise ValueError(f"{name} is missing")
    return file[name]


AEDAT4_MAGIC: Final = b"#!AER-DAT4.0"
_RISING: Final = 1
_FALLING: Final = 2


def _from_aedat4(path: Path) -> EventSource:
    """Open an AEDAT4 file with one stream of events, with the edges at the camera's signal input."""
    streams = _decoder(path).id_to_stream()
    of_events = {number: one for number, one in streams.items() if one.get("type") == "events"}
    if len(of_events) != 1:
        raise ValueError(f"this AEDAT4 file has {len(of_events)} streams of events; one is needed")
    number, facts = next(iter(of_events.items()))
    origin = origin_us(_aedat4_pieces(path, number, 0))
    header = {"time_origin_us": str(origin)}
    return source_of_stream(
        lambda: _aedat4_pieces(path, number, origin), (int(facts["width"]), int(facts["height"])), header
    )


def _decoder(path: Path) -> Any:
    try:
        import aedat
    except ImportError as error:
        raise CameraSoftwareMissing(
            "Reading AEDAT4 files needs the package aedat.",
            where=str(path),
            remedy="Install it: pip install 'starbench[formats]'",
        ) from error
    return aedat.Decoder(path)


def _aedat4_pieces(path: Path, number: int, origin: int) -> Iterator[Piece]:
    for packet in _decoder(path):
        if packet.get("stream_id") == number and "events" in packet:
            rows = packet["events"]
            for begin in range(0, len(rows), _PIECE):
                part = rows[begin : begin + _PIECE]
                yield _aedat4_events(part, origin), empty_triggers(0)
        elif "triggers" in packet:
            yield empty_events(0), _aedat4_edges(packet["triggers"], origin)


def _aedat4_events(rows: Any, origin: int) -> Events:
    return Events(
        rows["t"].astype(np.int64) - origin,
        np.ascontiguousarray(rows["x"], np.uint16),
        np.ascontiguousarray(rows["y"], np.uint16),
        rows["on"].astype(np.uint8),
    )


def _aedat4_edges(rows: Any, origin: int) -> Triggers:
    """Keep the edges of the external signal; other triggers are the camera's own, such as frames."""
    rows = rows[np.isin(rows["source"], (_RISING, _FALLING))]
    return Triggers(
        rows["t"].astype(np.int64) - origin,
        (rows["source"] == _RISING).astype(np.uint8),
        np.zeros(len(rows), np.uint8),
    )


MAGIC_1: Final = b"#ROSBAG V2.0"
MAGIC_MCAP: Final = b"\x89MCAP0\r\n"
MAGIC_SQLITE: Final = b"SQLite format 3\x00"
_ARRAY: Final = "EventArray"
_PACKET: Final = "EventPacket"

_HEADER: Final = "std_msgs/Header header\n"
_EVENT: Final = "uint16 x\nuint16 y\ntime ts\nbool polarity\n"
DEFINITIONS: Final = {
    "dvs_msgs/msg/Event": _EVENT.replace("time ts", "builtin_interfaces/Time ts"),
    "dvs_msgs/msg/EventArray": f"{_HEADER}uint32 height\nuint32 width\ndvs_msgs/Event[] events\n",
    "prophesee_event_msgs/msg/Event": _EVENT.replace("time ts", "builtin_interfaces/Time ts"),
    "prophesee_event_msgs/msg/EventArray": (
        f"{_HEADER}uint32 height\nuint32 width\nprophesee_event_msgs/Event[] events\n"
    ),
    "event_camera_msgs/msg/EventPacket": (
        f"{_HEADER}uint32 height\nuint32 width\nuint64 seq\nuint64 time_base\nstring encoding\n"
        "bool is_bigendian\nuint8[] events\n"
    ),
}
"""Definitions for bags of ROS 2 that do not hold them."""


def is_bag(path: Path, start: bytes) -> bool:
    """Return whether a path is a bag: a file of ROS 1 by its first bytes, or a folder or file of ROS 2."""
    if path.is_dir():
        return (path / "metadata.yaml").is_file()
    return start.startswith((MAGIC_1, MAGIC_MCAP)) or (
        start.startswith(MAGIC_SQLITE) and path.suffix.lower() == ".db3"
    )


def _from_bag(path: Path) -> EventSource:
    """Open a bag with one topic of events: ``.bag`` of ROS 1; folder of ROS 2, or a file of such a folder."""
    if path.suffix.lower() in {".db3", ".mcap"} and (path.parent / "metadata.yaml").is_file():
        path = path.parent
    topic, size, serial_frame = _bag_facts(path)
    origin = origin_us(_bag_pieces(path, topic, size, 0))
    header = {"time_origin_us": str(origin), "ros_topic": topic, "ros_frame": serial_frame}
    return source_of_stream(lambda: _bag_pieces(path, topic, size, origin), size, header)


@contextmanager
def _opened_bag(path: Path) -> Iterator[tuple[Any, Any]]:
    """Open a bag; yield its reader and a function that decodes a message."""
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore
    except ImportError as error:
        raise CameraSoftwareMissing(
            "Reading ROS bags needs the package rosbags.",
            where=str(path),
            remedy="Install it: pip install 'starbench[formats]'",
        ) from error
    store = get_typestore(Stores.ROS2_HUMBLE)
    for name, text in DEFINITIONS.items():
        store.register(get_types_from_msg(text, name))
    with AnyReader([path], default_typestore=store) as reader:
        yield reader, reader.deserialize


def _bag_facts(path: Path) -> tuple[str, tuple[int, int], str]:
    """Return the topic of events, the sensor's size, and the frame of reference that the first message names."""
    with _opened_bag(path) as (reader, decode):
        found = {one.topic for one in reader.connections if one.msgtype.endswith((_ARRAY, _PACKET))}
        if len(found) != 1:
            topics = ", ".join(sorted(one.topic for one in reader.connections)) or "none"
            held = f"{len(found)} topics of events; one is needed" if found else "no topic of events"
            raise ValueError(f"this bag has {held} (its topics: {topics})")
        topic = found.pop()
        used = [one for one in reader.connections if one.topic == topic]
        for connection, _, raw in reader.messages(used):
            message = decode(raw, connection.msgtype)
            size = int(message.width), int(message.height)
            if not all(0 < side <= MAX_SIDE_PX for side in size):
                raise ValueError(f"it states a sensor of {size[0]} x {size[1]} px")
            frame = "".join(
                letter if letter.isprintable() else "?" for letter in str(message.header.frame_id)
            )
            return topic, size, frame[:80]
    raise ValueError("this bag holds no message of events")


def _bag_pieces(path: Path, topic: str, size: tuple[int, int], origin: int) -> Iterator[Piece]:
    from drivers.camera.evt3 import Evt3Decoder  # its compiler takes a second, and memory

    decoder = Evt3Decoder(*size, where=str(path))
    with _opened_bag(path) as (reader, decode):
        used = [one for one in reader.connections if one.topic == topic]
        for connection, _, raw in reader.messages(used):
            message = decode(raw, connection.msgtype)
            if connection.msgtype.endswith(_ARRAY):
                yield _of_structs(message, origin), empty_triggers(0)
            elif message.encoding == "mono":
                yield _of_mono(message, origin), empty_triggers(0)
            elif message.encoding == "evt3":
                words = np.frombuffer(np.ascontiguousarray(message.events, np.uint8).tobytes(), "<u2")
                for events, edges in decoder.decode(words):
                    yield _moved(events, origin), edges._replace(t=edges.t - origin)
            else:
                raise ValueError(f"its events are encoded as {message.encoding!r}; evt3 and mono can be read")


def _moved(events: Events, origin: int) -> Events:
    """Return a copy with the times since the origin; the decoder reuses its arrays."""
    return Events(events.t - origin, events.x.copy(), events.y.copy(), events.p.copy())


def _of_structs(message: Any, origin: int) -> Events:
    n = len(message.events)
    events = empty_events(n)
    for k, one in enumerate(message.events):
        events.t[k] = one.ts.sec * 1_000_000 + one.ts.nanosec // 1000 - origin
        events.x[k], events.y[k], events.p[k] = one.x, one.y, one.polarity
    return events


def _of_mono(message: Any, origin: int) -> Events:
    """Read 8 bytes an event: time since ``time_base`` in ns [31:0], x [46:32], y [62:48], polarity [63]."""
    data = np.ascontiguousarray(message.events, np.uint8).tobytes()
    if len(data) % 8:
        raise ValueError("a message of events ends in the middle of an event")
    packed = np.frombuffer(data, ">u8" if message.is_bigendian else "<u8")
    t = (np.int64(message.time_base) + (packed & 0xFFFFFFFF).astype(np.int64)) // 1000 - origin
    x, y = ((packed >> 32) & 0x7FFF).astype(np.uint16), ((packed >> 48) & 0x7FFF).astype(np.uint16)
    return Events(t, x, y, (packed >> 63).astype(np.uint8))


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
