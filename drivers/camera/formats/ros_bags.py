"""Read events of ROS bags, of ROS 1 and ROS 2, through the package ``rosbags``; no ROS is needed.

Messages: ``dvs_msgs/EventArray`` and ``prophesee_event_msgs/EventArray`` (one struct an event), and
``event_camera_msgs/EventPacket`` with the encodings ``evt3`` (the camera's words, with its edges) and ``mono``.
Absolute times count from 1970; the second before the first event becomes 0, and stands in the header as
``time_origin_us``.

References
----------
event_camera_msgs, https://github.com/ros-event-camera/event_camera_msgs (encodings of EventPacket).
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import numpy as np

from drivers.camera.event_arrays import Events, Triggers, empty_events
from drivers.camera.evt3 import Evt3Decoder
from drivers.camera.formats.event_source import EventSource, Piece, origin_us, source_of_stream
from drivers.camera.raw_header import MAX_SIDE_PX
from drivers.errors import CameraSoftwareMissing

MAGIC_1: Final = b"#ROSBAG V2.0"
MAGIC_MCAP: Final = b"\x89MCAP0\r\n"
MAGIC_SQLITE: Final = b"SQLite format 3\x00"
_ARRAY: Final = "EventArray"
_PACKET: Final = "EventPacket"
_NO_EDGES: Final = Triggers(np.zeros(0, np.int64), np.zeros(0, np.uint8), np.zeros(0, np.uint8))

_HEADER: Final = "std_msgs/Header header\n"
_EVENT: Final = "uint16 x\nuint16 y\ntime ts\nbool polarity\n"
_DEFINITIONS: Final = {
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
    """Return whether a path is a bag: a file of ROS 1, or a folder or file of ROS 2.

    start: The file's first bytes; empty for a folder.
    Returns: True for a bag.
    """
    if path.is_dir():
        return (path / "metadata.yaml").is_file()
    return start.startswith((MAGIC_1, MAGIC_MCAP)) or (
        start.startswith(MAGIC_SQLITE) and path.suffix.lower() == ".db3"
    )


def from_bag(path: Path) -> EventSource:
    """Open a bag with one topic of events.

    path: ``.bag`` of ROS 1; folder of ROS 2, or a file of such a folder.
    Raises ValueError: If it has no topic of events or several.
    Raises CameraSoftwareMissing: If the package ``rosbags`` is not installed.
    """
    if path.suffix.lower() in {".db3", ".mcap"} and (path.parent / "metadata.yaml").is_file():
        path = path.parent
    topic, size, serial_frame = _facts(path)
    origin = origin_us(_pieces(path, topic, size, 0))
    header = {"time_origin_us": str(origin), "ros_topic": topic, "ros_frame": serial_frame}
    return source_of_stream(lambda: _pieces(path, topic, size, origin), size, header)


@contextmanager
def _opened(path: Path) -> Iterator[tuple[Any, Any]]:
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
    for name, text in _DEFINITIONS.items():
        store.register(get_types_from_msg(text, name))
    with AnyReader([path], default_typestore=store) as reader:
        yield reader, reader.deserialize


def _facts(path: Path) -> tuple[str, tuple[int, int], str]:
    """Return the topic of events, the sensor's size, and the frame of reference that the first message names."""
    with _opened(path) as (reader, decode):
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


def _pieces(path: Path, topic: str, size: tuple[int, int], origin: int) -> Iterator[Piece]:
    decoder = Evt3Decoder(*size, where=str(path))
    with _opened(path) as (reader, decode):
        used = [one for one in reader.connections if one.topic == topic]
        for connection, _, raw in reader.messages(used):
            message = decode(raw, connection.msgtype)
            if connection.msgtype.endswith(_ARRAY):
                yield _of_structs(message, origin), _NO_EDGES
            elif message.encoding == "mono":
                yield _of_mono(message, origin), _NO_EDGES
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
