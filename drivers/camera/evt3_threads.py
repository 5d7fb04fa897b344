"""Decode a stream in several threads into common arrays, with exactly the result of one thread.

Each thread reads its own words, so they stay in the caches of its processor. One after the other the threads take a
block and room for its events; then all decode at the same time. The place at which a block begins is guessed from the
words before it, so that no block waits for another. In the end it is compared with the place that the block before it
has reached. If they differ, which only a damaged stream brings about, the block is decoded again. This pays where all
events go into the same arrays. It does not pay for events in small pieces: one thread keeps these in its caches.
"""

from __future__ import annotations

import os
import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from drivers.camera.event_arrays import Events, Triggers
from drivers.camera.evt3 import Evt3Decoder
from drivers.camera.evt3_kernel import max_event_count
from drivers.camera.evt3_place import Place, guess_place
from drivers.camera.growing_events import GrowingEvents
from drivers.errors import RecordingCorrupt

MOST_THREADS: Final = 4
"""More do not help: the threads take their blocks one after the other."""
LEAST_BYTES: Final = 1 << 22
"""Smallest file for which several threads pay."""
LEAST_BLOCK_WORDS: Final = 1 << 17
MOST_BLOCK_WORDS: Final = 1 << 21
"""Lengths of blocks. Between them, a block is a thread's share of the words that are left: so all threads end together.

A block costs as much as some 50,000 words besides: threads wait for each other to take it.
"""

Words = NDArray[np.uint16]
Read = Callable[[Words, int], int]
"""Reads words from a byte of the file on into an array; returns their number, 0 at the end. One call at a time."""


@dataclass(slots=True)
class _Block:
    """A block in work: its first byte and length in words, room for its events, and where it begins.

    ``found`` are number of events and triggers; None until the block is decoded, and if it is malformed.
    """

    first_byte: int
    length: int
    room: Events
    began: Place
    decoder: Evt3Decoder
    found: tuple[int, Triggers] | None = None
    is_done: bool = False

    def decode(self, words: Words) -> None:
        """Decode the block's words."""
        try:
            self.found = self.decoder.decode_into(words, self.room, 0)
        except RecordingCorrupt:  # it is decoded again when its place is known, and told then
            self.found = None
        self.is_done = True


def threads_for(size_bytes: int) -> int:
    """Return in how many threads a file is decoded.

    Returns: 1 for a small file; else the number of processors that this process may use, 4 at most.
    """
    if size_bytes < LEAST_BYTES:
        return 1
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(usable, MOST_THREADS)


def decode_in_threads(
    decoder: Evt3Decoder, read: Read, events: GrowingEvents, threads: int, total_words: int
) -> list[Triggers]:
    """Decode a stream in several threads.

    Returns: The triggers, in the order of the stream.
    Raises OSError: If ``read`` raises it.
    """
    work = _Work(decoder, read, events, threads, total_words)
    with ThreadPoolExecutor(max(threads - 1, 1), thread_name_prefix="evt3") as pool:
        others = [pool.submit(work.decode_blocks) for _ in range(threads - 1)]
        work.decode_blocks()
    for other in others:
        other.result()
    return work.finished()


class _Work:
    """The blocks of a stream, which threads take one after the other."""

    def __init__(
        self, decoder: Evt3Decoder, read: Read, events: GrowingEvents, threads: int, total_words: int
    ) -> None:
        self._decoder = decoder
        self._read = read
        self._events = events
        self._threads = threads
        self._left = total_words
        self._taking = threading.Lock()
        self._stopped = False
        self._waiting: deque[_Block] = deque()
        self._triggers: list[Triggers] = []
        self._next_byte, self._next_place = decoder.next_byte, decoder.place
        self._at = self._next_place

    def decode_blocks(self) -> None:
        """Take and decode blocks until there is none left."""
        words = np.empty(MOST_BLOCK_WORDS, np.uint16)
        try:
            while (block := self._take(words)) is not None:
                if not block.is_done:
                    block.decode(words[: block.length])
        except BaseException:
            self._stopped = True
            raise

    def finished(self) -> list[Triggers]:
        """Return the triggers; no thread is at work."""
        self._finish_first()
        return self._triggers

    def _take(self, words: Words) -> _Block | None:
        """Read the next block into ``words``; None if the stream ends, or a thread has failed."""
        with self._taking:
            self._finish_first()
            most = min(max(self._left // self._threads, LEAST_BLOCK_WORDS), MOST_BLOCK_WORDS)
            length = 0 if self._stopped else self._read(words[:most], self._next_byte)
            if not length:
                return None
            words = words[:length]
            began, first_byte = self._next_place, self._next_byte
            room = self._events.room(max_event_count(words))
            block = _Block(first_byte, length, room, began, self._decoder.at(began, first_byte))
            self._waiting.append(block)
            place = guess_place(words, began)
            if place is None:  # the words do not tell it, so no other thread may go on
                block.decode(words)
                place = block.decoder.place
            self._left -= length
            self._next_byte, self._next_place = first_byte + 2 * length, place
            return block

    def _finish_first(self) -> None:
        """Add the first blocks to the arrays, as far as they are decoded."""
        while self._waiting and self._waiting[0].is_done:
            self._finish(self._waiting.popleft())

    def _finish(self, block: _Block) -> None:
        """Add the events of a block, decoded again unless it began at the right place and ended well."""
        if block.found is not None and block.began == self._at:
            count, edges = block.found
            self._events.add(block.room.part(0, count))
            self._triggers.append(edges)
            self._at = block.decoder.place
            return
        words = np.empty(block.length, np.uint16)
        words = words[: self._read(words, block.first_byte)]
        again = self._decoder.at(self._at, block.first_byte)
        for part, edges in again.decode(words):
            self._events.add(part)
            self._triggers.append(edges)
        self._at = again.place
