"""Simulated controllers of every family without terminals, on a clock that only the driver's waits turn.

Bytes pass straight from a driver to a simulated device behind a line of faults: a night of exchanges in seconds.
"""

import math
import re
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from turned_clock import TurnedClock

from bench.stations.station_text import find_description
from bench.stations.text_descriptions import StageProtocol
from drivers.errors import DriverError, MoveFailed, PortLost, ReplyError
from drivers.stage import AxisLimits, Stage
from drivers.stage.esp import EspAxis, EspStage
from drivers.stage.grbl import GrblAxis, GrblStage
from drivers.stage.text import TextAxis, TextStage
from drivers.stage.thorlabs import ThorlabsAxis, ThorlabsStage
from drivers.stage.ximc import XimcAxis, XimcStage
from drivers.stage.zaber import ZaberAxis, ZaberStage
from sequences.reader import read_document
from simulators.assembly import make_stage
from simulators.config import AxisConfig, bench_config
from simulators.faults.catalogue import fault_order_from_text
from simulators.faults.fault_injection import AxisController, BenchParts, fault_action
from simulators.faults.line_faults import FaultLine
from simulators.ports.serial_device import Dialect
from simulators.stages.axis_motion import AxisModel, Mechanics
from simulators.stages.thorlabs_apt import AptController

LIMITS = AxisLimits(-15.0, 15.0, 20.0, 100.0)


class VirtualClock(TurnedClock):
    """Time passes where the driver waits, for a reply or between two requests."""

    def __init__(self) -> None:
        super().__init__(100.0)


class TurningPort:
    """A port where each wait for a reply turns the clock."""

    STEP_S = 0.05
    clock: VirtualClock
    ready: bytes

    def read(self, timeout_s: float) -> bytes:
        end_s = self.clock.now_s + timeout_s
        self.hear()
        while not self.ready and self.clock.now_s < end_s:
            self.clock.now_s = min(end_s, self.clock.now_s + self.STEP_S)
            self.hear()
        data, self.ready = self.ready, b""
        return data

    def hear(self) -> None:
        """Add what the device says unasked to what is ready; most say nothing."""

    def close(self) -> None:
        """Close nothing."""


class DirectLine(TurningPort):
    """A port without a terminal: bytes pass to the simulated device and back in no time.

    It keeps what was sent. It can lose requests, change replies, and let something happen before a request. To orders
    for faults it is the device's end of the line, which can be pulled out, as well.
    """

    name = "direct"

    def __init__(self, device: FaultLine, clock: VirtualClock) -> None:
        self.device = device
        self.clock = clock
        self.baud = device.baud
        self.sent: list[bytes] = []
        self.ready = b""
        self.plugged = True
        self.closed = False
        self.lose: Callable[[bytes], bool] = lambda _request: False
        self.spoil: Callable[[bytes], bytes] = lambda reply: reply
        self.before: Callable[[bytes], None] = lambda _request: None

    def write(self, data: bytes) -> None:
        self.sent.append(data)
        self.before(data)
        if self.lose(data):
            return
        self._see_the_plug()
        alike = self.device.baud == self.baud
        reply = self.device.receive(data) if alike else bytes(0x80 | byte for byte in data)
        self.ready += self.spoil(reply) if reply else b""

    def error_of(self, act: Callable[[], object], longest_s: float) -> DriverError | None:
        """Return the error of a driver that an act ends in, if any; it must come within this time."""
        began_s, error = self.clock.now_s, None
        try:
            act()
        except DriverError as caught:
            error = caught
        assert self.clock.now_s - began_s < longest_s
        return error

    def lose_step(self, ask: Callable[[], object]) -> None:
        """Lose the reply to a question, so that the driver must bring the line into step; forget what was sent."""
        self.spoil, whole = lambda _reply: b"", self.spoil
        with pytest.raises(ReplyError):
            ask()
        self.spoil = whole
        self.sent.clear()

    def hear(self) -> None:
        self.ready += self.device.unsolicited()
        self._see_the_plug()

    def _see_the_plug(self) -> None:
        if not self.plugged:
            raise PortLost("the port is gone.", where=self.name)

    def unplug(self) -> None:
        self.plugged, self.ready = False, b""

    def replug(self) -> None:
        self.plugged = True

    def between_exchanges(self, act) -> None:
        act()

    def lose_next(self, part: bytes, count: int = 1) -> None:
        left = [count]

        def lose(data: bytes) -> bool:
            if part not in data or not left[0]:
                return False
            left[0] -= 1
            return True

        self.lose = lose

    def once_moving(self, command: bytes, event: Callable[[], None], after_s: float = 0.2) -> None:
        """Let an event happen that long after the first request that holds a command."""
        times = [math.inf]

        def before(data: bytes) -> None:
            if command in data and times[0] == math.inf:
                times[0] = self.clock.now_s + after_s
            if self.clock.now_s >= times[0]:
                times[0] = -math.inf
                self.before = lambda _request: None
                event()

        self.before = before

    def turn(self, asked: str, done: str) -> None:
        """Let the device do something else than it is asked: a pattern in a request, and what stands for it."""
        receive = self.device.receive
        self.device.receive = lambda data: receive(re.sub(asked.encode(), done.encode(), data))

    def close(self) -> None:
        self.closed = True


def order_fault(
    port: str, line: DirectLine, text: str, axes: Mapping[str, AxisController], light=None, lamp=None
) -> None:
    """Let something go wrong at a port of a bench, or at a device on it, by the text of an order."""
    parts = BenchParts(
        axes, {port: line}, {port: line.device}, dict.fromkeys(axes, port), light, lamp, None, line.clock.monotonic
    )  # fmt: skip
    fault_action(fault_order_from_text(text), parts)()


def direct_line(device: Dialect, clock: VirtualClock) -> DirectLine:
    """Plug a simulated device into a line of faults without faults yet."""
    return DirectLine(FaultLine(device, clock.monotonic, np.random.default_rng(1)), clock)


class HomedStage:
    """A simulated stage on its line, for which ``open`` makes the driver."""

    open: Callable[..., Any]
    line: DirectLine

    def homed(self, **changes: Any) -> Any:
        """Open the stage and home it; what was sent for that is forgotten."""
        stage = self.open(**changes)
        stage.home()
        self.line.sent.clear()
        return stage


@dataclass
class DirectStage:
    """A stage of one axis, pan, and what the simulated side of it can be told."""

    stage: Stage
    line: DirectLine
    controller: AxisController
    reopen: Callable[[], Stage]
    family: str = ""

    def order(self, text: str) -> None:
        """Let something go wrong, as it is ordered on a bench; the axis is called pan, its line gimbal."""
        order_fault("gimbal", self.line, text, {"pan": self.controller})

    def present_deg(self) -> float:
        """Where the axis points now."""
        return self.controller.axis.pointing.angle_deg(self.line.clock.now_s)

    def true_deg(self) -> float:
        """Where the axis really points, once it has settled."""
        return self.controller.axis.pointing.angle_deg(self.line.clock.now_s + 1.0)

    def see_it_home_and_move(self, stage: Stage, *angles_deg: float, off_deg: float = 0.0) -> None:
        """Home the stage and move it: it tells where it stands, the axis points there, and nothing is a fault."""
        stage.home()
        for angle_deg in angles_deg or (5.0,):
            stage.move_to({"pan": angle_deg})
            assert stage.position_deg()["pan"] == pytest.approx(angle_deg, abs=0.002)
            assert self.true_deg() == pytest.approx(angle_deg + off_deg, abs=0.002)
        assert stage.faults() == []

    def see_it_stand(self, seconds: float = 5.0) -> float:
        """See that the axis stands still for so long; return where, in degrees."""
        stands_deg = self.true_deg()
        self.line.clock.sleep(seconds)
        assert self.true_deg() == pytest.approx(stands_deg, abs=1e-3)
        return stands_deg


def stop_in_mid_move(
    clock: VirtualClock, stage: Stage, target: dict[str, float], after_s: float
) -> DriverError:
    """Stop a stage from another thread, when the virtual clock has reached a time; return the move's error."""
    began_s, sleep, stopped = clock.now_s, clock.sleep, []

    def sleep_then_stop(seconds: float) -> None:
        sleep(seconds)
        if not stopped and clock.now_s - began_s > after_s:
            stopped.append(True)
            stopper = threading.Thread(target=stage.stop)
            stopper.start()
            stopper.join()

    clock.sleep = sleep_then_stop
    with pytest.raises(MoveFailed) as caught:
        stage.move_to(target)
    clock.sleep = sleep
    return caught.value


FLIR_PTU = read_document(find_description("flir_ptu", None), StageProtocol).value.for_driver()
K10CR1_COUNTS_PER_DEG = 409_600 / 3
PRM1Z8_COUNTS_PER_DEG = 1919.6418578623391
PAN = {"name": "pan", "limits": LIMITS}


@dataclass(frozen=True)
class Family:
    """A simulated controller of one axis, and our driver for it."""

    simulate: Callable[[Callable[[], float]], tuple[Dialect, AxisController]]
    open: Callable[[DirectLine], Stage]

    def __call__(self, clock: VirtualClock, rng: np.random.Generator) -> DirectStage:
        """Open the driver on a line of faults without faults yet."""
        dialect, controller = self.simulate(clock.monotonic)
        line = DirectLine(FaultLine(dialect, clock.monotonic, rng), clock)
        return DirectStage(self.open(line), line, controller, lambda: self.open(line))


def of_one_port(kind: str, clock: Callable[[], float]) -> tuple[Dialect, Mapping[str, AxisController]]:
    """The device on the port of a stage of that kind, and the controllers of its axes, as a bench has them."""
    stage = make_stage(kind, bench_config({"stage": {"kind": kind}}).axes, clock, lambda *_: None)
    (dialect,) = stage.dialects.values()
    return dialect, stage.controllers


def of_bench(kind: str, counts_per_deg: int, serial: str = "100101", start_deg: float = 2.4, **changes):
    """A controller as a simulated bench has it, with the keys of `AxisConfig` that differ."""

    def simulate(clock: Callable[[], float]) -> tuple[Dialect, AxisController]:
        axes = {"pan": AxisConfig(serial, 15.0, start_deg, counts_per_deg, **changes)}
        stage = make_stage(kind, axes, clock, lambda *_: None)
        (dialect,) = stage.dialects.values()
        return dialect, stage.controllers["pan"]

    return simulate


def named_board(clock: Callable[[], float]) -> tuple[Dialect, AxisController]:
    board, controller = of_bench("grbl", 640)(clock)
    board.name = "GIMBAL"
    return board, controller


def kdc101(clock: Callable[[], float]) -> tuple[Dialect, AxisController]:
    mechanics = Mechanics(PRM1Z8_COUNTS_PER_DEG, -17.0, 17.0, start_deg=2.4)
    controller = AptController(AxisModel(mechanics, "27000123", 15.0, 10.0, 10.0, name="KDC101"), clock)
    return controller, controller


def of_thorlabs(counts_per_deg: float) -> Callable[[DirectLine], Stage]:
    axis = ThorlabsAxis(port="", serial="27000123", counts_per_deg=counts_per_deg, **PAN)
    return lambda line: ThorlabsStage([line], [axis], clock=line.clock)


def of_line(stage: Callable[..., Stage], axis: object, **more: Any) -> Callable[[DirectLine], Stage]:
    return lambda line: stage(line, [axis], clock=line.clock, **more)


ZABER = ZaberAxis(device=1, serial="100101", microsteps_per_deg=6400, **PAN)
XIMC = XimcAxis(port="", serial="4242", steps_per_deg=100.0, encoder_counts_per_deg=2000.0, **PAN)
ESP = EspAxis(number=1, serial="SN1263", **PAN)
GRBL = GrblAxis(letter="X", steps_per_deg=640, zero_deg=16, **PAN)
FLIR = TextAxis(address="P", counts_per_deg=8e2, **PAN)
FAMILIES = {
    "zaber": Family(of_bench("zaber", 6400), of_line(ZaberStage, ZABER)),
    "ximc": Family(
        of_bench("ximc", 25_600, "4242"), lambda line: XimcStage([line], [XIMC], clock=line.clock)
    ),
    "esp": Family(of_bench("esp301", 10_000, "1263"), of_line(EspStage, ESP)),
    "grbl": Family(named_board, of_line(GrblStage, GRBL, serial="gimbal")),
    "flir": Family(
        of_bench("flir_ptu", 800, "E1042"), of_line(TextStage, FLIR, description=FLIR_PTU, serial="E1042")
    ),
    "thorlabs": Family(kdc101, of_thorlabs(PRM1Z8_COUNTS_PER_DEG)),
    "k10cr1": Family(of_bench("thorlabs_apt", 136_533, "27000123"), of_thorlabs(K10CR1_COUNTS_PER_DEG)),
}


def rig_of(family: str) -> DirectStage:
    """A stage of a family with its driver, on a clock of its own."""
    rig = FAMILIES[family](VirtualClock(), np.random.default_rng(1))
    rig.family = family
    return rig
