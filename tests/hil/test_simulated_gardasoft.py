"""The simulated Gardasoft RT: what it answers, what it holds within range, and what the light does."""

import pytest

from simulators.lights.gardasoft import OVER_CURRENT, GardasoftRt
from tests.hil.direct_lights import LightAlone


@pytest.fixture
def strobe() -> LightAlone:
    return LightAlone(GardasoftRt, "\r")


@pytest.mark.parametrize(
    ("line", "answer"),
    [
        ("", ">"),
        ("XX1", "Err 2\r\n>"),
        ("hello!", "Err 2\r\n>"),
        ("RT1,5,1", "Err 4\r\n>"),
        ("RS9,5", "Err 1\r\n>"),
        ("RS1,bright", "Err 3\r\n>"),
        ("RT1,5hours,1,50", "Err 3\r\n>"),
        ("RT1,5,0,50", "Err 5\r\n>"),
        ("RS1,120", "Err 5\r\n>"),
        ("TT2", "Err 1\r\n>"),
        ("TT", "Err 4\r\n>"),
        (
            "rs 1, 50 ; st 1",
            "CH 1, MD 0, S 50.0%, DL 0.005ms, PU 1.000ms, RT 0.000ms, IP 1, FL 0, CS 1.000A, RA 1.000A\r\n>",
        ),
        ("TT1,500us;ST0", "TM 1, TP 0.500ms\r\n>"),
    ],
)
def test_a_line_is_answered_and_ends_in_its_prompt(strobe: LightAlone, line: str, answer: str):
    assert strobe.say(line) == answer


def test_continuous_light_is_steady_and_pulses_need_the_trigger(strobe: LightAlone):
    strobe.say("RS1,40")
    assert (strobe.light.output, strobe.light.low, strobe.light.high) == (True, 0.4, 0.4)
    strobe.say("RT1,5,1,40")
    assert not strobe.light.output
    strobe.say("TT1,10")
    light = strobe.light
    assert (light.output, light.low, light.high, light.duty_percent) == (True, 0.0, 0.4, 50.0)
    strobe.say("TT0")
    assert (strobe.light.output, strobe.light.sync) == (False, False)


def test_a_protection_switches_off_and_is_reported_on_request(strobe: LightAlone):
    strobe.say("RS1,100")
    strobe.device.trip(OVER_CURRENT)
    assert not strobe.light.output
    assert strobe.device.unsolicited() == b""
    assert strobe.say("GR") == "Evt1,131;\r\n>"
    assert strobe.light.output
    assert strobe.say("GR") == ">"
