"""What a simulated camera needs beside the sensor: its port, faults of its frames, signs of life, the sensor's clock.

A frame holds EVT3 words of 2 ms. Word types (EVT_TIME_HIGH is 0x8, 0x9 is unused) are those of Prophesee's EVT 3.0
format. Nothing here depends on the sensor.
"""

from __future__ import annotations

import select
import socket
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

POLL_S: Final = 0.1
"""Interval at which waiting threads check whether they must end, s."""
#: Faults of frames, by name.
STREAM_FAULTS: Final = {
    "frames_lost": "frames never arrive",
    "frame_cut": "the second half of a frame never arrives",
    "frame_doubled": "a frame arrives twice",
    "frame_garbled": "a word in the middle of a frame has an unknown type",
    "clock_back": "the sensor's clock jumps back and continues from there",
    "silence": "nothing more arrives, without any message",
}

#: Faults of the frame camera, by name.
FRAME_CAMERA_FAULTS: Final = {
    "unplug": "the camera disconnects and no longer answers",
    "silence": "no more pictures arrive, without any message",
    "frozen": "the last picture arrives again and again",
    "mend": "clears the fault",
}

_TIME_HIGH: Final = 0x8  # Type of the EVT3 word
_UNKNOWN_WORD: Final = 0x9000  # A type that EVT3 does not have

#: Jump of the clock, in units of its high word (4096 us): far more than the 64 us by which a busy sensor may step back.
_JUMP: Final = 10

INTERVAL_S: Final = 0.5
"""Interval between notifications, s; also the delay before the first one. The protocol promises at most 1 s."""


class CameraServer(ABC):
    """A camera on a TCP port of this computer, to which hosts connect one after the other."""

    def __init__(self, name: str) -> None:
        self._closing = threading.Event()
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._thread = threading.Thread(target=self._listen, name=name, daemon=True)

    @property
    def address(self) -> str:
        """Address on which the camera listens, ``host:port``."""
        host, port = self._listener.getsockname()[:2]
        return f"{host}:{port}"

    def start(self) -> None:
        """Start to accept hosts."""
        self._thread.start()

    def close(self) -> None:
        """Close the connection and stop listening; return after all threads have ended."""
        self._closing.set()
        if self._thread.is_alive():
            self._thread.join()
        self._listener.close()

    @abstractmethod
    def _meet(self, link: socket.socket) -> None:
        """Serve a host that has connected."""

    def _listen(self) -> None:
        """Accept hosts until the camera is closed."""
        while not self._closing.is_set():
            if select.select([self._listener], [], [], POLL_S)[0]:
                self._meet(self._listener.accept()[0])


@dataclass(frozen=True)
class StreamFault:
    """A fault of frames to come; a frame covers 2 ms."""

    kind: str  # One of `STREAM_FAULTS`
    skip: int = 0  # Number of frames that pass unchanged first
    # Number of frames to spoil; ``clock_back`` and ``silence`` last until cleared, whatever the count.
    count: int = 1


class StreamFaults:
    """Applies injected faults to the frames on their way to the host."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._faults: list[StreamFault] = []
        self.overflows = False
        """Whether the sensor's event rate controller drops events from the next start on, whatever its setting."""

    def inject(self, fault: StreamFault) -> None:
        """Add a fault for frames to come."""
        with self._lock:
            self._faults.append(fault)

    def clear(self) -> None:
        """Remove all faults."""
        self.overflows = False
        with self._lock:
            self._faults.clear()

    def apply(self, frame: bytes) -> bytes:
        """Apply the faults that are due to the next frame; empty if nothing arrives at the host."""
        with self._lock:
            due = self._due()
        for fault in due:
            frame = _changed(fault, frame)
        return frame

    def _due(self) -> list[StreamFault]:
        due: list[StreamFault] = []
        left: list[StreamFault] = []
        for fault in self._faults:
            if fault.skip > 0:
                left.append(replace(fault, skip=fault.skip - 1))
                continue
            due.append(fault)
            if fault.kind in {"clock_back", "silence"}:
                left.append(fault)
            elif fault.count > 1:
                left.append(replace(fault, count=fault.count - 1))
        self._faults = left
        return due


def _changed(fault: StreamFault, frame: bytes) -> bytes:
    if fault.kind in {"frames_lost", "silence"}:
        return b""
    if fault.kind == "frame_doubled":
        return frame + frame
    words = np.frombuffer(frame, "<u2").copy()
    if fault.kind == "frame_cut":
        return words[: len(words) // 2].tobytes()
    if fault.kind == "frame_garbled":
        words[len(words) // 2 : len(words) // 2 + 1] = _UNKNOWN_WORD
    else:
        high = words >> 12 == _TIME_HIGH
        words[high] = _TIME_HIGH << 12 | (words[high] - _JUMP) & 0xFFF
    return words.tobytes()


class KeepAlive:
    """Watches computations of any number of threads; its own calls ``notify`` every ``INTERVAL_S`` while one lasts."""

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
        """Mark the ``with`` block as one computation of this thread."""
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


class TimeBase:
    """State of the sensor's clock.

    The host discards frames that arrive after its stop command. Their number depends on chance. The clock therefore
    stands at the end of the last frame that the host kept, so that the next stream begins at the same time in every
    equal run.

    >>> clock = TimeBase()
    >>> clock.start(0)
    >>> clock.advance(2000, sent=True), clock.advance(4000, sent=True)
    (None, None)
    >>> clock.stop(1), clock.now_us
    (True, 2000)
    """

    def __init__(self) -> None:
        self.now_us = 0
        """Sensor time, us, not wrapped."""
        self._sent_us = [0]

    def power_up(self) -> None:
        """Set the clock to 0."""
        self.start(0)

    def start(self, at_us: int) -> None:
        """Begin a stream."""
        self.now_us = at_us
        self._sent_us = [at_us]

    def advance(self, until_us: int, *, sent: bool) -> None:
        """Advance the clock to the end of a frame."""
        self.now_us = until_us
        if sent:
            self._sent_us.append(until_us)

    def stop(self, frames: int) -> bool:
        """Set the clock to the end of the last frame that the host kept; False if fewer frames were sent."""
        if frames >= len(self._sent_us):
            return False
        self.now_us = self._sent_us[frames]
        return True
