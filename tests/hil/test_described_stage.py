"""Stages by description, beyond what every family is tried with: what opening sends, stops while homing, scales."""

from dataclasses import replace

import numpy as np
import pytest

from drivers.described.description import Exchange, parse_template
from drivers.errors import DeviceRefused, NotHomed, OutsideLimits, ReplyGarbled, ReplyTimeout
from drivers.light import LightSettings
from drivers.light.text import TextLight
from drivers.stage import AxisLimits
from drivers.stage.text import TextAxis, TextStage
from simulators.faults.line_faults import LineFault
from tests.hil.direct_lights import MICROCONTROLLER, direct_light
from tests.hil.direct_stages import FAMILIES, FLIR_PTU, LIMITS, DirectStage, VirtualClock

pytestmark = pytest.mark.usefixtures("never_late")


@pytest.fixture
def rig(clock) -> DirectStage:
    return FAMILIES["flir"](clock, np.random.default_rng(2))


def again(rig: DirectStage, axis: TextAxis, description=FLIR_PTU) -> TextStage:
    return TextStage(rig.line, [axis], description, serial="E1042", clock=rig.line.clock)


def axis(**more) -> TextAxis:
    return TextAxis(**{"name": "pan", "address": "P", "counts_per_deg": 800.0, "limits": LIMITS, **more})


def words_of(rig: DirectStage) -> set[str]:
    return {data.decode().strip().rstrip("-0123456789") for data in rig.line.sent}


def test_opening_asks_and_a_homing_sets_and_only_a_homing_sends_what_moves(rig) -> None:
    rig.line.sent.clear()
    stage = again(rig, axis())
    assert words_of(rig) == {"?", "EE", "FT", "V", "VS", "PD", "PP"}
    rig.line.sent.clear()
    stage.home()
    assert words_of(rig) == {
        *("VS", "PD", "PP", "PR", "PN", "PX", "H", "CI", "I", "RP", "PNU", "PXU", "PA", "PS", "LU")
    }
    assert not any(data.startswith(b"PP") and data != b"PP " for data in rig.line.sent)


def test_each_mode_is_set_between_two_stops(rig) -> None:
    """In the mode that another program has left, the setting of a mode may be a motion."""
    stage = again(rig, axis())
    rig.line.sent.clear()
    stage.home()
    assert b"H CI H H I H " in b"".join(rig.line.sent)


def test_a_silent_stage_gets_the_stop_twice_and_is_told_within_three_seconds(rig, clock) -> None:
    rig.line.device.inject(LineFault("lost", count=None))
    began_s = clock.now_s
    with pytest.raises(ReplyTimeout):
        rig.stage.stop()
    assert rig.line.sent.count(b"H ") == 2
    assert clock.now_s - began_s < 3.0


def test_a_query_that_became_a_command_is_noticed_before_the_next_move(rig) -> None:
    rig.stage.home()
    rig.stage.move_to({"pan": 10.0})
    rig.line.write(b"RP ")  # PP, with one bit changed on its way
    rig.line.clock.sleep(10.0)
    assert rig.stage.position_deg()["pan"] == pytest.approx(rig.true_deg(), abs=0.01)
    with pytest.raises(NotHomed):
        rig.stage.move_to({"pan": 1.0})
    assert rig.stage.faults() == []


@pytest.mark.parametrize(
    ("changes", "fault"),
    [
        ({"counts_per_deg": 801.0}, "the station file gives 801 counts per degree, the controller 800"),
        ({"limits": AxisLimits(-15.0, 15.5, 20.0, 100.0)}, "but the controller allows only"),
        ({"zero_deg": 3.0}, "but the controller allows only"),
    ],
)
def test_a_station_that_contradicts_the_device_is_refused(rig, changes, fault) -> None:
    stage = again(rig, axis(**changes))
    with pytest.raises(OutsideLimits, match=fault):
        stage.home()
    assert not stage.is_homed()


def test_a_reversed_axis_turns_the_other_way(rig) -> None:
    rig.see_it_home_and_move(again(rig, axis(counts_per_deg=-800.0)), 5.0, off_deg=-10.0)


def test_a_refusal_says_what_the_device_said_and_an_unknown_setting_is_one(rig) -> None:
    fast = axis(limits=AxisLimits(-15.0, 15.0, 150.0, 100.0))
    before_deg = rig.true_deg()
    with pytest.raises(DeviceRefused, match="80000 pos/sec"):
        again(rig, fast).home()
    assert rig.true_deg() == before_deg
    wrong = parse_template("QQ", known=frozenset(), readable=None)
    with pytest.raises(DeviceRefused, match="'QQ': Illegal command"):
        again(rig, axis(), replace(FLIR_PTU, setup=(Exchange(wrong, wrong),))).home()


def test_a_setting_may_have_another_unit_than_the_counter(rig) -> None:
    speed = FLIR_PTU.settings[3]
    assert speed.quantity == "speed"
    halved = replace(FLIR_PTU, settings=(*FLIR_PTU.settings[:3], replace(speed, factor=0.5)))
    again(rig, axis(), halved).home()
    assert rig.line.sent.count(b"PS8000 ") == 1  # 20 deg/s of 800 counts a degree, halved


def test_a_restart_at_zero_shows_in_the_settings_alone(rig) -> None:
    stage = again(rig, axis(limits=AxisLimits(-14.0, 14.0, 20.0, 100.0)))
    stage.home()
    stage.move_to({"pan": 0.0})
    rig.order("pan reboot")
    rig.line.clock.sleep(5.0)
    assert stage.position_deg()["pan"] == 0.0
    assert not stage.is_homed()


@pytest.mark.parametrize("echo", [b"%s\r\n%s ", b"%s \n"])
def test_an_echo_in_a_line_of_its_own_and_a_line_feed_after_an_echo_are_no_replies(rig, echo) -> None:
    """Panthyr's PTU-D48 answers a carriage return by a line feed; terminals of firmwares repeat each line."""

    def echoed(reply: bytes) -> bytes:
        request, star, rest = reply.partition(b" ")
        return echo.replace(b"%s", request) + rest if star else reply

    rig.line.spoil = lambda reply: b"".join(map(echoed, reply.splitlines(keepends=True)))
    rig.see_it_home_and_move(again(rig, axis()))


@pytest.mark.parametrize(
    ("described", "sent"),
    [
        (b"\r", b"\r\n"), (b"\n", b"\r\n"), (b"\n", b"\n\r"), (b"\r\n", b"\r\n\r\n"), (b"\r\n", b"\0\r\n"),
    ],
)  # fmt: skip
def test_more_or_less_of_a_line_end_than_described_is_no_reply(rig, described, sent) -> None:
    """Manuals call CR LF a carriage return; firmwares print both in another order, or twice."""
    rig.line.spoil = lambda reply: reply.replace(b"\r\n", sent)
    rig.line.sent.clear()
    ends = replace(FLIR_PTU, line=replace(FLIR_PTU.line, reply_end=described))
    rig.see_it_home_and_move(again(rig, axis(), ends))
    assert rig.line.sent.count(b"V ") == 1  # nothing brought the line out of step


def test_another_line_end_than_described_is_named(rig) -> None:
    rig.line.spoil = lambda reply: reply.replace(b"\r\n", b"\n")
    with pytest.raises(ReplyTimeout, match="ends in LF") as error:
        again(rig, axis())
    assert "reply_end" in error.value.remedy


@pytest.mark.parametrize(("starts_s", "opens"), [(2.9, True), (9.0, False)])
def test_a_board_that_restarts_when_its_port_is_opened_is_waited_for(starts_s, opens) -> None:
    """An Arduino Uno does; its boot loader is deaf for up to two seconds."""
    clock = VirtualClock()
    rig = direct_light("microcontroller", clock, np.random.default_rng(2))
    awake_s, receive = clock.now_s + starts_s, rig.line.device.receive
    rig.line.device.receive = lambda data: receive(data) if clock.now_s >= awake_s else b""
    if opens:
        TextLight(rig.line, MICROCONTROLLER, serial="SG0042", clock=clock).close()
        return
    with pytest.raises(ReplyTimeout):
        TextLight(rig.line, MICROCONTROLLER, serial="SG0042", clock=clock)
    assert clock.now_s < awake_s


@pytest.mark.parametrize(("frequency_hz", "duty_percent"), [(3232, 1), (4999, 99), (4999.3, 50), (0.5, 1)])
def test_a_light_makes_all_that_it_says_it_can_make(frequency_hz, duty_percent) -> None:
    """365 whole frequencies up to 5000 Hz were refused for the rounding to ticks of a timer."""
    light = direct_light("microcontroller", VirtualClock(), np.random.default_rng(2)).light
    got = light.apply(LightSettings(frequency_hz=frequency_hz, duty_percent=duty_percent))
    assert got.frequency_hz == pytest.approx(frequency_hz, rel=1.6e-4)
    assert got.duty_percent == pytest.approx(duty_percent, rel=0.016)


def test_a_reply_with_another_digit_does_not_pass_its_checksum() -> None:
    rig = direct_light("microcontroller", VirtualClock(), np.random.default_rng(2))
    rig.light.apply(LightSettings(frequency_hz=50.0))
    rig.line.device.inject(LineFault("replaced", count=None, pattern=b"= 50", replacement=b"= 51"))
    with pytest.raises(ReplyGarbled, match="without its checksum"):
        rig.light.read()
