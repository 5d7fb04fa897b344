"""Read a RAW recording on disk: its header, and its events as a stream, with bounded memory. Nothing is written.

A file that ends in the middle of a word is read up to its last whole word, and ``truncated`` is then True. Malformed
words raise ``RecordingCorrupt`` with their byte offset in the file.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from drivers.camera.event_arrays import Events, Triggers, empty_events, join_triggers
from drivers.camera.evt3 import PIECE_EVENTS, Evt3Decoder, StreamStatistics, Words
from drivers.camera.evt3_kernel import MARGIN, max_event_count
from drivers.camera.raw_check import read_start, require_whole
from drivers.camera.raw_header import RawHeader, parse_header
from drivers.camera.raw_writer import reason
from drivers.errors import NotARecording, RecordingFileError

_READ_ONCE_BYTES: Final = 1 << 24
"""Size of a file up to which its words stay in memory between their count and their decoding; a larger one would fill
it."""

_STEP_WORDS: Final = 1 << 16
"""Steps of what is used of a long recording: with others, its view would have other events."""


@dataclass(frozen=True)
class RecordingStatistics(StreamStatistics):
    """Statistics of a file from one pass over it."""

    bytes: int
    # Whether the file ends in the middle of a word: it was cut off while it was written or copied.
    truncated: bool


@dataclass(frozen=True)
class RawFile:
    r"""A RAW file of EVT3 words.

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
    def open(cls, path: Path | str, sensor_size: tuple[int, int] | None = None) -> RawFile:
        """Read the header of a file; ``sensor_size``, px, is for one that does not state it. It does not stay open.

        Raises `NotARecording` if it is no RAW file of EVT3, `RecordingCorrupt` if parts of it were never written.
        """
        path = Path(path)
        if path.is_dir():
            raise NotARecording(
                "This is a folder.", where=str(path), remedy="Give a RAW file in this folder."
            )
        try:
            start = read_start(path)
            require_whole(path)
        except OSError as error:
            raise unreadable(path, error) from error
        return cls(path, parse_header(start, where=str(path), sensor_size=sensor_size))

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
        """Whether the file ends in the middle of a word, as half of all files do that were cut off."""
        return (self._size() - self.raw_header.size_bytes) % 2 == 1

    @property
    def height(self) -> int:
        """Rows of the sensor."""
        return self.raw_header.height

    @property
    def serial(self) -> str:
        """Serial number of the camera; empty if the header has none."""
        return self.raw_header.fields.get("serial_number", "")

    def words(self, *, piece_words: int = 1 << 18) -> Iterator[Words]:
        """Read the words as they stand in the file, (N,) uint16 at a time. An odd byte at the end is left out.

        The words of a piece stay in the processor's caches.
        """
        try:
            with self.path.open("rb") as file:
                file.seek(self.raw_header.size_bytes)
                while block := file.read(2 * piece_words):
                    yield np.frombuffer(block, "<u2", count=len(block) // 2)
        except OSError as error:
            raise unreadable(self.path, error) from error

    def pieces(self, *, max_events: int = PIECE_EVENTS) -> Iterator[tuple[Events, Triggers]]:
        """Decode events and triggers in the order of the file, at most ``max_events`` events in a piece.

        At a malformed word, it first yields what came before, then raises `RecordingCorrupt`.
        """
        return self.decoder().decode(self.words(), max_events=max_events)

    def chunks(self, *, max_events: int = PIECE_EVENTS) -> Iterator[Events]:
        """Decode events in the order of the file, 1 to ``max_events`` in a piece; errors as ``pieces``."""
        for events, _ in self.pieces(max_events=max_events):
            if len(events.t):
                yield events

    def read(self) -> tuple[Events, Triggers]:
        """Decode all events and triggers, which takes 13 bytes of memory an event; errors as ``pieces``."""
        decoder, triggers, n = self.decoder(), [], 0
        pieces = list(self.words()) if self._size() <= _READ_ONCE_BYTES else None
        events = empty_events(MARGIN + sum(max_event_count(words) for words in pieces or self.words()))
        for words in pieces or self.words():
            n, edges = decoder.decode_into(words, events, n)
            triggers.append(edges)
        return events.part(0, n), join_triggers(triggers)

    def bytes_of(self, most_events: int) -> int:
        """Return how many bytes of the file, from its begin, hold at most so many events: all of a short one."""
        size, n = self.raw_header.size_bytes, 0
        for words in self.words(piece_words=_STEP_WORDS):
            n += max_event_count(words)
            if n > most_events:
                return size
            size += words.nbytes
        return self._size()

    def triggers(self) -> Triggers:
        """Decode all trigger edges, in the order of the file; errors as ``pieces``."""
        decoder = self.decoder()
        return join_triggers([decoder.tally(words) for words in self.words()])

    def counts(self) -> NDArray[np.uint16]:
        """Count the events of each pixel in one loop, without a list of events; errors as ``pieces``.

        The result is (2, height, width) uint16, OFF counts, then ON counts; counts wrap above 65535.
        """
        image = np.zeros((2, self.height, self.width), np.uint16)
        decoder = self.decoder()
        for words in self.words():
            decoder.count(words, image)
        return image

    def scan(self, goes_on: Callable[[], object] = lambda: None) -> RecordingStatistics:
        """Read all words once and sum up counts, times and losses; errors as ``pieces``.

        ``goes_on`` (`drivers.clock.Clock.monotonic`) is called after each piece, so that a supervisor sees a long scan
        go on.
        """
        decoder = self.decoder()
        for words in self.words():
            decoder.tally(words)
            goes_on()
        return RecordingStatistics(**vars(decoder.statistics()), bytes=self._size(), truncated=self.truncated)

    def _size(self) -> int:
        try:
            return self.path.stat().st_size
        except OSError as error:
            raise unreadable(self.path, error) from error

    def decoder(self, *, skip_unknown: bool = False) -> Evt3Decoder:
        """Return a decoder of its words, which stands before the first."""
        first_byte = self.raw_header.size_bytes
        return Evt3Decoder(
            self.width,
            self.height,
            first_byte=first_byte,
            where=str(self.path),
            skip_unknown=skip_unknown,
        )


def is_recording(path: Path) -> bool:
    """Return whether a file has the header of an EVT3 recording, with the sensor's size; False if it cannot be read."""
    try:
        RawFile.open(path)
    except RecordingFileError:
        return False
    return True


def unreadable(path: Path, error: OSError) -> RecordingFileError:
    """Build the error of a file that cannot be read."""
    if isinstance(error, FileNotFoundError):
        return RecordingFileError("There is no such file.", where=str(path), remedy="Check the path.")
    if isinstance(error, PermissionError):
        return RecordingFileError(
            "This user has no permission to read the file.",
            where=str(path),
            remedy="Give yourself read permission on the file.",
        )
    return RecordingFileError(
        f"The file cannot be read{reason(error)}.",
        where=str(path),
        remedy="Check the disk, or copy the file again.",
    )
