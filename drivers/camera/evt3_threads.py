"""Decode the blocks of a stream in several threads, with exactly the result of one thread.

The place at which a block begins is guessed from the words before it, so that no block waits for another. In the end
it is compared with the place that the block before it has reached. If they differ, which only a damaged stream brings
about, the block is decoded again. The thread that reads the file decodes, too, while the others have enough to do: so
there are no more threads at work than processors. This pays where all events go into the same arrays. It does not pay
for events in small pieces: one thread keeps these in its caches. Memory is bounded: the number of blocks in work is
limited.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Generator, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.camera.event_arrays import Events, Triggers
from drivers.camera.evt3 import Evt3Decoder
from drivers.camera.evt3_place import Place, guess_place
from drivers.errors import RecordingCorrupt

MOST_THREADS: Final = 4
"""More do not help: one thread reads the words of all others."""
LEAST_BYTES: Final = 1 << 22
"""Smallest file for which several threads pay."""
BLOCK_WORDS: Final = 1 << 19
"""Largest number of words of a block: to hand a block to a thread costs as much as some 50,000 words."""

_QUEUED: Final = 2
"""Number of blocks that wait for each further thread; the thread that reads decodes the others."""
_AHEAD: Final = 4
"""Number of blocks in work beyond those that wait."""

Words = NDArray[np.uint16]


class _Block(NamedTuple):
    """A block in work: its decoder, the place and the byte at which that began, and what it returns."""

    words: Words
    room: Events
    began: Place
    first_byte: int
    decoder: Evt3Decoder
    result: Future[tuple[int, Triggers]]


def threads_for(size_bytes: int) -> int:
    """Return in how many threads a file is decoded.

    Parameters
    ----------
    size_bytes
        Length of the file.

    Returns
    -------
    int
        1 for a small file; else the number of processors that this process may use, 4 at most.
    """
    if size_bytes < LEAST_BYTES:
        return 1
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(usable, MOST_THREADS)


def decode_blocks(
    decoder: Evt3Decoder, blocks: Iterable[tuple[Words, Events]], threads: int
) -> Iterator[tuple[Events, Triggers]]:
    """Decode blocks in several threads.

    Parameters
    ----------
    decoder
        Decoder at the beginning of the first block.
    blocks
        The words of the stream, (N,) uint16 each, and arrays that have room for their events.
    threads
        Number of threads, that of the caller included.

    Yields
    ------
    tuple of Events and Triggers
        The next events, and the triggers among them: a block's, in its arrays, unless it had to be decoded again.

    Raises
    ------
    RecordingCorrupt
        At a malformed word, after the events before it.
    """
    at, first_byte = decoder.place, decoder.next_byte
    place: Place | None = at
    waiting: deque[_Block] = deque()
    queued = (threads - 1) * _QUEUED
    with ThreadPoolExecutor(max(threads - 1, 1), thread_name_prefix="evt3") as pool:
        try:
            for words, room in blocks:
                while waiting and (place is None or len(waiting) >= queued + _AHEAD):
                    at = yield from _finish(decoder, waiting.popleft(), at)
                began = at if place is None else place
                fork = decoder.at(began, first_byte)
                busy = sum(not block.result.done() for block in waiting) >= queued
                result: Future[tuple[int, Triggers]] = (
                    Future() if busy else pool.submit(fork.decode_into, words, room, 0)
                )
                waiting.append(_Block(words, room, began, first_byte, fork, result))
                first_byte += 2 * len(words)
                place = guess_place(words, began)
                if busy:
                    _decode_here(waiting[-1])
            while waiting:
                at = yield from _finish(decoder, waiting.popleft(), at)
        finally:
            for block in waiting:
                block.result.cancel()


def _decode_here(block: _Block) -> None:
    """Decode a block in this thread."""
    try:
        block.result.set_result(block.decoder.decode_into(block.words, block.room, 0))
    except RecordingCorrupt as error:
        block.result.set_exception(error)


def _finish(
    decoder: Evt3Decoder, block: _Block, at: Place
) -> Generator[tuple[Events, Triggers], None, Place]:
    """Yield the events of a block, decoded again unless it began at ``at`` and ended well; return the place then."""
    damaged = isinstance(block.result.exception(), RecordingCorrupt)  # told below, after the events before it
    if not damaged:
        n, edges = block.result.result()
        if block.began == at:
            yield block.room.part(0, n), edges
            return block.decoder.place
    again = decoder.at(at, block.first_byte)
    yield from again.decode(block.words)
    return again.place
