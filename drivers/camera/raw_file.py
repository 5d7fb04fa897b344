"""A RAW recording on disk: reads its header and streams its events, with bounded memory; never writes.

A file that ends in the middle of a word is read up to its last whole word, and its scan says so. Malformed
words end in ``RecordingCorrupt`` with their byte offset in the file.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.camera.evt3 import (
    Events,
    Evt3Decoder,
    StreamStatistics,
    Triggers,
    Words,
    empty_events,
    join_triggers,
)
from drivers.camera.evt3_kernel import most_events
from drivers.camera.evt3_vectors import MARGIN
from drivers.camera.raw_header import MAX_HEADER_BYTES, RawHeader, parse_header
from drivers.errors import NotARecording, RecordingFileError


@dataclass(frozen=True)
class RecordingStatistics(StreamStatistics):
    """What one pass over a file told: its stream's counts, first and last time, rate controller and gaps.

    Attributes
    ----------
    bytes
        Length of the file, header included.
    truncated
        The file ends in the middle of a word: it was cut off while being written or copied.
    """

    bytes: int
    truncated: bool


@dataclass(frozen=True)
class RawFile:
    r"""A RAW file of EVT3 words.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> words = np.array([0x8001, 0x6002, 0x0005, 0x2803], "<u2")
    >>> with TemporaryDirectory() as folder:
    ...     path = Path(folder) / "one_event.raw"
    ...     _ = path.write_bytes(b"% format EVT3;height=720;width=1280\n% end\n" + words.tobytes())
    ...     recording = RawFile.open(path)
    ...     events, triggers = recording.read()
    >>> recording.width, len(events.t), len(triggers.t)
    (1280, 1, 0)
    """

    path: Path
    raw_header: RawHeader

    @classmethod
    def open(cls, path: Path | str) -> RawFile:
        """Read the header of a file; no handle stays open.

        Raises
        ------
        NotARecording
            When it is no RAW file of EVT3.
        RecordingFileError
            When it cannot be read.
        """
        path = Path(path)
        if path.is_dir():
            raise NotARecording("This is a folder.", where=str(path), remedy="Give the RAW file in it.")
        try:
            with path.open("rb") as file:
                start = file.read(MAX_HEADER_BYTES)
        except OSError as error:
            raise _unreadable(path, error) from error
        return cls(path, parse_header(start, where=str(path)))

    @property
    def header(self) -> Mapping[str, str]:
        """The header's keys and texts."""
        return self.raw_header.fields

    @property
    def width(self) -> int:
        """Columns of the sensor."""
        return self.raw_header.width

    @property
    def truncated(self) -> bool:
        """Whether the file ends in the middle of a word, as one that was cut off does half of the time."""
        return (self._size() - self.raw_header.size_bytes) % 2 == 1

    @property
    def height(self) -> int:
        """Rows of the sensor."""
        return self.raw_header.height

    @property
    def serial(self) -> str:
        """Serial number of the camera; empty when the header has none."""
        return self.raw_header.fields.get("serial_number", "")

    def words(self, *, at_once: int = 1 << 19) -> Iterator[Words]:
        """Return the words as they stand in the file, some at a time; an odd byte at its end is left out.

        Raises RecordingFileError when the file cannot be read on.
        """
        try:
            with self.path.open("rb") as file:
                file.seek(self.raw_header.size_bytes)
                while block := file.read(2 * at_once):
                    yield np.frombuffer(block, "<u2", count=len(block) // 2)
        except OSError as error:
            raise _unreadable(self.path, error) from error

    def pieces(self, *, max_events: int = 1_000_000) -> Iterator[tuple[Events, Triggers]]:
        """Events and triggers as sent, in pieces of at most ``max_events`` events.

        Raises
        ------
        RecordingCorrupt
            At a malformed word, after the pieces before it.
        RecordingFileError
            When the file cannot be read on.
        """
        decoder = self._decoder()
        for words in self.words():
            yield from decoder.decode(words, max_events=max_events)

    def chunks(self, *, max_events: int = 1_000_000) -> Iterator[Events]:
        """Events as sent, in pieces of at most ``max_events``. Raises as ``pieces``."""
        for events, _ in self.pieces(max_events=max_events):
            if len(events.t):
                yield events

    def read(self) -> tuple[Events, Triggers]:
        """All events and triggers: 13 bytes of memory an event. Raises as ``pieces``."""
        events = empty_events(sum(most_events(words) for words in self.words()) + MARGIN)
        decoder = self._decoder()
        triggers = []
        done = 0
        for words in self.words():
            done, edges = decoder.decode_into(words, events, done)
            triggers.append(edges)
        return events.part(0, done), join_triggers(triggers)

    def triggers(self) -> Triggers:
        """All trigger edges. Raises as ``pieces``."""
        decoder = self._decoder()
        return join_triggers([decoder.tally(words) for words in self.words()])

    def counts(self) -> NDArray[np.uint16]:
        """Events of each pixel: (2, height, width), OFF then ON; counts wrap above 65535.

        Decoding and counting are one loop: no list of events is made. Raises as ``pieces``.
        """
        image = np.zeros((2, self.height, self.width), np.uint16)
        decoder = self._decoder()
        for words in self.words():
            decoder.count(words, image)
        return image

    def scan(self) -> RecordingStatistics:
        """Read all words once and sum up what they tell. Raises as ``pieces``."""
        decoder = self._decoder()
        for words in self.words():
            decoder.tally(words)
        return RecordingStatistics(**vars(decoder.statistics()), bytes=self._size(), truncated=self.truncated)

    def _size(self) -> int:
        try:
            return self.path.stat().st_size
        except OSError as error:
            raise _unreadable(self.path, error) from error

    def _decoder(self) -> Evt3Decoder:
        first_byte = self.raw_header.size_bytes
        return Evt3Decoder(self.width, self.height, first_byte=first_byte, where=str(self.path))


def _unreadable(path: Path, error: OSError) -> RecordingFileError:
    """Say why a file cannot be read."""
    if isinstance(error, FileNotFoundError):
        return RecordingFileError("There is no such file.", where=str(path), remedy="Check the path.")
    if isinstance(error, PermissionError):
        return RecordingFileError(
            "It may not be read by this user.", where=str(path), remedy="Give yourself read permission on it."
        )
    return RecordingFileError(
        f"It cannot be read ({error.strerror or error}).",
        where=str(path),
        remedy="Check the disk it lies on, or copy it again.",
    )
