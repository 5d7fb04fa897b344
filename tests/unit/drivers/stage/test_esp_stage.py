"""The ESP stage on its simulated controller: what it sends, what it refuses, and what it says of a fault."""

import re

import pytest

from drivers.errors import DeviceRefused, DriverError, MoveFailed, NotHomed, OutsideLimits, ReplyError
from drivers.stage import AxisLimits
from drivers.stage.esp import EspAxis, EspStage
from simulators.stages.axis_motion import AxisModel, Mechanics, MotionFault
from simulators.stages.esp301 import EspController
from tests.hil.direct_stages import HomedStage, VirtualClock, direct_line

pytestmark = pytest.mark.usefixtures("never_late")

LIMITS = AxisLimits(-15.0, 15.0, 10.0, 50.0)
AXES = [
    EspAxis(name="pan", number=1, serial="SN1263", limits=LIMITS),
    EspAxis(name="tilt", number=2, serial="1264", limits=LIMITS, direction=-1, zero_deg=2.0),
]


class Bench(HomedStage):
    """A controller of two axes on a line, and the driver for it."""

    def __init__(self) -> None:
        self.clock = VirtualClock()
        mechanics = Mechanics(10_000.0, -22.0, 22.0, start_deg=3.0)
        models = [AxisModel(mechanics, serial, 20.0, name="URS75CC") for serial in ("1263", "1264")]
        self.controller = EspController(models, self.clock.monotonic)
        self.line = direct_line(self.controller, self.clock)
        self.pan, self.tilt = self.controller.axes[1], self.controller.axes[2]

    def open(self) -> EspStage:
        return EspStage(self.line, AXES, clock=self.clock)

    def motions(self) -> list[str]:
        sent = b"".join(self.line.sent).decode().split("\r")
        return [text for text in sent if re.match(r"\d(PA|PR|OR|MV)[^?]*$", text)]

    def answer(self, query: str, *answers: str) -> None:
        """Let the controller answer a query otherwise, in turn; STAMP is the time that it would have told."""
        left = list(answers)

        def spoil(reply: bytes) -> bytes:
            if not left or self.line.sent[-1] != f"{query}\r".encode():
                return reply
            stamp = reply.decode().split(", ")[1]
            answer = left.pop(0) if len(left) > 1 or answers[1:] else left[0]
            return answer.replace("STAMP", stamp).encode() + b"\r\n"

        self.line.spoil = spoil


@pytest.fixture
def bench() -> Bench:
    return Bench()


# ---------------------------------------------------------------- the good case
def test_opening_moves_nothing_and_programs_the_controller(bench) -> None:
    bench.open()
    assert bench.motions() == []
    programmed = {"SN": 7.0, "SL": -15.0, "SR": 15.0, "VA": 10.0, "AC": 50.0, "AG": 50.0}
    assert bench.pan.settings.items() >= programmed.items()
    assert (bench.tilt.settings["SL"], bench.tilt.settings["SR"]) == (-13.0, 17.0)
    assert not bench.pan.motor_on


def test_homing_powers_the_motors_first(bench) -> None:
    stage = bench.open()
    assert stage.faults() == ["pan: motor off", "tilt: motor off"]
    stage.home()
    assert stage.faults() == []
    assert stage.position_deg() == pytest.approx({"pan": 0.0, "tilt": 2.0}, abs=1e-3)
    assert bench.motions() == ["1OR1", "2OR1"]


# ---------------------------------------------------------------- refused before anything moves


@pytest.mark.parametrize(
    ("setting", "value", "error", "message"),
    [
        ("SN", 2.0, OutsideLimits, "1SN7"),
        ("SR", 12.0, OutsideLimits, r"-15 to 15 deg, but the controller allows only -20 to 12 deg\."),
        ("VU", 5.0, DeviceRefused, r"'1VA10\.00000': speed beyond its maximum \(error 110\)"),
    ],
)
def test_what_does_not_fit_the_controller_is_refused(bench, setting, value, error, message) -> None:
    bench.pan.settings[setting] = value
    with pytest.raises(error, match=message):
        bench.open()


def test_a_setting_that_reads_back_otherwise_is_refused(bench) -> None:
    bench.line.lose_next(b"1SL-15")
    with pytest.raises(DeviceRefused, match=r"SL .* -15, .* -20"):
        bench.open()


def test_a_motor_that_does_not_go_on_is_not_homed(bench) -> None:
    stage = bench.open()
    bench.line.lose_next(b"1MO\r")
    with pytest.raises(MoveFailed, match="the motor stays off"):
        stage.home()
    assert bench.motions() == []


@pytest.mark.parametrize("answer", ["no error", "0", "0, x, NO ERROR DETECTED", "204, 1, POSITIVE LIMIT"])
def test_an_error_buffer_of_another_form_or_without_end_is_refused(bench, answer) -> None:
    stage = bench.open()
    bench.answer("TB?", answer)
    with pytest.raises(ReplyError):
        stage.faults()


def test_the_controllers_errors_are_told_once_in_plain_words(bench) -> None:
    stage = bench.homed()
    bench.answer("TB?", "209, STAMP, FEEDBACK SIGNAL FAULT DETECTED", "7, STAMP, PARAMETER OUT OF RANGE")
    assert stage.faults() == ["feedback signal lost (error 209)", "parameter out of range (error 7)"]
    assert stage.faults() == []


# ---------------------------------------------------------------- noticed in mid-move
def cut_the_motors(bench: Bench) -> None:
    bench.pan.motor_on = bench.tilt.motor_on = False


@pytest.mark.parametrize(
    ("event", "message"),
    [
        (lambda bench: bench.pan.axis.halt(bench.clock.now_s), "pan: stopped at .* from its target 9"),
        (cut_the_motors, "motor went off, as after a fault or a restart"),
        (
            lambda bench: bench.answer("TB?", "103, STAMP, FOLLOWING ERROR", "0, STAMP, NO ERROR DETECTED"),
            r"following error beyond its threshold \(error 103\)",
        ),
    ],
)
def test_a_move_that_goes_wrong_is_noticed_and_all_axes_are_stopped(bench, event, message) -> None:
    stage = bench.homed()
    bench.line.once_moving(b"2PA", lambda: event(bench))
    with pytest.raises(MoveFailed, match=message):
        stage.move_to({"pan": 9.0, "tilt": 9.0})
    assert b"ST\r" in bench.line.sent
    bench.clock.sleep(1.0)
    assert not bench.tilt.axis.busy(bench.clock.now_s)


def test_a_restart_is_noticed_by_the_controllers_clock_even_at_its_own_zero(bench) -> None:
    stage = bench.homed()
    stage.move_to({"pan": 9.0})
    bench.line.once_moving(b"1PA", lambda: bench.answer("TB?", "0, 5, NO ERROR DETECTED"))
    with pytest.raises(MoveFailed, match="restarted during the move"):
        stage.move_to({"pan": 0.0})
    assert not stage.is_homed()


def test_homing_that_is_aborted_has_failed(bench) -> None:
    stage = bench.open()
    bench.pan.axis.arm(MotionFault("stop_short"))
    aborted = ("120, STAMP, HOMING ABORTED", "0, STAMP, NO ERROR DETECTED")
    bench.line.once_moving(b"1OR1", lambda: bench.answer("TB?", *aborted), after_s=0.05)
    with pytest.raises(DriverError, match="homing aborted"):
        stage.home()
    assert not stage.is_homed()


# ---------------------------------------------------------------- what befalls the second axis
def test_an_error_of_the_second_axis_is_not_lost_by_asking_about_the_first(bench) -> None:
    stage = bench.homed()

    def late_error(command: bytes) -> None:
        arrived = bench.motions() and not bench.tilt.axis.busy(bench.clock.now_s)
        if command == b"1MO?\r" and arrived:
            bench.answer("TB?", "203, STAMP, FOLLOWING ERROR", "0, STAMP, NO ERROR DETECTED")
            bench.line.before = lambda _command: None

    bench.line.before = late_error
    with pytest.raises(MoveFailed, match="following error"):
        stage.move_to({"pan": 5.0, "tilt": 5.0})
    assert not stage.is_homed()


def test_an_error_of_an_axis_that_is_not_ours_is_none_of_ours(bench) -> None:
    stage = bench.homed()

    def always_one(command: bytes) -> None:
        if command == b"2TP\r":
            bench.answer("TB?", "308, STAMP, STAGE NOT CONNECTED", "0, STAMP, NO ERROR DETECTED")

    bench.line.before = always_one
    stage.move_to({"pan": 5.0, "tilt": 5.0})
    assert stage.position_deg() == pytest.approx({"pan": 5.0, "tilt": 5.0}, abs=1e-3)


def test_the_first_axis_alone_is_no_reference(bench) -> None:
    """The line fails while the second axis's homing is looked at: nobody knows how that one ended."""
    stage = bench.open()
    looks = 0

    def dies_at_the_last_look(reply: bytes) -> bytes:
        nonlocal looks
        at_rest = not any(controller.axis.busy(bench.clock.now_s) for controller in (bench.pan, bench.tilt))
        looks += at_rest and bench.line.sent[-1] == b"2MD?\r"
        return b"" if looks > 2 else reply

    bench.line.spoil = dies_at_the_last_look
    with pytest.raises(ReplyError):
        stage.home()
    bench.line.spoil = lambda reply: reply
    assert not stage.is_homed()
    with pytest.raises(NotHomed):
        stage.move_to({"pan": 1.0})


def test_every_axis_of_ours_is_stopped_by_its_number_as_well(bench) -> None:
    """Should a controller take ``ST`` without a number for a mistake, it moves on for no longer than a line lasts."""
    stage = bench.homed()
    bench.line.lose = lambda data: data == b"ST\r"
    bench.controller.receive(b"1PA12\r2PA12\r")
    bench.line.sent.clear()
    stage.stop()
    assert bench.line.sent[:3] == [b"ST\r", b"1ST\r", b"2ST\r"]
    bench.clock.sleep(1.0)
    assert not any(controller.axis.busy(bench.clock.now_s) for controller in (bench.pan, bench.tilt))
    assert max(stage.position_deg()["pan"], -stage.position_deg()["tilt"]) < 9.0


# ---------------------------------------------------------------- a line that lies


@pytest.mark.parametrize("answer", [b"1\r\n", b"9.0e999\r\n"])
def test_the_answer_to_another_question_and_what_is_beyond_all_numbers_is_no_position(bench, answer) -> None:
    stage = bench.homed()
    stage.move_to({"pan": -1.0})
    bench.line.spoil = lambda reply: answer if bench.line.sent[-1] == b"1TP\r" else reply
    with pytest.raises(ReplyError, match="number with decimals"):
        stage.position_deg()
