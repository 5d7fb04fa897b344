"""Faults of the camera's stream: too many events; frames lost, cut, doubled or garbled; a clock that jumps.

Knows frames of EVT3 words and which words carry the clock; neither sensor nor socket. Thread-safe: faults are
ordered by one thread while another streams.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from simulators.errors import SimulatorError

#: What can befall a frame, by name.
STREAM_FAULTS: Final = {
    "frames_lost": "frames never arrive",
    "frame_cut": "the second half of a frame never arrives",
    "frame_doubled": "a frame arrives twice",
    "frame_garbled": "a word in the middle of a frame is of no known type",
    "clock_back": "the sensor's clock jumps back, and goes on from there",
    "silence": "nothing more arrives, and nobody says why",
}

_TIME_HIGH: Final = 0x8
_UNKNOWN_WORD: Final = 0x9000

#: How far the clock jumps, in units of its high word (4096 us).
_JUMP: Final = 10


@dataclass(frozen=True)
class StreamFault:
    """What is to befall frames of 2 ms to come.

    Attributes
    ----------
    kind
        One of `STREAM_FAULTS`.
    skip
        Frames to let pass before.
    count
        How many it befalls; ``clock_back`` and ``silence`` last, whatever it says.
    """

    kind: str
    skip: int = 0
    count: int = 1


class StreamFaults:
    """The way that frames take to the host; a good one until something is ordered."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._faults: list[StreamFault] = []
        self.overflows = False
        """Whether the sensor's rate controller drops events from the next start on, whatever its setting says."""

    def inject(self, fault: StreamFault) -> None:
        """Let something go wrong with frames to come.

        Raises
        ------
        SimulatorError
            When there is no such fault.
        """
        if fault.kind not in STREAM_FAULTS:
            raise SimulatorError(
                f"No stream fault {fault.kind!r}.", remedy=f"Known are: {', '.join(STREAM_FAULTS)}."
            )
        with self._lock:
            self._faults.append(fault)

    def clear(self) -> None:
        """Let nothing more go wrong."""
        self.overflows = False
        with self._lock:
            self._faults.clear()

    def apply(self, frame: bytes) -> bytes:
        """Give what arrives of a frame; empty for nothing."""
        with self._lock:
            due = self._due()
        for fault in due:
            frame = _spoilt(fault, frame)
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


def _spoilt(fault: StreamFault, frame: bytes) -> bytes:
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
