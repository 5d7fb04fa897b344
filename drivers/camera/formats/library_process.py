"""Read files of other programs through their libraries, in a process of its own with a limit of memory and of time.

A packet of some kilobytes can unpack to gigabytes, and a damaged file can crash or hang a library. Here it ends the
other process only, and the file is refused with one message. The libraries are ``aedat``, ``rosbags``, NumPy and HDF5.

The process writes messages: the lengths of a text and of the arrays, the text (JSON), the arrays. Nothing of it is
executed here.
"""

from __future__ import annotations

import json
import os
import select
import struct
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Final

import numpy as np

from drivers.camera.event_arrays import (
    Events,
    EventSource,
    Piece,
    ReadingChoices,
    Triggers,
    UnstatedUnit,
    empty_events,
    empty_triggers,
)
from drivers.errors import CameraSoftwareMissing, NotARecording, RecordingCorrupt

MOST_BYTES: Final = 2 << 30
"""Most memory of the process, with its libraries."""
PATIENCE_S: Final = 60.0
"""Longest time without a message, and a second more for each megabyte of the file."""
MOST_EVENTS: Final = 1 << 20
"""Most events and edges of a message."""
_PROGRAM: Final = "drivers.camera.formats.library_reader"
HEAD: Final = struct.Struct("<III")
_MOST_TEXT: Final = 1 << 20  # Facts of a file are some hundred bytes
NO_EVENTS: Final = "The file holds no readable events"
_OUT_OF_MEMORY: Final = (
    f"{NO_EVENTS}: reading it needs more than {MOST_BYTES >> 30} GiB of memory, or crashes its library"
)
_DAMAGED: Final = (
    "The file is probably damaged: copy it again from its origin, or export it again in smaller parts."
)


@contextmanager
def source_of_library(path: Path, kind: str, choices: ReadingChoices) -> Iterator[EventSource]:
    """Open a file of a kind (`library_reader`) in a process of its own, until the end of the block.

    Its events can be read once. Raises `NotARecording` if it cannot be read, or needs too much memory or time.
    """
    process = subprocess.Popen(
        [sys.executable, "-P", "-m", _PROGRAM, kind, str(path), json.dumps(choices.as_json())],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        bufsize=0,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "OPENBLAS_NUM_THREADS": "1"},
    )
    try:
        assert process.stdout is not None
        yield _source(process.stdout, path)
    finally:
        process.kill()
        process.communicate()


@dataclass(frozen=True)
class LibraryFormat:
    """A format of events, as an entry point of ``starbench.event_files`` gives it."""

    reader: str
    """Function that opens a file of it, in a process of its own: ``module:function`` of a path and `ReadingChoices`."""
    recognises: Callable[[Path, bytes], bool]
    """Whether a path with these first bytes (none of a folder) is of this format."""

    def open_events(self, path: Path, choices: ReadingChoices) -> AbstractContextManager[EventSource]:
        """Open a file of this format until the end of the block."""
        return source_of_library(path, self.reader, choices)


def _source(stream: IO[bytes], path: Path) -> EventSource:
    text: Mapping[str, Any] = {}
    while "width" not in text:
        text, _, _ = _message(stream, path)
    header = {str(key): str(value) for key, value in text["header"].items()}

    def pieces() -> Iterator[Piece]:
        while True:
            text, events, triggers = _message(stream, path)
            if text.get("end"):
                return
            yield events, triggers

    size = int(text["width"]), int(text["height"])
    count = None if text["count"] is None else int(text["count"])
    assumed = {str(key): str(value) for key, value in text["assumed"].items()}
    unit = None if text["unit"] is None else UnstatedUnit(*text["unit"])
    return EventSource(*size, header, pieces, bool(text["truncated"]), count, assumed=assumed, unit=unit)


def _message(stream: IO[bytes], path: Path) -> tuple[Mapping[str, Any], Events, Triggers]:
    """Read the next message. Raises what it says of the file."""
    bytes_of_file = (
        path.stat().st_size if path.is_file() else sum(file.stat().st_size for file in path.glob("*"))
    )
    allowed_s = PATIENCE_S + 1e-6 * bytes_of_file
    length, n, edges = HEAD.unpack(_exactly(stream, HEAD.size, allowed_s))
    if length > _MOST_TEXT or max(n, edges) > MOST_EVENTS:
        raise NotARecording(_OUT_OF_MEMORY, remedy=_DAMAGED)
    text = json.loads(_exactly(stream, length, allowed_s))
    events, triggers = empty_events(n), empty_triggers(edges)
    for array in (*events, *triggers):
        array[:] = np.frombuffer(_exactly(stream, array.nbytes, allowed_s), array.dtype)
    _raise_told(text, path)
    return text, events, triggers


def _raise_told(text: Mapping[str, Any], path: Path) -> None:
    """Raise the error that a message reports, if any."""
    what, remedy = str(text.get("error", "")), str(text.get("remedy", ""))
    match text.get("kind"):
        case "missing":
            raise CameraSoftwareMissing(what, where=str(path), remedy=remedy)
        case "corrupt":
            raise RecordingCorrupt(what, offset=int(text["offset"]), where=str(path), remedy=remedy)
        case "other":
            raise NotARecording(what, remedy=remedy)
        case "memory":
            raise NotARecording(_OUT_OF_MEMORY, remedy=_DAMAGED)
        case "unreadable":
            raise NotARecording(f"{NO_EVENTS}: its library cannot read it.", remedy=_DAMAGED)


def _exactly(stream: IO[bytes], size: int, allowed_s: float) -> bytes:
    """Read so many bytes, each piece of them in the time allowed."""
    data = bytearray()
    while len(data) < size:
        if not select.select([stream], [], [], allowed_s)[0]:
            what = f"{NO_EVENTS}: reading it takes longer than {allowed_s:.0f} s."
            raise NotARecording(what, remedy=_DAMAGED)
        part = stream.read(min(size - len(data), 1 << 20))
        if not part:
            raise NotARecording(_OUT_OF_MEMORY, remedy=_DAMAGED)
        data += part
    return bytes(data)
