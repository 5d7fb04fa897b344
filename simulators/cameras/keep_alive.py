"""Tells a host that waits, as long as what it waits for is being computed: once in a while, and only then.

A sensor delivers on time; a computed one may have its pixels compiled first, or share a busy machine. Knows threads and
time, neither frames nor sockets.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final

INTERVAL_S: Final = 0.5
"""So long a piece of computing lasts before it is told of, and again each time; the protocol promises a second."""


class KeepAlive:
    """Watches pieces of computing, of any threads.

    Parameters
    ----------
    notify
        Called by a thread of its own, every ``INTERVAL_S`` for as long as a single piece lasts.
    """

    def __init__(self, notify: Callable[[], None]) -> None:
        self._notify = notify
        self._started_s: dict[int, float] = {}
        self._lock = threading.Lock()
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="keep-alive", daemon=True)

    def start(self) -> None:
        """Begin to watch."""
        self._thread.start()

    def close(self) -> None:
        """Tell nothing more; returns when the thread has ended."""
        self._closing.set()
        if self._thread.is_alive():
            self._thread.join()

    @contextmanager
    def computing(self) -> Iterator[None]:
        """Mark what this thread does inside as one piece of computing."""
        thread = threading.get_ident()
        with self._lock:
            self._started_s[thread] = time.monotonic()
        try:
            yield
        finally:
            with self._lock:
                del self._started_s[thread]

    def _watch(self) -> None:
        while not self._closing.wait(INTERVAL_S):
            with self._lock:
                started_s = min(self._started_s.values(), default=None)
            if started_s is not None and time.monotonic() - started_s >= INTERVAL_S:
                self._notify()
