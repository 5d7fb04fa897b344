"""The process that measures: it answers as the meter in this process does, and ends with its owner."""

import os
import time
from pathlib import Path

import pytest

from bench.align.live_figures import LiveSetting, LiveSlice
from bench.align.meter import MeterHere, MeterProcess
from bench.base.errors import BenchError
from bench.stations.station import load_station

SETTING = LiveSetting.of_station(load_station("simulated").value)


def test_the_process_measures_survives_a_kill_and_ends(tmp_path, children):
    part = LiveSlice(tmp_path / "nothing.raw", 1.5)
    meter = MeterProcess()
    try:
        image, jpeg, figures = meter.measure(part, SETTING)
        here = MeterHere().measure(part, SETTING)
        assert (image == here.image).all()
        assert jpeg == here.jpeg
        assert figures.advice == here.figures.advice
        meter.forget()
        first = children[-1].pid
        environment = Path(f"/proc/{first}/environ")
        if environment.exists():  # on Linux
            assert b"OPENBLAS_NUM_THREADS=1" in environment.read_bytes().split(b"\0")
        os.kill(first, 9)
        with pytest.raises(BenchError, match="ended by itself"):
            meter.measure(part, SETTING)
        assert meter.measure(part, SETTING).figures.time_s == 1.5
        assert [child.pid == first for child in children] == [True, False]
    finally:
        meter.close()
    assert all(child.poll() is not None for child in children)
    began_s = time.monotonic()
    with pytest.raises(BenchError):
        meter.measure(part, SETTING)
    assert time.monotonic() - began_s < 1
