"""Faults of the camera's stream: which frames arrive, and how they are changed."""

import numpy as np
import pytest

from simulators.cameras.streaming import StreamFault, StreamFaults

FRAME = np.array([0x8123, 0x6001, 0x0010, 0x2005, 0x8005, 0x6002], "<u2")


def carried(*faults: StreamFault, frames: int = 1) -> list[list[int]]:
    stream = StreamFaults()
    for fault in faults:
        stream.inject(fault)
    return [np.frombuffer(stream.apply(FRAME.tobytes()), "<u2").tolist() for _ in range(frames)]


WHOLE = FRAME.tolist()


@pytest.mark.parametrize(
    ("fault", "arrives"),
    [
        (StreamFault("frames_lost"), []),
        (StreamFault("frame_cut"), WHOLE[:3]),
        (StreamFault("frame_doubled"), WHOLE + WHOLE),
        (StreamFault("frame_garbled"), [*WHOLE[:3], 0x9000, *WHOLE[4:]]),
        (StreamFault("clock_back"), [0x8119, 0x6001, 0x0010, 0x2005, 0x8FFB, 0x6002]),
    ],
)
def test_a_fault_changes_a_frame_as_ordered(fault, arrives):
    assert carried(fault) == [arrives]


@pytest.mark.parametrize("kind", ["clock_back", "silence"])
def test_a_jump_of_the_clock_and_silence_last(kind):
    first, *later = carried(StreamFault(kind), frames=5)
    assert first != WHOLE
    assert later == [first] * 4
