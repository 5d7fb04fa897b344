"""Notifies a waiting host at intervals while the camera computes an answer.

A real sensor delivers on time. A simulated one may first compile its pixel model, or share a busy computer. This
module uses threads and time only; it depends neither on frames nor on sockets.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final

INTERVAL_S: Final = 0.5
"""Interval between notifications, s; also the delay before the first one. The protocol promises at most 1 s."""


class KeepAlive:
    """Watches computations of any number of threads.

    notify: Called by a separate thread every ``INTERVAL_S`` while one computation lasts.
    """

    def __init__(self, notify: Callable[[], None]) -> None:
        self._notify = notify
        self._started_s: dict[int, float] = {}
        self._lock = threading.Lock()
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="keep-alive", daemon=True)

    def start(self) -> None:
        """Start to watch."""
        self._thread.start()

    def close(self) -> None:
        """Stop the notifications; return after the thread has ended."""
        self._closing.set()
        if self._thread.is_alive():
            self._thread.join()

    @contextmanager
    def computing(self) -> Iterator[None]:
        """Mark the ``with`` block as one computation of this thread.

        Yields: Nothing; the computation ends with the block.
        """
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
