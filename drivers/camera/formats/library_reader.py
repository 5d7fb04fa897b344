"""Read files of other programs through their libraries: the program of the process that `library_process` starts.

    python -m drivers.camera.formats.library_reader KIND PATH CHOICES

It limits its own memory first. The file is read twice: once to count the events and to collect the edges; and its
events are written as messages.

- Tables of NumPy, of Parquet and of text (`table_files`).
- HDF5 that only its library can read, with the filters of the package ``hdf5plugin``.
- iniVation's AEDAT4, through the package ``aedat``.
- ROS bags, of ROS 1 and ROS 2, through the package ``rosbags``; no ROS is needed. Messages: ``EventArray`` of
  ``dvs_msgs`` and ``prophesee_event_msgs`` (one struct an event), and ``event_camera_msgs/EventPacket``, until 2023
  ``event_array_msgs/EventArray``, with the encodings ``evt3`` and ``evt21`` (the camera's words, with its edges).

The times of the last two count from 1970; a recording of Starbench begins at 0. The second before the first event
becomes 0, and stands in the header as ``time_origin_us``.

Sources: event_camera_msgs, https://github.com/ros-event-camera/event_camera_msgs (EventPacket), and its decoders,
https://github.com/ros-event-camera/event_camera_codecs.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any, Final

import numpy as np

from drivers.camera.event_arrays import (
    MOST_TRIGGERS,
    Events,
    EventSource,
    Piece,
    ReadingChoices,
    Triggers,
    date_of,
    empty_events,
    empty_triggers,
    join_triggers,
    origin_of,
    too_many_edges,
    with_edges,
)
from drivers.camera.formats import library_process
from drivers.camera.formats.table_files import from_npy, from_npz, from_parquet, from_text
from drivers.camera.raw_header import agreed_size
from drivers.errors import (
    CameraSoftwareMissing,
    DriverError,
    NotARecording,
    RecordingCorrupt,
    UnreadableEvents,
)

_PIECE: Final = 500_000  # Events
_MOST_NAMED: Final = 8  # A line
AEDAT4_MAGIC: Final = b"#!AER-DAT4.0"
_RISING: Final = 1  # Of AEDAT4's trigger sources
_FALLING: Final = 2  # Of AEDAT4's trigger sources

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


def main(kind: str, path: Path, choices: ReadingChoices) -> None:
    """Read a file and write the messages; the last one says that it is the end, or what is wrong."""
    _limit_memory()
    try:
        of_tables = {"npz": from_npz, "npy": from_npy, "parquet": from_parquet, "text": from_text}
        open_file = {**of_tables, "hdf5": _from_hdf5, "aedat4": _from_aedat4, "bag": _from_bag}[kind]
        source = open_file(path, choices)
        facts = {name: getattr(source, name) for name in ("count", "width", "height", "truncated", "unit")}
        _write({**facts, "header": dict(source.header), "assumed": dict(source.assumed)})
        for events, edges in source.pieces():
            for begin in range(0, max(len(events.t), len(edges.t)), _PIECE):
                _write({}, events.part(begin, begin + _PIECE), edges.part(begin, begin + _PIECE))
        _write({"end": True})
    except CameraSoftwareMissing as error:
        _write({"kind": "missing", "error": error.what, "remedy": error.remedy})
    except RecordingCorrupt as error:
        what = error.what.removesuffix(f" (byte {error.offset}).")  # the reader of this names the place again
        _write({"kind": "corrupt", "error": what, "remedy": error.remedy, "offset": error.offset})
    except DriverError as error:
        # What to do about unreadable events is the same for every reader: the bench says it with the file's name.
        remedy = "" if isinstance(error, UnreadableEvents) else error.remedy
        _write({"kind": "other", "error": error.what, "remedy": remedy})
    except MemoryError:
        _write({"kind": "memory"})
    except BaseException:  # a panic of compiled code is no Exception
        _write({"kind": "unreadable"})
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


def _write(text: Mapping[str, Any], events: Events | None = None, triggers: Triggers | None = None) -> None:
    events, triggers = events or empty_events(0), triggers or empty_triggers(0)
    encoded = json.dumps(text).encode()
    out = sys.stdout.buffer
    out.write(library_process.HEAD.pack(len(encoded), len(events.t), len(triggers.t)) + encoded)
    for array in (*events, *triggers):
        out.write(np.ascontiguousarray(array).tobytes())
    out.flush()


def _from_hdf5(path: Path, choices: ReadingChoices) -> EventSource:
    import h5py

    from drivers.camera.formats.hdf5_events import opened_hdf5

    with suppress(ImportError):
        import hdf5plugin  # noqa: F401 - registers the filters
    source = opened_hdf5(h5py.File(path, "r"), choices, by_library=True)
    assert source is not None
    return source


def _from_aedat4(path: Path, choices: ReadingChoices) -> EventSource:
    """Open a stream of events of an AEDAT4 file, named by its number, with the edges at the camera's signal input."""
    streams = {str(number): packet_stream for number, packet_stream in _decoder(path).id_to_stream().items()}
    name = choices.chosen(number for number, stream in streams.items() if stream.get("type") == "events")
    width, height = (streams[name].get(side) for side in ("width", "height"))
    size = agreed_size(
        {"the stream": (int(width), int(height))} if width and height else {}, choices.sensor_size, ""
    )
    origin = origin_of(_aedat4_pieces(path, int(name), 0))
    return _source_of_stream(lambda: _aedat4_pieces(path, int(name), origin.us), size, origin.header)


def _source_of_stream(
    stream: Callable[[], Iterator[Piece]], size: tuple[int, int], header: Mapping[str, str]
) -> EventSource:
    """Read a stream once, to count the events and to collect the edges; it is read again for the events.

    In AEDAT4, edges stand behind the events of their time.
    """
    count, edges, parts = 0, 0, []
    for events, triggers in stream():
        count += len(events.t)
        edges += len(triggers.t)
        if edges > MOST_TRIGGERS:
            raise too_many_edges()
        if len(triggers.t):
            parts.append(triggers)
    joined = join_triggers(parts)
    return EventSource(
        *size, header, lambda: with_edges((events for events, _ in stream()), joined), count=count
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


def is_bag(path: Path, start: bytes) -> bool:
    """Return whether a path is a bag: a file of ROS 1 by its first bytes, or a folder or file of ROS 2."""
    if path.is_dir():
        return (path / "metadata.yaml").is_file()
    return start.startswith((MAGIC_1, MAGIC_MCAP)) or (
        start.startswith(MAGIC_SQLITE) and path.suffix.lower() == ".db3"
    )


BAG: Final = library_process.LibraryFormat("bag", is_bag)
AEDAT4: Final = library_process.LibraryFormat("aedat4", lambda _, start: start.startswith(AEDAT4_MAGIC))


def _from_bag(path: Path, choices: ReadingChoices) -> EventSource:
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
    return _source_of_stream(lambda: _bag_pieces(path, topic, size, origin.us), size, header)


@contextmanager
def _opened_bag(path: Path) -> Iterator[tuple[Any, Any]]:
    """Open a bag; yield its reader and a function that decodes a message."""
    try:
        from rosbags.highlevel import AnyReader, AnyReaderError
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
        of_events = {
            topic_connection.topic
            for topic_connection in reader.connections
            if topic_connection.msgtype.endswith(_OF_EVENTS)
        }
        if not of_events:
            topics = sorted(
                f"{topic_connection.topic} ({topic_connection.msgtype})"
                for topic_connection in reader.connections
            )
            raise NotARecording(
                f"This bag has no topic of events; its topics: {', '.join(topics[:_MOST_NAMED]) or 'none'}.",
                remedy="Give a bag with messages EventArray or EventPacket.",
            )
        topic = choices.chosen(of_events)
        for connection, _, raw in reader.messages(
            [topic_connection for topic_connection in reader.connections if topic_connection.topic == topic]
        ):
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
        used = [
            topic_connection for topic_connection in reader.connections if topic_connection.topic == topic
        ]
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


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]), ReadingChoices.from_json(json.loads(sys.argv[3])))
