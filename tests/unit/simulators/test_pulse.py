"""The time that the simulated bench could use, as another process reads it."""

import struct
import time

from simulators.bench import Pulse


def test_the_pulse_runs_and_never_faster_than_the_clock(tmp_path):
    path = tmp_path / "pulse"
    began_s = time.monotonic()
    pulse = Pulse(path)
    deadline_s = began_s + 10.0
    while struct.unpack("<d", path.read_bytes())[0] < 0.05 and time.monotonic() < deadline_s:
        time.sleep(0.01)
    lived_s = struct.unpack("<d", path.read_bytes())[0]
    assert 0.05 <= lived_s <= time.monotonic() - began_s
    pulse.close()
