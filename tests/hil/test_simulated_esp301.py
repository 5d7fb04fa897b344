"""The simulated Newport ESP301, line by line; test_wire_parity.py has it driven by an independent client."""

import pytest

from simulators.stages.axis_motion import MotionFault
from tests.hil.direct_stages import of_one_port


class Controller:
    """The controller on a clock that the test advances."""

    def __init__(self) -> None:
        self.now_s = 0.0
        self.device, _ = of_one_port("esp301", lambda: self.now_s)

    def say(self, line: str) -> list[str]:
        return self.device.receive(f"{line}\r".encode()).decode().split("\r\n")[:-1]

    def error(self) -> int:
        return int(self.say("TB?")[0].partition(",")[0])

    def wait(self, seconds: float = 60.0) -> list[str]:
        self.now_s += seconds
        return self.device.unsolicited().decode().split("\r\n")[:-1]


@pytest.fixture
def controller() -> Controller:
    return Controller()


@pytest.fixture
def homed(controller: Controller) -> Controller:
    controller.say("1MO;2MO;1OR1;2OR1")
    controller.wait()
    return controller


@pytest.mark.parametrize(
    ("line", "answers"),
    [
        ("VE?", ["ESP301 Version 3.0.1 6/1/99"]),
        ("1ID?", ["URS75BCC, SN100101"]),
        ("2ID?;1TP", ["URS75BCC, SN100102", "0.00000"]),
        ("1MO?", ["0"]),
        ("1SL?;1SR?;1SN?", ["-15", "15", "7"]),
        ("1va10;1VA?", ["10"]),
        ("1MO;1PA5", []),
        ("", []),
    ],
)
def test_only_questions_are_answered(controller: Controller, line: str, answers: list[str]):
    assert controller.say(line) == answers
    assert controller.error() == 0


@pytest.mark.parametrize(
    ("line", "number"),
    [
        ("1XY", 6),
        ("hello", 6),
        ("PA5", 37),
        ("3PA5", 9),
        ("1PA", 38),
        ("1PAfive", 101),
        ("1PA5", 113),
        ("2MO;2PA10.1", 206),
        ("2MO;2PA-10.1", 207),
        ("1VA500", 110),
        ("1AC5000", 111),
        ("1SR-5", 101),
        ("1OR9", 101),
    ],
)
def test_a_refusal_is_silent_and_waits_in_the_queue(controller: Controller, line: str, number: int):
    assert controller.say(line) == []
    assert controller.error() == number
    assert controller.error() == 0


def test_homing_may_not_be_disturbed_and_is_ended_by_stop(controller: Controller):
    controller.say("1MO;1OR1")
    controller.wait(0.05)
    controller.say("1PA1")
    assert controller.error() == 130
    controller.say("1ST")
    assert controller.error() == 120
    controller.wait()
    assert not controller.device.axes[1].axis.referenced(controller.now_s)


@pytest.mark.parametrize(("kind", "number"), [("stall", 203), ("limit", 204)])
def test_a_fault_of_motion_switches_the_motor_off(homed: Controller, kind, number: int):
    homed.device.axes[2].axis.arm(MotionFault(kind))
    homed.say("2PA10")
    homed.wait()
    assert homed.say("2MO?") == ["0"]
    assert homed.error() == number
