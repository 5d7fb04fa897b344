"""The XIMC stage on its simulated controllers: what it sends, what it refuses, and how it stops.

``tests/hil/test_every_fault.py`` shows what each family does with faults of axis and line.
"""

import struct
import time

import pytest

from drivers.errors import DeviceRefused, DriverError, MoveFailed, OutsideLimits, ReplyError, ReplyGarbled
from drivers.stage import AxisLimits, ximc
from drivers.stage.ximc import XimcAxis, XimcStage
from drivers.stage.ximc_protocol import check_data, move_data, request
from simulators.stages.axis_motion import AxisModel, Mechanics
from simulators.stages.ximc import XimcController, crc16
from tests.hil.direct_stages import VirtualClock, direct_line

pytestmark = pytest.mark.usefixtures("never_late")

SCALE = 80.0
MICROSTEPS = 256
LIMITS = AxisLimits(-15.0, 15.0, 10.0, 50.0)
MOTIONS = {b"move", b"movr", b"home", b"left", b"rigt"}


def axes(**changes) -> list[XimcAxis]:
    words = {"steps_per_deg": SCALE, "limits": LIMITS, **changes}
    pan = XimcAxis(name="pan", port="a", serial="12345", **words)
    words |= {"steps_per_deg": -words["steps_per_deg"], "zero_deg": 1.0}
    return [pan, XimcAxis(name="tilt", port="b", serial="12346", **words)]


def sealed(data: bytes) -> bytes:
    return data + struct.pack("<H", crc16(data))


class Bench:
    """Two controllers, each on a line of its own, and the driver for them."""

    def __init__(self) -> None:
        self.clock = VirtualClock()
        mechanics = Mechanics(SCALE * MICROSTEPS, -17.0, 17.0, start_deg=2.4)
        self.pan, self.tilt = self.controllers = [
            XimcController(AxisModel(mechanics, serial, 17.0), self.clock.monotonic)
            for serial in ("12345", "12346")
        ]
        self.lines = [direct_line(controller, self.clock) for controller in self.controllers]

    def open(self, **changes) -> XimcStage:
        return XimcStage(self.lines, axes(**changes), clock=self.clock)

    def homed(self, **changes) -> XimcStage:
        stage = self.open(**changes)
        stage.home()
        for line in self.lines:
            line.sent.clear()
        return stage

    def sent(self, *commands: bytes) -> list[bytes]:
        return [data for line in self.lines for data in line.sent if data[:4] in commands]

    def settings(self, number: int, command: bytes) -> bytes:
        return self.controllers[number].receive(command)[4:-2]

    def set_borders(self, number: int, flags: int, lowest: int, highest: int) -> bytes:
        """Set the limits of travel, in steps. Bit 0 of the flags: counts are the limits, not switches."""
        data = struct.pack("<BBihih6x", flags, 0, lowest, 0, highest, 0)
        self.controllers[number].receive(b"seds" + sealed(data))
        return data

    def busy(self) -> bool:
        return any(controller.axis.busy(self.clock.now_s) for controller in self.controllers)

    def answer(self, number: int, command: bytes, data: bytes) -> None:
        """Let one command of a controller have another answer: data with their CRC, or an error's four letters."""
        line = self.lines[number]
        answer = data if data.startswith(b"err") else command + sealed(data)
        line.spoil = lambda reply: answer if line.sent[-1].startswith(command) else reply


@pytest.fixture
def bench() -> Bench:
    return Bench()


def test_a_reply_the_makers_library_takes_is_taken() -> None:
    assert check_data("gser", b"90\0\0\x0c\xb7", "port") == struct.pack("<I", 12345)
    with pytest.raises(ReplyGarbled, match="port: wrong CRC"):
        check_data("gser", b"91\0\0\x0c\xb7", "port")


# ---------------------------------------------------------------- the good case
def test_opening_moves_nothing_and_programs_speed_and_borders(bench) -> None:
    before = bench.settings(0, b"gmov")
    bench.set_borders(0, 0x07, -2000, 2000)
    bench.set_borders(1, 0x07, -2000, 2000)
    bench.open()
    assert bench.sent(*MOTIONS) == []
    assert struct.unpack("<IBHH", bench.settings(0, b"gmov")[:9]) == (800, 0, 4000, 4000)
    assert bench.settings(0, b"gmov")[9:] == before[9:]
    assert struct.unpack("<BBihih6x", bench.settings(0, b"geds"))[2:6] == (-1200, 0, 1200, 0)
    assert struct.unpack("<BBihih6x", bench.settings(1, b"geds"))[2:6] == (-1120, 0, 1280, 0)


def test_the_reference_becomes_the_zero_and_moves_count_from_there(bench) -> None:
    stage = bench.open()
    assert not stage.is_homed()
    assert stage.faults() == ["pan: no reference", "tilt: no reference"]
    stage.home()
    assert stage.position_deg() == {"pan": 0.0, "tilt": 1.0}
    stage.move_to({"pan": -5.1, "tilt": 3.0})
    assert bench.sent(b"move")[0][:10] == b"move" + struct.pack("<ih", -408, 0)
    assert [round(controller.axis.counter(bench.clock.now_s)) for controller in bench.controllers] == [
        round(-5.1 * SCALE * MICROSTEPS),
        round(-2 * SCALE * MICROSTEPS),
    ]


def test_an_alarm_keeps_an_axis_from_moving_until_it_is_homed_again(bench) -> None:
    stage = bench.homed()
    bench.tilt.emergency_stop(bench.clock.now_s)
    with pytest.raises(DriverError, match="tilt"):
        stage.move_to({"pan": 1.0, "tilt": 1.0})
    assert bench.sent(*MOTIONS) == []
    bench.tilt.emergency_stop(bench.clock.now_s, released=True)
    stage.home()
    stage.move_to({"pan": 1.0})
    assert stage.position_deg()["pan"] == pytest.approx(1.0, abs=0.01)


def test_homing_that_leaves_no_reference_has_failed(bench) -> None:
    stage = bench.open()
    bench.tilt.axis.home = lambda *_, **__: None
    with pytest.raises(MoveFailed, match=r"tilt: .* without a reference"):
        stage.home()


# ---------------------------------------------------------------- refused before anything moves


@pytest.mark.parametrize(
    ("command", "data", "message"),
    [
        (b"gent", struct.pack("<BB6x", 1, 2), r"no stepper motor \(engine type 1\)"),
        (b"gfbs", struct.pack("<HBBI4x", 0, 1, 0, 4000), "counts by its encoder"),
        (b"gfbs", struct.pack("<HBBI4x", 0, 6, 0, 4000), "counts by its encoder"),
        (b"smov", b"errv", "out of range"),
    ],
)
def test_what_the_controller_is_not_made_for_is_refused(bench, command, data, message) -> None:
    bench.answer(0, command, data)
    with pytest.raises(DeviceRefused, match=message):
        bench.open()
    assert bench.sent(b"smov")[1:] == []


def test_a_setting_that_reads_back_otherwise_is_refused(bench) -> None:
    bench.answer(0, b"gmov", bench.settings(0, b"gmov"))
    with pytest.raises(DeviceRefused, match="read back differently"):
        bench.open()


def test_a_speed_beyond_the_controller_is_refused(bench) -> None:
    with pytest.raises(OutsideLimits, match=r"72000 steps/s\^2"):
        bench.open(limits=AxisLimits(-1, 1, 10.0, 900.0))


def test_borders_at_counts_are_narrowed_never_widened(bench) -> None:
    for end, fits in ((1199, False), (1200, True)):
        borders = bench.set_borders(0, 0x07, -1200, end)
        if fits:
            bench.open()
            continue
        with pytest.raises(OutsideLimits, match="controller allows"):
            bench.open()
        assert bench.settings(0, b"geds") == borders


# ---------------------------------------------------------------- noticed in mid-move
def halted(bench: Bench) -> None:
    bench.pan.axis.halt(bench.clock.now_s)


def failed(bench: Bench) -> None:
    halted(bench)
    status = bytearray(bench.settings(0, b"gets"))
    status[1] |= 0x40
    bench.answer(0, b"gets", bytes(status))


@pytest.mark.parametrize(
    ("event", "message"),
    [
        (halted, "pan: stopped at .* from its target 9"),
        (lambda bench: bench.pan.axis.forget_reference(), "pan: the controller lost its reference"),
        (failed, "pan: the controller reports that its move failed"),
        (lambda bench: bench.pan.receive(b"left"), r"pan: interrupted by another command \(left\)"),
    ],
)
def test_a_move_that_goes_wrong_is_noticed_and_all_axes_are_stopped(bench, event, message) -> None:
    stage = bench.homed()
    bench.lines[0].once_moving(b"gets", lambda: event(bench), after_s=0.4)
    with pytest.raises(MoveFailed, match=message):
        stage.move_to({"pan": 9.0, "tilt": 9.0})
    bench.clock.sleep(1.0)
    assert not bench.tilt.axis.busy(bench.clock.now_s)


# ---------------------------------------------------------------- the line, and stops
def test_bytes_left_over_from_before_us_do_no_harm(bench) -> None:
    bench.pan.receive(b"smov" + bytes(7))
    bench.lines[0].ready = b"\0\0gets"
    assert len(bench.open().identify()) == 2
    assert bench.sent(*MOTIONS) == []


def test_a_move_that_arrived_damaged_is_not_sent_again(bench) -> None:
    stage = bench.homed()
    bench.answer(0, b"move", b"errd")
    with pytest.raises(ReplyGarbled, match="errd"):
        stage.move_to({"pan": 9.0})
    assert len(bench.sent(b"move")) == 1


def test_a_silent_controller_does_not_keep_the_others_moving(bench, monkeypatch) -> None:
    monkeypatch.setattr(ximc.XimcController, "reply_s", 0.2)
    stage = bench.homed()
    bench.lines[0].lose = lambda _request: True
    read, heard_s = bench.lines[0].read, []

    def slowly(timeout_s: float) -> bytes:
        time.sleep(timeout_s)
        return read(timeout_s)

    bench.lines[0].read = slowly
    bench.lines[1].before = lambda data: heard_s.append(time.monotonic()) if data == b"sstp" else None
    bench.tilt.receive(request("move", move_data(1000, 0)))
    bench.clock.sleep(0.1)
    began_s = time.monotonic()
    with pytest.raises(ReplyError):
        stage.stop()
    first_s, all_s = heard_s[0] - began_s, time.monotonic() - began_s
    assert all_s > 0.6  # three waits for the silent one
    assert first_s < 0.5 * all_s
    assert not bench.busy()
