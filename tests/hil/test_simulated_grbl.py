"""The simulated GRBL gimbal: lines, real-time bytes, alarms, and axes that arrive together."""

import re
from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from simulators.stages.gcode import GcodeError, parse_block
from tests.hil.direct_stages import of_one_port

BANNER = "\r\nGrbl 1.1h ['$' for help]\r\n"
LOCKED = "[MSG:'$H'|'$X' to unlock]\r\n"
REPORT = re.compile(
    r"<(\w+(?::\d)?)\|MPos:(-?\d+\.\d{3}),(-?\d+\.\d{3}),(-?\d+\.\d{3})\|FS:(\d+),0[^>]*>\r\n"
)


class Board:
    """The controller on a clock that the test advances in steps, as its own port would."""

    def __init__(self) -> None:
        self.now_s = 0.0
        self.device, _ = of_one_port("grbl", lambda: self.now_s)
        self.greeting = self.device.unsolicited().decode()

    def say(self, *lines: str) -> str:
        return "".join(self.device.receive(f"{line}\n".encode()).decode() for line in lines)

    def press(self, byte: bytes) -> str:
        return self.device.receive(byte).decode()

    def wait(self, seconds: float = 30.0) -> str:
        answer = ""
        for _ in range(300):
            self.now_s += seconds / 300
            answer += self.device.unsolicited().decode()
        return answer

    def report(self) -> tuple[str, float, float]:
        match = REPORT.fullmatch(self.press(b"?"))
        assert match
        return match[1], float(match[2]), float(match[3])

    def angle(self, letter: str) -> float:
        return self.device.axes[letter].pointing.angle_deg(self.now_s)


@pytest.fixture
def board() -> Board:
    return Board()


@pytest.fixture
def homed(board: Board) -> Board:
    assert board.say("$H") == ""
    assert board.wait() == "ok\r\n"
    return board


def test_a_reset_in_motion_is_an_alarm_and_loses_steps(homed: Board):
    homed.say("G0 X-21")
    homed.wait(0.4)
    assert homed.press(b"\x18") == "ALARM:3\r\n"
    assert homed.wait() == BANNER + LOCKED
    state, x, _ = homed.report()
    assert state == "Alarm"
    assert homed.angle("X") != pytest.approx(x + 16.0, abs=0.01)


# ---------------------------------------------------------------- refusals and alarms
@pytest.mark.parametrize(
    ("line", "answer"),
    [
        ("G1 X-5", "error:22"),
        ("G0 X", "error:2"),
        ("5", "error:1"),
        ("G1.5 X1", "error:23"),
        ("F-5", "error:4"),
        ("G21 G90 G91", "error:21"),
        ("Q1", "error:20"),
        ("G0 G1 X1", "error:24"),
        ("G0 X1 X2", "error:25"),
        ("$Q", "error:2"),
        ("$100", "error:3"),
        ("$100=", "error:2"),
        ("$999=1", "error:3"),
        ("$130=-1", "error:4"),
        ("$J=X-100 F100", "error:15"),
        ("$J=X-5", "error:22"),
        ("$J=G1 X-5 F100", "error:16"),
        ("G0" + "X" * 78, "error:11"),
        ("(" + "x" * 90 + ")", "ok"),
        ("$J", "error:3"),
        ("F100", "ok"),
        ("(a comment) ; and more", "ok"),
        ("", "ok"),
    ],
)
def test_an_invalid_line_is_refused_by_number(homed: Board, line: str, answer: str):
    assert homed.say(line) == answer + "\r\n"
    assert homed.report() == ("Idle", -1.0, -1.0)


def test_a_target_beyond_the_travel_is_an_alarm_that_only_a_reset_ends(homed: Board):
    assert homed.say("G0 X-33") == "ALARM:2\r\n"
    assert homed.wait(1.0) == "[MSG:Reset to continue]\r\n"
    assert homed.say("$X") == ""
    assert homed.press(b"\x18") == "ok\r\n" + BANNER + LOCKED
    assert homed.say("$X") == "[MSG:Caution: Unlocked]\r\nok\r\n"
    assert homed.report() == ("Idle", -1.0, -1.0)


@given(st.text(alphabet="GXYFMP$J=-.0123456789 ();", max_size=30))
def test_any_block_is_taken_or_refused_by_number(line: str):
    with suppress(GcodeError):
        assert set(parse_block(line).targets) <= set("XYZ")


def test_a_reset_while_homing_is_an_alarm_an_ok_and_a_restart(homed: Board):
    homed.say("G0 X-21")
    homed.wait()
    homed.say("$H")
    homed.wait(0.1)
    assert homed.press(b"\x18") == "ALARM:6\r\n"
    assert homed.wait(1.0) == "ok\r\n" + BANNER + LOCKED
