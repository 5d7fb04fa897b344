"""Simulated controllers of every family without terminals, on a clock that only the driver's waits turn.

Bytes pass straight from a driver to a simulated device behind a line of faults: a night of exchanges in seconds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.stage import AxisLimits, Stage
from drivers.stage.esp import EspAxis, EspStage
from drivers.stage.grbl import GrblAxis, GrblStage
from drivers.stage.ximc import XimcAxis, XimcStage
from drivers.stage.zaber import ZaberAxis, ZaberStage
from simulators.axis_motion import Mechanics
from simulators.esp301 import EspAxisModel, EspController
from simulators.grbl import GrblAxis as BoardAxis
from simulators.grbl import GrblController
from simulators.grbl_planner import GrblAxisModel
from simulators.line_faults import FaultLine
from simulators.ximc import XimcController, XimcModel
from simulators.zaber import ZaberChain
from simulators.zaber_controller import ZaberController, ZaberModel

LIMITS = AxisLimits(-15.0, 15.0, 20.0, 100.0)


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


@dataclass
class DirectStage:
    """A stage of one axis, pan, and what the simulated side of it can be told."""

    stage: Stage
    line: DirectLine
    controller: object


def zaber(clock: VirtualClock, rng: np.random.Generator) -> DirectStage:
    controller = ZaberController(ZaberModel(mechanics(6400), "100101", -96000, 96000), clock.now_s)
    axis = ZaberAxis(name="pan", device=1, serial="100101", microsteps_per_deg=6400, limits=LIMITS)
    line = DirectLine(FaultLine(ZaberChain([controller], clock.monotonic), clock.monotonic, rng), clock)
    return DirectStage(ZaberStage(line, [axis], clock=clock), line, controller)


def ximc(clock: VirtualClock, rng: np.random.Generator) -> DirectStage:
    controller = XimcController(XimcModel(mechanics(25600), 4242, -15.0, 15.0), clock.monotonic)
    axis = XimcAxis(
        name="pan", port="", serial="4242", steps_per_deg=100.0, encoder_counts_per_deg=2000.0, limits=LIMITS
    )
    line = DirectLine(FaultLine(controller, clock.monotonic, rng), clock)
    return DirectStage(XimcStage([line], [axis], clock=clock), line, controller)


def grbl(clock: VirtualClock, rng: np.random.Generator) -> DirectStage:
    model = GrblAxisModel(mechanics(640.0, home_deg=15.0, stall_detection=False), 32.0)
    board = GrblController({"X": model}, clock.monotonic)
    axis = GrblAxis(name="pan", letter="X", steps_per_deg=640.0, zero_deg=16.0, limits=LIMITS)
    line = DirectLine(FaultLine(board, clock.monotonic, rng), clock)
    return DirectStage(GrblStage(line, [axis], clock=clock), line, BoardAxis(board, "X"))


def esp(clock: VirtualClock, rng: np.random.Generator) -> DirectStage:
    controller = EspController([EspAxisModel(mechanics(10_000.0), "1263", -15.0, 15.0)], clock.monotonic)
    axis = EspAxis(name="pan", number=1, serial="SN1263", limits=LIMITS)
    line = DirectLine(FaultLine(controller, clock.monotonic, rng), clock)
    return DirectStage(EspStage(line, [axis], clock=clock), line, controller.axes[1])


FAMILIES = {"zaber": zaber, "ximc": ximc, "esp": esp, "grbl": grbl}
