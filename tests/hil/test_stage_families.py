"""Every family of stages on its simulated controllers: one behaviour, and no fault that passes for an arrival."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from drivers.clock import SystemClock
from drivers.errors import (
    DriverError,
    MoveFailed,
    NotHomed,
    OutsideLimits,
    PortBusy,
    PortLost,
    ReplyError,
    WrongDevice,
)
from drivers.serial_port import SerialPort
from drivers.stage import AxisLimits, Stage
from drivers.stage.dynamixel import DynamixelAxis, DynamixelStage
from drivers.stage.esp import EspAxis, EspStage
from drivers.stage.grbl import GrblAxis, GrblStage
from drivers.stage.text import TextAxis, TextStage
from drivers.stage.thorlabs import ThorlabsAxis, ThorlabsStage
from drivers.stage.ximc import XimcAxis, XimcStage
from drivers.stage.zaber import ZaberAxis, ZaberStage
from simulators.faults.line_faults import FaultLine, LineFault
from simulators.ports.pseudo_terminal import PseudoTerminal
from simulators.ports.serial_device import SerialDevice, TcpPort
from simulators.stages.axis_motion import Axis, Mechanics, MotionFault
from simulators.stages.dynamixel import DynamixelBus, ServoModel
from simulators.stages.esp301 import EspAxisModel, EspController
from simulators.stages.flir_ptu import PtuAxisModel, PtuController
from simulators.stages.grbl import GrblAxis as BoardAxis
from simulators.stages.grbl import GrblController
from simulators.stages.grbl_planner import GrblAxisModel
from simulators.stages.thorlabs_apt import AptController, AptModel
from simulators.stages.ximc import XimcController, XimcModel
from simulators.stages.zaber import ZaberChain, ZaberController, ZaberModel
from tests.hil.direct_stages import FLIR_PTU, K10CR1_COUNTS_PER_DEG, SERVO_COUNTS_PER_DEG

ENDS = {"pan": 15.0, "tilt": 10.0}
STARTS = {"pan": 2.4, "tilt": -1.7}
LIMITS = {name: AxisLimits(-end, end, 20.0, 100.0) for name, end in ENDS.items()}
FAMILIES = ["zaber", "ximc", "grbl", "esp", "flir", "thorlabs", "dynamixel"]


def mechanics(name: str, counts_per_deg: float, **more) -> Mechanics:
    return Mechanics(counts_per_deg, -ENDS[name] - 2.0, ENDS[name] + 2.0, start_deg=STARTS[name], **more)


@dataclass
class Rig:
    """A stage's controllers on their lines, and how to open the driver for them."""

    open: Callable[..., Stage]
    devices: list[SerialDevice]
    lines: list[FaultLine]
    axes: Mapping[str, Axis]
    controllers: Mapping[str, object]

    def order(self, kind: str, name: str = "pan", **more) -> None:
        """Let a fault befall the next motion of an axis."""
        self.axes[name].arm(MotionFault(kind, **more))

    def spoil(self, kind: str, **more) -> None:
        for line in self.lines:
            line.inject(LineFault(kind, **more))


def zaber(plug: Callable) -> Rig:
    now_s = time.monotonic()
    controllers = {
        name: ZaberController(
            ZaberModel(
                mechanics(name, 6400), f"10010{number}", int(-ENDS[name] * 6400), int(ENDS[name] * 6400)
            ),
            now_s,
        )
        for number, name in ((1, "pan"), (2, "tilt"))
    }
    device, line = plug(ZaberChain(list(controllers.values()), time.monotonic))

    def opened(serial: str = "100101", baudrate: int = 115200) -> Stage:
        axes = [
            ZaberAxis(
                name=name,
                device=number,
                serial=serial if name == "pan" else "",
                microsteps_per_deg=6400,
                limits=LIMITS[name],
            )
            for number, name in ((1, "pan"), (2, "tilt"))
        ]
        return ZaberStage.open(device.address, axes, baudrate=baudrate, clock=SystemClock())

    return Rig(opened, [device], [line], {n: c.axis for n, c in controllers.items()}, controllers)


def ximc(plug: Callable) -> Rig:
    controllers = {
        name: XimcController(
            XimcModel(mechanics(name, 25600), number, -ENDS[name], ENDS[name]), time.monotonic
        )
        for number, name in ((100101, "pan"), (100102, "tilt"))
    }
    plugged = {name: plug(controller) for name, controller in controllers.items()}

    def opened(serial: str = "100101", baudrate: int = 115200) -> Stage:
        axes = [
            XimcAxis(
                name=name,
                port=device.address,
                serial=serial if name == "pan" else "",
                steps_per_deg=100.0,
                encoder_counts_per_deg=2000.0,
                limits=LIMITS[name],
            )
            for name, (device, _) in plugged.items()
        ]
        if baudrate == 115200:
            return XimcStage.open(axes, clock=SystemClock())
        ports = [SerialPort(axis.port, baudrate=baudrate, stopbits=2) for axis in axes]
        return XimcStage(ports, axes, clock=SystemClock())

    devices, lines = zip(*plugged.values(), strict=True)
    return Rig(opened, list(devices), list(lines), {n: c.axis for n, c in controllers.items()}, controllers)


def grbl(plug: Callable) -> Rig:
    models = {
        letter: GrblAxisModel(
            mechanics(name, 640.0, home_deg=ENDS[name], stall_detection=False), 2.0 * ENDS[name] + 2.0
        )
        for letter, name in (("X", "pan"), ("Y", "tilt"))
    }
    board = GrblController(models, time.monotonic)
    device, line = plug(board)

    def opened(serial: str = "", baudrate: int = 115200) -> Stage:
        axes = [
            GrblAxis(
                name=name, letter=letter, steps_per_deg=640.0, zero_deg=ENDS[name] + 1.0, limits=LIMITS[name]
            )
            for letter, name in (("X", "pan"), ("Y", "tilt"))
        ]
        return GrblStage.open(device.address, axes, serial=serial, baudrate=baudrate, clock=SystemClock())

    controllers = {"pan": BoardAxis(board, board.axes["X"]), "tilt": BoardAxis(board, board.axes["Y"])}
    return Rig(opened, [device], [line], {n: c.axis for n, c in controllers.items()}, controllers)


def esp(plug: Callable) -> Rig:
    models = [
        EspAxisModel(mechanics(name, 10_000.0), f"10010{number}", -ENDS[name], ENDS[name])
        for number, name in ((1, "pan"), (2, "tilt"))
    ]
    controller = EspController(models, time.monotonic)
    device, line = plug(controller)

    def opened(serial: str = "100101", baudrate: int = 19200) -> Stage:
        axes = [
            EspAxis(name=name, number=number, serial=serial if name == "pan" else "", limits=LIMITS[name])
            for number, name in ((1, "pan"), (2, "tilt"))
        ]
        return EspStage.open(device.address, axes, baudrate=baudrate, clock=SystemClock())

    controllers = {"pan": controller.axes[1], "tilt": controller.axes[2]}
    return Rig(opened, [device], [line], {n: c.axis for n, c in controllers.items()}, controllers)


def flir(plug: Callable) -> Rig:
    models = {
        letter: PtuAxisModel(mechanics(name, 800.0, stall_detection=False), ENDS[name])
        for letter, name in (("P", "pan"), ("T", "tilt"))
    }
    unit = PtuController(models, "100101", time.monotonic, baud=57_600)
    device, line = plug(unit)

    def opened(serial: str = "100101", baudrate: int = 57_600) -> Stage:
        axes = [
            TextAxis(name=name, address=letter, counts_per_deg=800.0, limits=LIMITS[name])
            for letter, name in (("P", "pan"), ("T", "tilt"))
        ]
        return TextStage.open(
            device.address, axes, FLIR_PTU, serial=serial, baudrate=baudrate, clock=SystemClock()
        )

    controllers = {"pan": unit.axes["P"], "tilt": unit.axes["T"]}
    return Rig(opened, [device], [line], {n: c.axis for n, c in controllers.items()}, controllers)


def thorlabs(plug: Callable) -> Rig:
    controllers = {
        name: AptController(
            AptModel(mechanics(name, K10CR1_COUNTS_PER_DEG, stall_detection=False), number), time.monotonic
        )
        for number, name in ((100101, "pan"), (100102, "tilt"))
    }
    plugged = {name: plug(controller) for name, controller in controllers.items()}

    def opened(serial: str = "100101", baudrate: int = 115200) -> Stage:
        axes = [
            ThorlabsAxis(
                name=name,
                port=device.address,
                serial=serial if name == "pan" else "",
                counts_per_deg=K10CR1_COUNTS_PER_DEG,
                limits=LIMITS[name],
            )
            for name, (device, _) in plugged.items()
        ]
        if baudrate == 115200:
            return ThorlabsStage.open(axes, clock=SystemClock())
        ports = [SerialPort(axis.port, baudrate=baudrate) for axis in axes]
        return ThorlabsStage(ports, axes, clock=SystemClock())

    devices, lines = zip(*plugged.values(), strict=True)
    return Rig(opened, list(devices), list(lines), {n: c.axis for n, c in controllers.items()}, controllers)


def dynamixel(plug: Callable) -> Rig:
    models = {
        number: ServoModel(mechanics(name, SERVO_COUNTS_PER_DEG))
        for number, name in ((1, "pan"), (2, "tilt"))
    }
    bus = DynamixelBus(models, time.monotonic)
    device, line = plug(bus)

    def opened(serial: str = "", baudrate: int = 57_600) -> Stage:
        axes = [
            DynamixelAxis(
                name=name,
                id=number,
                model="XM430-W350" if serial and name == "pan" else "XL430-W250",
                counts_per_deg=SERVO_COUNTS_PER_DEG,
                limits=LIMITS[name],
                tolerance_deg=0.02,
            )
            for number, name in ((1, "pan"), (2, "tilt"))
        ]
        return DynamixelStage.open(device.address, axes, baudrate=baudrate, clock=SystemClock())

    controllers = {"pan": bus.servos[1], "tilt": bus.servos[2]}
    return Rig(opened, [device], [line], {n: c.axis for n, c in controllers.items()}, controllers)


MAKERS = {
    "zaber": zaber,
    "ximc": ximc,
    "grbl": grbl,
    "esp": esp,
    "flir": flir,
    "thorlabs": thorlabs,
    "dynamixel": dynamixel,
}


@pytest.fixture
def rig(request, tmp_path: Path) -> Iterator[Rig]:
    with ExitStack() as stack:

        def plug(dialect) -> tuple[SerialDevice, FaultLine]:
            line = FaultLine(dialect, time.monotonic, np.random.default_rng(1))
            if over_tcp:
                terminal = TcpPort("stage")
            else:
                terminal = PseudoTerminal(tmp_path / f"port{len(list(tmp_path.iterdir()))}")
            return stack.enter_context(SerialDevice(terminal, line)), line

        family, _, over_tcp = request.param.partition(" over ")
        yield MAKERS[family](plug)


@pytest.fixture
def stage(rig) -> Iterator[Stage]:
    stage = rig.open()
    yield stage
    stage.close()


@pytest.fixture
def homed(stage) -> Stage:
    stage.home()
    return stage


def families(*names: str) -> pytest.MarkDecorator:
    """Of all faults, those of the first family are tried always, the others' in the long tests."""
    slow = [pytest.param(name, marks=pytest.mark.slow) for name in names[1:]]
    return pytest.mark.parametrize("rig", [names[0], *slow], indirect=True)


every_family = pytest.mark.parametrize("rig", FAMILIES, indirect=True)
each_in_turn = families(*FAMILIES)
with_encoder = families("zaber", "ximc", "esp", "dynamixel")


@pytest.mark.parametrize("rig", [*FAMILIES, "zaber over TCP", "ximc over TCP"], indirect=True)
def test_a_stage_is_identified_homed_moved_and_stopped(rig, stage) -> None:
    assert [axis.name for axis in stage.identify()] == ["pan", "tilt"]
    assert not stage.is_homed()
    with pytest.raises(NotHomed):
        stage.move_to({"pan": 1.0})
    for name, axis in rig.axes.items():
        assert axis.pointing.angle_deg(time.monotonic()) == pytest.approx(STARTS[name], abs=1e-5)
    stage.home()
    assert stage.is_homed()
    assert stage.faults() == []
    for target in ({"pan": 5.0, "tilt": -3.0}, {"pan": -14.9}, {"tilt": 9.5}):
        stage.move_to(target)
        for name, angle in target.items():
            assert stage.position_deg()[name] == pytest.approx(angle, abs=0.002)
            pointing = rig.axes[name].pointing.angle_deg(time.monotonic() + 1.0)
            assert pointing == pytest.approx(angle, abs=0.002)
    stage.stop()
    with pytest.raises(OutsideLimits):
        stage.move_to({"pan": 15.5})


@every_family
def test_opening_and_closing_moves_nothing(rig) -> None:
    for _ in range(2):
        rig.open().close()
    for name, axis in rig.axes.items():
        assert axis.pointing.angle_deg(time.monotonic()) == pytest.approx(STARTS[name], abs=1e-5)


@every_family
def test_another_device_and_a_second_opening_are_refused(rig) -> None:
    with pytest.raises(WrongDevice):
        rig.open(serial="999")
    first = rig.open()
    with pytest.raises(PortBusy):
        rig.open()
    first.close()


@each_in_turn
def test_a_stop_from_another_thread_ends_a_move(rig, homed) -> None:
    failed = []

    def move() -> None:
        try:
            homed.move_to({"pan": -15.0, "tilt": -10.0})
        except MoveFailed as error:
            failed.append(error)

    start = homed.position_deg()["pan"]
    mover = threading.Thread(target=move)
    mover.start()
    while homed.position_deg()["pan"] == start:
        pass
    homed.stop()
    rest = homed.position_deg()
    mover.join()
    assert len(failed) == 1
    assert homed.position_deg() == pytest.approx(rest, abs=0.01)
    assert rest["pan"] > -14.0


def bounded(act: Callable[[], object], within_s: float = 20.0) -> DriverError:
    """Return the driver's error of an act that must fail in bounded time."""
    began_s = time.monotonic()
    with pytest.raises(DriverError) as caught:
        act()
    assert time.monotonic() - began_s < within_s
    return caught.value


@each_in_turn
def test_a_move_that_stops_short_is_noticed(rig, homed) -> None:
    rig.order("stop_short")
    error = bounded(lambda: homed.move_to({"pan": -9.0}))
    assert isinstance(error, MoveFailed)
    assert error.where == "pan"


@each_in_turn
def test_a_restart_in_mid_move_is_noticed_and_undoes_the_reference(rig, homed) -> None:
    rig.order("restart")
    bounded(lambda: homed.move_to({"pan": -9.0}))
    assert not homed.is_homed()
    bounded(lambda: homed.move_to({"pan": 1.0}))


@each_in_turn
def test_a_limit_switch_in_mid_move_is_noticed(rig, homed) -> None:
    rig.order("limit")
    error = bounded(lambda: homed.move_to({"pan": -9.0}))
    if isinstance(
        homed, GrblStage
    ):  # its board stops all axes, answers nothing, and does not say which it was
        assert "limit switch hit" in error.what
    else:
        assert error.where == "pan"


@with_encoder
def test_a_stall_is_noticed(rig, homed) -> None:
    rig.order("stall")
    assert bounded(lambda: homed.move_to({"pan": -9.0})).where == "pan"


@with_encoder
def test_a_slip_is_noticed_where_there_is_an_encoder(rig, homed) -> None:
    rig.order("slip")
    assert bounded(lambda: homed.move_to({"pan": -9.0})).where == "pan"


@each_in_turn
def test_a_controller_that_stays_busy_is_noticed(rig, homed) -> None:
    rig.axes["pan"].stuck_busy = True
    assert "pan" in str(bounded(lambda: homed.move_to({"pan": -9.0})))


@each_in_turn
def test_an_idle_flicker_in_mid_move_is_no_arrival(rig, homed) -> None:
    rig.axes["pan"].report_false_idle(1)
    homed.move_to({"pan": -9.0})
    assert homed.position_deg()["pan"] == pytest.approx(-9.0, abs=0.002)


@each_in_turn
def test_an_emergency_stop_is_noticed_and_stays_until_homed_again(rig, homed) -> None:
    timer = threading.Timer(0.2, lambda: rig.controllers["pan"].emergency_stop(time.monotonic()))
    timer.start()
    bounded(lambda: homed.move_to({"pan": -14.0}))
    timer.join()
    bounded(lambda: homed.move_to({"pan": 1.0}))
    rig.controllers["pan"].emergency_stop(time.monotonic(), released=True)
    bounded(lambda: homed.move_to({"pan": 1.0}))
    assert not homed.is_homed()


@each_in_turn
@pytest.mark.parametrize("kind", ["lost", "truncated", "garbled", "nul", "doubled", "late", "request_lost"])
def test_one_spoiled_message_never_becomes_a_wrong_position(rig, homed, kind) -> None:
    homed.move_to({"pan": -9.0, "tilt": 4.0})
    rig.spoil(kind, delay_s=1.2)
    told = []
    for _ in range(3):
        with suppress(ReplyError):
            told.append(homed.position_deg())
    assert told
    for position in told:
        assert position == pytest.approx({"pan": -9.0, "tilt": 4.0}, abs=0.002)


@pytest.mark.slow
@every_family
def test_a_silent_line_is_an_error_in_bounded_time(rig, homed) -> None:
    rig.spoil("lost", count=None)
    assert isinstance(bounded(homed.position_deg), ReplyError)
    bounded(homed.stop)


@each_in_turn
def test_an_unplugged_stage_is_lost_and_comes_back_without_moving(rig, homed) -> None:
    timer = threading.Timer(0.15, rig.devices[0].unplug)
    timer.start()
    assert isinstance(bounded(lambda: homed.move_to({"pan": -14.0})), PortLost)
    timer.join()
    homed.close()
    rig.devices[0].replug()
    time.sleep(3.0)
    before = {name: axis.pointing.angle_deg(time.monotonic()) for name, axis in rig.axes.items()}
    again = rig.open()
    again.identify()
    again.close()
    after = {name: axis.pointing.angle_deg(time.monotonic()) for name, axis in rig.axes.items()}
    assert after == pytest.approx(before, abs=1e-4)


@each_in_turn
def test_a_wrong_baud_rate_is_told_and_moves_nothing(rig) -> None:
    assert isinstance(bounded(lambda: rig.open(baudrate=9600)), ReplyError)
    assert rig.axes["pan"].pointing.angle_deg(time.monotonic()) == pytest.approx(STARTS["pan"], abs=1e-6)
