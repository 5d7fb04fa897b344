"""ROS bags, of ROS 1 and ROS 2, through the package ``rosbags``; no ROS is needed.

Messages: ``EventArray`` of ``dvs_msgs`` and ``prophesee_event_msgs`` (one struct an event), and
``event_camera_msgs/EventPacket``, until 2023 ``event_array_msgs/EventArray``, with the encodings ``evt3`` and ``evt21``
(the camera's words, with its edges).

Its times count from 1970; a recording of Starbench begins at 0. The second before the first event becomes 0, and stands
in the header as ``time_origin_us``.

Sources: event_camera_msgs, https://github.com/ros-event-camera/event_camera_msgs (EventPacket), and its decoders,
https://github.com/ros-event-camera/event_camera_codecs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, Final

import numpy as np

from drivers.camera.event_arrays import (
    Events,
    EventSource,
    Piece,
    ReadingChoices,
    date_of,
    empty_events,
    empty_triggers,
    origin_of,
    source_of_stream,
)
from drivers.camera.formats.library_process import LibraryFormat
from drivers.camera.raw_header import agreed_size
from drivers.errors import NotARecording

_MOST_NAMED: Final = 8  # A line

MAGIC_1: Final = b"#ROSBAG V2.0"
MAGIC_MCAP: Final = b"\x89MCAP0\r\n"
MAGIC_SQLITE: Final = b"SQLite format 3\x00"
_OF_EVENTS: Final = ("EventArray", "EventPacket")

_HEADER: Final = "std_msgs/Header header\n"
_PACKET_TEXT: Final = (
    f"{_HEADER}uint32 height\nuint32 width\nuint64 seq\nuint64 time_base\nstring encoding\n"
    "bool is_bigendian\nuint8[] events\n"
)
_EVENT: Final = "uint16 x\nuint16 y\nbuiltin_interfaces/Time ts\nbool polarity\n"
_STRUCTS: Final = "structs"  # In place of an encoding: a struct an event
_OF_STRUCTS: Final = ("dvs_msgs", "prophesee_event_msgs")
DEFINITIONS: Final = {
    **{f"{package}/msg/Event": _EVENT for package in _OF_STRUCTS},
    **{
        f"{package}/msg/EventArray": f"{_HEADER}uint32 height\nuint32 width\n{package}/Event[] events\n"
        for package in _OF_STRUCTS
    },
    "event_camera_msgs/msg/EventPacket": _PACKET_TEXT,
    "event_array_msgs/msg/EventArray": _PACKET_TEXT,
}
"""Definitions for bags of ROS 2 that do not hold them."""


def is_bag(path: Path, start: bytes) -> bool:
    """Return whether a path is a bag: a file of ROS 1 by its first bytes, or a folder or file of ROS 2."""
    if path.is_dir():
        return (path / "metadata.yaml").is_file()
    return start.startswith((MAGIC_1, MAGIC_MCAP)) or (
        start.startswith(MAGIC_SQLITE) and path.suffix.lower() == ".db3"
    )


BAG: Final = LibraryFormat(f"{__name__}:open_bag", is_bag)


def open_bag(path: Path, choices: ReadingChoices) -> EventSource:
    """Open a topic of events of a bag: ``.bag`` of ROS 1; folder of ROS 2, or a file of such a folder."""
    if path.suffix.lower() in {".db3", ".mcap"} and (path.parent / "metadata.yaml").is_file():
        path = path.parent
    topic, first = _first_message(path, choices)
    stated = int(first.width), int(first.height)
    size = agreed_size({"the topic": stated} if all(stated) else {}, choices.sensor_size, "")
    origin = origin_of(_bag_pieces(path, topic, size, 0))
    stamp = first.header.stamp
    frame = "".join(letter if letter.isprintable() else "?" for letter in str(first.header.frame_id))
    facts = {"ros_topic": topic, "ros_frame": frame[:80]}
    header = {
        **date_of(stamp.sec * 1_000_000),
        **origin.header,
        **{key: fact for key, fact in facts.items() if fact},
    }
    return source_of_stream(lambda: _bag_pieces(path, topic, size, origin.us), size, header)


@contextmanager
def _opened_bag(path: Path) -> Iterator[tuple[Any, Any]]:
    """Open a bag; yield its reader and a function that decodes a message."""
    from rosbags.highlevel import AnyReader, AnyReaderError
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    for name, text in DEFINITIONS.items():
        store.register(get_types_from_msg(text, name))
    with ExitStack() as opened:
        try:
            reader = opened.enter_context(AnyReader([path], default_typestore=store))
        except AnyReaderError as error:
            what = "The bag has no index, or lacks a file: its recording was interrupted, or it was copied in part."
            program = "ros2 bag" if path.is_dir() else "rosbag"
            remedy = f"Copy it again, or write its index anew: {program} reindex {path.name}"
            raise NotARecording(what, remedy=remedy) from error
        yield reader, reader.deserialize


def _first_message(path: Path, choices: ReadingChoices) -> tuple[str, Any]:
    """Return the topic of events to read, and its first message."""
    with _opened_bag(path) as (reader, decode):
        of_events = {one.topic for one in reader.connections if one.msgtype.endswith(_OF_EVENTS)}
        if not of_events:
            topics = sorted(f"{one.topic} ({one.msgtype})" for one in reader.connections)
            raise NotARecording(
                f"This bag has no topic of events; its topics: {', '.join(topics[:_MOST_NAMED]) or 'none'}.",
                remedy="Give a bag with messages EventArray or EventPacket.",
            )
        topic = choices.chosen(of_events)
        for connection, _, raw in reader.messages([one for one in reader.connections if one.topic == topic]):
            try:
                return topic, decode(raw, connection.msgtype)
            except KeyError as error:
                raise NotARecording(
                    f"This bag does not hold the definition of its messages, {connection.msgtype}.",
                    remedy="Convert it to MCAP, which holds them, where its package is installed: ros2 bag convert",
                ) from error
    raise NotARecording(f"This bag holds no message of {topic}.", remedy="Record it again.")


def _bag_pieces(path: Path, topic: str, size: tuple[int, int], origin: int) -> Iterator[Piece]:
    decoders: dict[str, Any] = {}
    with _opened_bag(path) as (reader, decode):
        used = [one for one in reader.connections if one.topic == topic]
        last = None
        for connection, _, raw in reader.messages(used):
            message = decode(raw, connection.msgtype)
            encoding = getattr(message, "encoding", _STRUCTS)
            number = getattr(message, "seq", None)
            if number is not None and last is not None and number - last > 1:
                raise NotARecording(
                    f"{number - last - 1} messages of {topic} are missing after number {last}: ROS lost them, and the"
                    f" words of {encoding} cannot be read without them.",
                    remedy="Record again with longer queues or a higher threshold of the camera's driver.",
                )
            last = number
            if encoding not in decoders:
                decoders[encoding] = _decoder_of(encoding, size, str(path))
            for events, edges in decoders[encoding](message):
                yield events._replace(t=events.t - origin), edges._replace(t=edges.t - origin)


def _decoder_of(encoding: str, size: tuple[int, int], where: str) -> Callable[[Any], Iterable[Piece]]:
    """Return what decodes the messages of one encoding, in their order."""
    if encoding == "evt3":
        from drivers.camera.evt3 import Evt3Decoder  # its compiler takes a second, and memory

        of_words = Evt3Decoder(*size, where=where)
        return lambda message: map(_copied, of_words.decode([np.frombuffer(_bytes(message), "<u2")]))
    if encoding == "evt21":
        from drivers.camera.formats.prophesee_words import Evt2Decoder

        of_vectors = Evt2Decoder("EVT21")
        return lambda message: [of_vectors.decode(_bytes(message))]
    if encoding != _STRUCTS:
        raise NotARecording(
            f"Its events are encoded as {encoding[:40]!r}; evt3 and evt21 can be read.",
            remedy="Record the topic in one of them, or as dvs_msgs/EventArray.",
        )
    return lambda message: [(_of_structs(message), empty_triggers(0))]


def _bytes(message: Any) -> bytes:
    return np.ascontiguousarray(message.events, np.uint8).tobytes()


def _copied(piece: Piece) -> Piece:
    """Return a copy of a piece; the decoder reuses its arrays."""
    events, edges = piece
    return Events(events.t.copy(), events.x.copy(), events.y.copy(), events.p.copy()), edges


def _of_structs(message: Any) -> Events:
    events = empty_events(len(message.events))
    for k, event in enumerate(message.events):
        events.t[k] = event.ts.sec * 1_000_000 + event.ts.nanosec // 1000
        events.x[k], events.y[k], events.p[k] = event.x, event.y, event.polarity
    return events
