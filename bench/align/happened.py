"""What happened in a session, as the pages list it: what was switched, moved and written, and by whom.

The module holds sentences only. What is done several times in a row, such as small steps of an axis, is one entry.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any, Final

KEPT: Final = 50
SHOWN: Final = 20
_SAME_S: Final = 10.0
"""Time within which a further step replaces the entry of the one before, s."""


class Happened:
    """The list of what happened.

    on_change: Called after each change, by any thread.
    clock: Returns the time, s since 1970.
    """

    def __init__(self, on_change: Callable[[], None], clock: Callable[[], float] = time.time) -> None:
        self._on_change = on_change
        self._clock = clock
        self._lock = threading.Lock()
        self._entries: deque[dict[str, Any]] = deque(maxlen=KEPT)
        self._topic = ""
        self._count = 0

    def say(self, text: str, topic: str = "") -> None:
        """Add a sentence.

        topic: What it is about and who did it. If the entry before has the same topic and is some seconds old
          at most, this one takes its place. Empty for an entry of its own.
        """
        now_s = self._clock()
        with self._lock:
            last = self._entries[-1] if self._entries else None
            if last is not None and topic and topic == self._topic and now_s - last["time_s"] < _SAME_S:
                self._entries.pop()
            self._topic = topic
            self._count += 1
            self._entries.append({"number": self._count, "time_s": now_s, "text": text})
        self._on_change()

    def as_data(self) -> list[dict[str, Any]]:
        """Return the newest entries.

        Returns: Number, time (s since 1970) and text of each, the newest last.
        """
        with self._lock:
            return list(self._entries)[-SHOWN:]
