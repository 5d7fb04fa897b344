"""Drivers against simulated controllers behind a line of faults, on a virtual clock: an error, or the truth."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from drivers.errors import DriverError
from drivers.light import LightSettings
from drivers.light.scpi import ScpiLight
from drivers.stage import AxisLimits, Stage
from drivers.stage.esp import EspAxis, EspStage
from drivers.stage.grbl import GrblAxis, GrblStage
from drivers.stage.ximc import XimcAxis, XimcStage
from drivers.stage.zaber import ZaberAxis, ZaberStage
from simulators.axis_motion import Mechanics
from simulators.esp301 import EspAxisModel, EspController
from simulators.grbl import GrblController
from simulators.grbl_planner import GrblAxisModel
from simulators.line_faults import FaultLine, LineFault
from simulators.scpi_generator import GeneratorModel, ScpiGenerator
from simulators.ximc import XimcController, XimcModel
from simulators.zaber import ZaberChain
from simulators.zaber_controller import ZaberController, ZaberModel

LIMITS = AxisLimits(-15.0, 15.0, 20.0, 100.0)
LONGEST_S = 60.0
"""Of the bench's own time: no call may take longer, whatever the line does."""


class VirtualClock:
    """Time passes where the driver waits, for a reply or between two requests."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def monotonic(self) -> float:
        return self.now_s

    def sleep(self, seconds: float) -> None:
        self.now_s += seconds


class DirectLine:
    """A port without a terminal: bytes pass to the simulated device and back in no time."""

    name = "direct"
    STEP_S = 0.05

    def __init__(self, device: FaultLine, clock: VirtualClock) -> None:
        self.device = device
        self.clock = clock
        self.writes = 0
        self.ready = b""

    def write(self, data: bytes) -> None:
        self.writes += 1
        self.ready += self.device.receive(data)

    def read(self, timeout_s: float) -> bytes:
        end_s = self.clock.now_s + timeout_s
        self.ready += self.device.unsolicited()
        while not self.ready and self.clock.now_s < end_s:
            self.clock.now_s = min(end_s, self.clock.now_s + self.STEP_S)
            self.ready += self.device.unsolicited()
        data, self.ready = self.ready, b""
        return data

    def close(self) -> None:
        """Nothing to give back."""


def mechanics(counts_per_deg: float, **more) -> Mechanics:
    return Mechanics(counts_per_deg, -17.0, 17.0, start_deg=2.4, **more)


def zaber(clock: VirtualClock, plug: Callable) -> Stage:
    controller = ZaberController(ZaberModel(mechanics(6400), "100101", -96000, 96000), clock.now_s)
    axis = ZaberAxis(name="pan", device=1, serial="100101", microsteps_per_deg=6400, limits=LIMITS)
    return ZaberStage(plug(ZaberChain([controller], clock.monotonic)), [axis], clock=clock)


def ximc(clock: VirtualClock, plug: Callable) -> Stage:
    controller = XimcController(XimcModel(mechanics(25600), 4242, -15.0, 15.0), clock.monotonic)
    axis = XimcAxis(name="pan", port="", serial="4242", steps_per_deg=100.0, limits=LIMITS)
    return XimcStage([plug(controller)], [axis], clock=clock)


def grbl(clock: VirtualClock, plug: Callable) -> Stage:
    model = GrblAxisModel(mechanics(640.0, home_deg=15.0, stall_detection=False), 32.0)
    axis = GrblAxis(name="pan", letter="X", steps_per_deg=640.0, zero_deg=16.0, limits=LIMITS)
    return GrblStage(plug(GrblController({"X": model}, clock.monotonic)), [axis], clock=clock)


def esp(clock: VirtualClock, plug: Callable) -> Stage:
    controller = EspController([EspAxisModel(mechanics(10_000.0), "1263", -15.0, 15.0)], clock.monotonic)
    axis = EspAxis(name="pan", number=1, serial="SN1263", limits=LIMITS)
    return EspStage(plug(controller), [axis], clock=clock)


@pytest.mark.parametrize("exchanges", [pytest.param(2_000), pytest.param(100_000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("make", [zaber, ximc, grbl, esp])
def test_no_position_and_no_arrival_is_ever_wrong(make, exchanges) -> None:
    clock = VirtualClock()
    rng = np.random.default_rng(7)
    lines: list[DirectLine] = []

    def plug(dialect) -> DirectLine:
        lines.append(DirectLine(FaultLine(dialect, clock.monotonic, rng), clock))
        return lines[-1]

    stage = make(clock, plug)
    stage.home()
    (line,) = lines
    good = {"move": 0, "read": 0}
    bad = 0
    where = stage.position_deg()["pan"]
    while line.writes < exchanges:
        kind = "move" if rng.random() < 0.3 else "read"
        goal = float(rng.integers(-15, 15)) if kind == "move" else where
        with spoiled(line, clock, rng):
            try:
                told = go_and_read(stage, goal) if kind == "move" else stage.position_deg()["pan"]
                assert told == pytest.approx(goal, abs=0.002)
                where = goal
                good[kind] += 1
            except DriverError:
                bad += 1
                goal = None
        if not stage.is_homed():
            stage.home()
            goal = None
        told = stage.position_deg()["pan"]
        assert told == pytest.approx(told if goal is None else goal, abs=0.002)
        where = told
    assert min(good.values()) > 5
    assert bad > 0


def go_and_read(stage: Stage, goal: float) -> float:
    stage.move_to({"pan": goal})
    return stage.position_deg()["pan"]


@contextmanager
def spoiled(line: DirectLine, clock: VirtualClock, rng: np.random.Generator) -> Iterator[None]:
    """Spoil replies at one rate or another for a while; see that it ends in time; then clear the line."""
    line.device.inject(LineFault("any", count=None, chance=float(rng.choice([0.002, 0.02, 0.2]))))
    began_s = clock.now_s
    yield
    assert clock.now_s - began_s < LONGEST_S
    line.device.clear()
    clock.sleep(2.0)


@pytest.mark.parametrize("exchanges", [pytest.param(2_000), pytest.param(100_000, marks=pytest.mark.slow)])
def test_no_setting_of_a_light_is_ever_wrong(exchanges) -> None:
    clock = VirtualClock()
    rng = np.random.default_rng(8)
    line = DirectLine(
        FaultLine(ScpiGenerator(GeneratorModel(), clock.monotonic), clock.monotonic, rng), clock
    )
    light = ScpiLight(line, serial="SG0042", clock=clock)
    light.apply(LightSettings())
    good = bad = 0
    while line.writes < exchanges:
        asked = LightSettings(frequency_hz=float(rng.integers(1, 500)), high_v=float(rng.integers(1, 8)))
        with spoiled(line, clock, rng):
            try:
                assert light.apply(asked) == asked
                light.on()
                good += 1
            except DriverError:
                bad += 1
                asked = None
        if asked is not None:
            assert light.read() == asked
            assert light.is_on()
    assert good > 10
    assert bad > 0
