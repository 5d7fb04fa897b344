"""The GRBL stage on its simulated board: what it sends, what it refuses, and how it stops.

``tests/hil/test_every_fault.py`` shows what each family does with faults of axis and line.
"""

import pytest

from drivers.errors import (
    DeviceRefused,
    DriverError,
    MoveFailed,
    MoveTimeout,
    NotHomed,
    OutsideLimits,
    ReplyError,
    ReplyGarbled,
    ReplyTimeout,
)
from drivers.stage import grbl_controller
from drivers.stage.grbl_protocol import parse_report
from simulators.stages.axis_motion import MotionFault
from simulators.stages.grbl_planner import Planner
from tests.unit.drivers.stage.grbl_bench import CANCEL, JOG, RESET, Bench

pytestmark = pytest.mark.usefixtures("never_late")


@pytest.fixture
def bench() -> Bench:
    return Bench()


def test_a_cut_report_is_no_report() -> None:
    assert parse_report(b"<Idle|MPos:0.000,0.000|FS:0\r\n") is None
    assert parse_report(b"<Idle|MPos:0.000,0.000|FS:0,0\n") is None


def test_a_hold_moves_until_it_is_complete() -> None:
    assert parse_report(b"<Hold:1|MPos:0.000,0.000|FS:0,0>\r\n").moving
    assert not parse_report(b"<Hold:0|MPos:0.000,0.000|FS:0,0>\r\n").moving


# ---------------------------------------------------------------- the good case
def test_opening_moves_nothing_and_programs_what_differs(bench) -> None:
    bench.board.settings[13] = 1.0  # inches
    stage = bench.open()
    assert stage.axes == ("pan", "tilt")
    assert bench.motions() == []
    assert (bench.board.settings[20], bench.board.settings[13]) == (1, 0)
    assert [bench.board.settings[number] for number in (110, 120, 130)] == [600.0, 50.0, 33.0]
    bench.line.sent.clear()
    bench.open()
    assert not bench.wrote_settings()


# ---------------------------------------------------------------- refused before anything moves


@pytest.mark.parametrize(
    ("number", "value", "error", "message"),
    [
        (22, 0, DeviceRefused, r"\$22=0"),
        (101, 80.0, OutsideLimits, r"100 steps a degree, the controller 80\..*\$101"),
        (130, 30.0, OutsideLimits, r"but the controller allows only -12 to 18 deg\."),
        (23, 1, OutsideLimits, r"pan: .*\$23=1"),  # it homes downwards: its zero lies where its travel ends
        (23, 2, OutsideLimits, r"tilt: .*\$23=2"),
        (23, 3, OutsideLimits, r"pan: .*\$23=3"),
    ],
)
def test_a_board_that_is_not_made_for_it_is_refused(bench, number, value, error, message) -> None:
    bench.board.settings[number] = value
    before = dict(bench.board.settings)
    with pytest.raises(error, match=message):
        bench.open()
    assert bench.board.settings == before
    assert bench.motions() == []


def test_how_an_axis_homes_that_is_not_ours_is_none_of_ours(bench) -> None:
    bench.board.settings[23] = 2
    assert bench.open("X").axes == ("pan",)


def test_a_setting_that_reads_back_otherwise_is_refused(bench) -> None:
    receive = bench.line.device.receive
    bench.line.device.receive = lambda data: receive(b"\n" if data.startswith(b"$110=") else data)
    with pytest.raises(DeviceRefused, match=r"\$110: asked 600\.000, got"):
        bench.open()


@pytest.mark.parametrize(
    ("state", "fault"),
    [
        *((state, state[:4]) for state in ("Run", "Hold:0", "Door:0", "Check", "Sleep")),
        ("Waxing", r"in a state that is unknown here \(Waxing\)"),
    ],
)
def test_a_board_in_another_state_is_left_alone(bench, state, fault) -> None:
    stage = bench.homed()
    bench.report_as(state)
    with pytest.raises(MoveFailed, match=fault):
        stage.move_to({"pan": 1.0})
    assert bench.motions() == []


def test_an_axis_the_board_does_not_have_is_refused(bench) -> None:
    with pytest.raises(DriverError):
        bench.open("A")


# ---------------------------------------------------------------- noticed in mid-move
def restart_silently(bench: Bench) -> None:
    bench.board.restart(bench.clock.now_s)
    bench.board.unsolicited()  # its welcome message is lost


@pytest.mark.parametrize(
    ("event", "message"),
    [
        (lambda bench: bench.somebody_says(CANCEL), "stopped at .* from its target -9"),
        (lambda bench: bench.board.restart(bench.clock.now_s), "the board restarted during the move"),
        (restart_silently, "in alarm"),
        (lambda bench: bench.report_as("Door:0"), "safety door"),
        (lambda bench: bench.report_as("Hold:0"), "held"),
        (lambda bench: bench.report_as("Sleep"), "asleep"),
    ],
)
def test_a_move_that_goes_wrong_is_noticed(bench, event, message) -> None:
    stage = bench.homed()
    bench.line.once_moving(b"$J", lambda: event(bench))
    with pytest.raises(MoveFailed, match=message):
        stage.move_to({"pan": -9.0, "tilt": -9.0})


def test_a_board_that_waits_for_a_reset_at_a_limit_is_named_at_once_and_homing_resets_it(bench) -> None:
    """After these alarms the firmware answers nothing, not even ``?``, and forgets a reset for half a second."""
    stage = bench.homed()
    bench.board.axes["X"].arm(MotionFault("limit"))
    with pytest.raises(MoveFailed, match=r"\(ALARM:1\)") as caught:
        stage.move_to({"pan": -9.0, "tilt": -9.0})
    assert "limit switch" in caught.value.remedy
    assert RESET not in bench.line.sent
    stage.stop()  # it has stopped already
    fault, reference = stage.faults()
    assert "ALARM:1" in fault
    assert reference == "board: no reference"
    with pytest.raises(MoveFailed, match="ALARM:1"):
        stage.move_to({"pan": 0.0})
    stage.home()
    assert bench.line.sent.count(RESET) == 2  # the first came too soon, and was sent again
    assert stage.faults() == []
    bench.somebody_says(b"G0X-99\n")
    assert "ALARM:2" in stage.faults()[0]
    bench.clock.sleep(1.0)
    stage.home()
    assert bench.line.sent.count(RESET) == 3
    stage.move_to({"pan": -9.0, "tilt": -9.0})


def test_a_board_that_is_mute_at_opening_is_reset(bench) -> None:
    bench.board.receive(b"$20=1\n$X\nG0X-99\n")
    bench.clock.sleep(1.0)
    stage = bench.open()
    assert bench.line.sent.count(RESET) == 1
    assert "board: no reference" in stage.faults()
    stage.home()
    stage.move_to({"pan": -9.0})


def test_a_board_that_is_held_is_reset_before_it_is_asked_anything_else(bench) -> None:
    """Also one that has not come to rest yet: a held board answers no line."""
    bench.report_as("Hold:1")
    bench.line.before = lambda data: bench.change(lambda line: line) if data == RESET else None
    bench.open()
    assert bench.line.sent[:2] == [b"?", RESET]


def test_a_board_that_stays_mute_is_told_with_every_cause(bench, monkeypatch) -> None:
    monkeypatch.setattr(grbl_controller, "WAKE_SILENCES", 3)
    bench.line.lose = lambda _request: True
    bench.board.unsolicited()
    with pytest.raises(ReplyTimeout, match="welcome message") as caught:
        bench.open()
    assert "baud rate" in caught.value.remedy


def test_an_alarm_since_homing_undoes_the_reference(bench) -> None:
    stage = bench.homed()
    bench.somebody_says(JOG)
    bench.clock.sleep(0.2)
    bench.somebody_says(RESET)
    bench.clock.sleep(1.0)
    bench.somebody_says(b"$X\n")
    assert not stage.is_homed()
    with pytest.raises(NotHomed):
        stage.move_to({"pan": 1.0})


# ---------------------------------------------------------------- homing that fails
def test_homing_that_does_not_find_its_switch_has_failed(bench, monkeypatch) -> None:
    monkeypatch.setattr(Planner, "homed", lambda _self, _now: False)
    stage = bench.open()
    with pytest.raises(MoveFailed, match=r"\(ALARM:9\)"):
        stage.home()
    assert not stage.is_homed()


def test_homing_that_never_ends_is_reset(bench, monkeypatch) -> None:
    stage = bench.open()
    bench.line.lose_next(b"$H")
    with pytest.raises(MoveTimeout, match="homing has not ended"):
        stage.home()
    assert RESET in bench.line.sent


# ---------------------------------------------------------------- a line that lies
MUTATIONS = {
    "echo": lambda line: b"?" + line,
    "no ok": lambda line: b"" if line == b"ok\r\n" else line,
    "ok twice": lambda line: line + line if line == b"ok\r\n" else line,
    "OK in capitals": lambda line: line.upper(),
    "work positions": lambda line: line.replace(b"MPos", b"WPos"),
    "no version": lambda line: line.replace(b"[VER:", b"[NOT:"),
    "no end": lambda line: 600 * b"$0=1\r\n" if line.startswith(b"[VER:") else line,
}


@pytest.mark.parametrize("name", MUTATIONS)
def test_a_board_with_one_thing_wrong_is_refused(bench, name) -> None:
    bench.change(MUTATIONS[name])
    fault = {"no version": "has no version", "no end": "never ends", "work positions": r"\$10=1"}.get(name)
    with pytest.raises(ReplyError, match=fault):
        bench.open()
    assert bench.motions() == []


@pytest.mark.parametrize("mask", [0.0, 2.0])
def test_a_board_that_another_program_told_to_report_work_positions_is_told_otherwise(bench, mask) -> None:
    """Some senders set $10=2."""
    bench.board.settings[10] = mask
    bench.change(lambda line: line if int(bench.board.settings[10]) & 1 else line.replace(b"MPos", b"WPos"))
    stage = bench.homed()
    assert bench.board.settings[10] == mask + 1
    assert stage.position_deg()["pan"] == pytest.approx(17.0)


@pytest.mark.parametrize(
    ("report", "fault"),
    [
        (b"<Idle,MPos:0.000,0.000,0.000,WPos:0.000,0.000,0.000>\r\n", "Grbl 0.9 reports otherwise"),
        (b"<Idle|M:0.000,0.000,0.000|F:0>\r\n", "no machine position"),
    ],
)
def test_a_firmware_with_another_form_of_report_is_named_and_not_the_cable(bench, report, fault) -> None:
    bench.change(lambda line: report if line.startswith(b"<") else line)
    with pytest.raises(ReplyGarbled, match=fault) as caught:
        bench.open()
    assert "cable" not in str(caught.value)
    assert bench.motions() == []


def test_half_a_line_from_before_us_is_never_completed_into_a_motion(bench) -> None:
    bench.board.receive(b"$X\n" + JOG.rstrip())
    bench.open()
    bench.clock.sleep(1.0)
    assert bench.board.axes["X"].pointing.angle_deg(bench.clock.now_s) == pytest.approx(10.0)


def test_a_refusal_is_not_taken_for_the_ok_that_shows_the_line_in_step(bench) -> None:
    bench.line.spoil = lambda reply: b"error:2\r\n" if bench.line.sent[-1] == b"\n" else reply
    with pytest.raises(ReplyGarbled, match="answers an empty line"):
        bench.open()
