"""Faults of the camera's stream: overflow; lost, cut, doubled or garbled frames; a clock that jumps back.

A frame holds EVT3 words of 2 ms. This module depends neither on the sensor nor on the socket. It is thread-safe:
one thread injects faults while another one streams. Word types (EVT_TIME_HIGH is 0x8, 0x9 is unused) are those of
Prophesee's EVT 3.0 format.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from simulators.errors import SimulatorError

#: Faults of frames, by name.
STREAM_FAULTS: Final = {
    "frames_lost": "frames never arrive",
    "frame_cut": "the second half of a frame never arrives",
    "frame_doubled": "a frame arrives twice",
    "frame_garbled": "a word in the middle of a frame has an unknown type",
    "clock_back": "the sensor's clock jumps back and continues from there",
    "silence": "nothing more arrives, without any message",
}

_TIME_HIGH: Final = 0x8
_UNKNOWN_WORD: Final = 0x9000

#: Jump of the clock, in units of its high word (4096 us).
_JUMP: Final = 10


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
        """Add a fault for frames to come.

        Raises SimulatorError: If the kind of the fault is unknown.
        """
        if fault.kind not in STREAM_FAULTS:
            raise SimulatorError(
                f"Unknown stream fault {fault.kind!r}.", remedy=f"Use one of: {', '.join(STREAM_FAULTS)}."
            )
        with self._lock:
            self._faults.append(fault)

    def clear(self) -> None:
        """Remove all faults."""
        self.overflows = False
        with self._lock:
            self._faults.clear()

    def apply(self, frame: bytes) -> bytes:
        """Apply the faults that are due to the next frame.

        frame: EVT3 words, 16 bit, little endian.
        Returns: What the host receives; empty if nothing arrives.
        """
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
