"""A Thorlabs stage as another program has left it: its zero, its speeds and its words."""

import struct
from dataclasses import replace

import pytest

from drivers.errors import DeviceRefused, MoveFailed, MoveTimeout
from drivers.stage import thorlabs_messages as apt
from drivers.stage.thorlabs import ThorlabsAxis, ThorlabsStage
from simulators.stages.axis_motion import AxisModel, Mechanics
from simulators.stages.thorlabs_apt import AptController
from tests.hil.direct_stages import (
    K10CR1_COUNTS_PER_DEG,
    LIMITS,
    PRM1Z8_COUNTS_PER_DEG,
    DirectLine,
    DirectStage,
    VirtualClock,
    direct_line,
    rig_of,
)

pytestmark = pytest.mark.usefixtures("never_late")


# ---------------------------------------------------------------- Thorlabs


def home_message(rig: DirectStage, *, direction=2, switch=1, speed_deg_s=10.0, offset_deg=4.0) -> bytes:
    """Home parameters as another program sends them."""
    scale = abs(rig.controller.model.mechanics.counts_per_deg)
    factor = apt.FAMILIES[rig.controller.model.name or "K10CR1"].speed_factor
    values = direction, switch, round(speed_deg_s * scale * factor), round(offset_deg * scale)
    return apt.long(apt.SET_HOME, struct.pack("<HHHii", 1, *values))


@pytest.fixture(params=["thorlabs", "k10cr1"], ids=["KDC101", "K10CR1"])
def rig(request) -> DirectStage:
    return rig_of(request.param)


@pytest.mark.parametrize(
    "left",
    [None, {"offset_deg": -7.5}, {"direction": 1, "switch": 4}, {"speed_deg_s": 0.0}],
    ids=["power-up", "negative", "forward", "stands"],
)
@pytest.mark.parametrize("when", ["before opening", "before homing"])
def test_a_zero_does_not_depend_on_who_was_connected_before(rig, left, when) -> None:
    """One K10CR1, one station: 14 or 10 degrees, by whether Kinesis was connected since the power-up."""
    if left is None:
        rig.controller.restart(rig.line.clock.now_s)
        rig.line.clock.sleep(2.0)
    else:
        rig.controller.receive(home_message(rig, **left))
    rig.see_it_home_and_move(rig.reopen() if when == "before opening" else rig.stage, 10.0)


def test_the_station_says_where_a_zero_is(rig) -> None:
    scale = rig.controller.model.mechanics.counts_per_deg
    homing = {"home_offset_deg": 1.0, "home_direction": "forward", "home_speed_deg_s": 3.0}
    axis = ThorlabsAxis(name="pan", port="", counts_per_deg=scale, limits=LIMITS, **homing)
    stage = ThorlabsStage([rig.line], [axis], clock=rig.line.clock)
    _, direction, switch, speed, offset = apt.HOME_LAYOUT.unpack(
        rig.controller.receive(apt.short(apt.REQUEST_HOME, 1))[6:]
    )
    factor = apt.FAMILIES[rig.controller.model.name or "K10CR1"].speed_factor
    assert (direction, switch, offset) == (1, 4, round(scale))
    assert speed == pytest.approx(3.0 * scale * factor, abs=1)
    rig.see_it_home_and_move(stage, off_deg=1.0 - 4.0 + 1.5)


def test_a_zero_of_an_unknown_stage_is_not_guessed() -> None:
    rig = rig_of("thorlabs")
    rig.controller.receive(home_message(rig, direction=1, offset_deg=2.5))
    kept = rig.controller.receive(apt.short(apt.REQUEST_HOME, 1))
    axis = ThorlabsAxis(name="pan", port="", counts_per_deg=PRM1Z8_COUNTS_PER_DEG * 1.1, limits=LIMITS)
    with pytest.raises(DeviceRefused) as caught:
        ThorlabsStage([rig.line], [axis], clock=rig.line.clock)
    assert "home_offset_deg: 2.27" in caught.value.what
    assert "home_direction: forward" in caught.value.what
    assert "home_offset_deg" in caught.value.remedy
    assert rig.controller.receive(apt.short(apt.REQUEST_HOME, 1)) == kept


def k10cr1_far_away(**more) -> tuple[ThorlabsStage, AptController, DirectLine]:
    """A K10CR1 without end stops, 120 degrees from its switch."""
    clock = VirtualClock()
    mechanics = Mechanics(K10CR1_COUNTS_PER_DEG, -400.0, 400.0, start_deg=116.0, stall_detection=False)
    controller = AptController(AxisModel(mechanics, "55000123"), clock.monotonic)
    line = direct_line(controller, clock)
    axis = ThorlabsAxis(name="pan", port="", counts_per_deg=K10CR1_COUNTS_PER_DEG, limits=LIMITS, **more)
    return ThorlabsStage([line], [axis], clock=clock), controller, line


@pytest.mark.parametrize("speed_deg_s", [pytest.param(0.4, marks=pytest.mark.slow), 2.0])
def test_a_slow_search_of_a_healthy_stage_is_no_blockage(speed_deg_s) -> None:
    """A K10CR1 needs a minute for 120 degrees at the speed it has after power-up."""
    stage, controller, line = k10cr1_far_away(home_speed_deg_s=speed_deg_s)
    began_s = line.clock.now_s
    stage.home()
    assert line.clock.now_s - began_s > 115.0 / speed_deg_s
    assert stage.is_homed()
    assert controller.axis.pointing.angle_deg(line.clock.now_s + 1.0) == pytest.approx(0.0, abs=1e-3)


def test_a_search_that_goes_on_and_on_ends_by_the_controller_s_own_speed() -> None:
    stage, controller, line = k10cr1_far_away()
    began_s = line.clock.now_s
    controller.model = replace(
        controller.model, mechanics=replace(controller.model.mechanics, home_deg=-4000.0)
    )
    with pytest.raises(MoveTimeout, match=r"reference .* 102"):
        stage.home()
    assert line.clock.now_s - began_s < 110.0


def test_a_correction_of_backlash_is_switched_off(rig) -> None:
    """It overruns the target, beyond the limits of the station."""
    rig.controller.receive(apt.long(apt.SET_BACKLASH, struct.pack("<Hi", 1, 5000)))
    rig.reopen()
    assert rig.controller.receive(apt.short(apt.REQUEST_BACKLASH, 1))[6:] == struct.pack("<Hi", 1, 0)


def test_a_controller_that_does_not_tell_its_home_parameters_is_told(rig) -> None:
    rig.line.lose = lambda data: data.endswith(apt.short(apt.REQUEST_HOME, 1))
    stage = rig.reopen()
    assert any("home parameters" in fault for fault in stage.faults())


def test_a_controller_that_rounds_speeds_and_ramps_to_its_own_steps_is_healthy(rig) -> None:
    rig.controller.speed_step = 8
    rig.controller.restart(rig.line.clock.now_s)
    rig.line.clock.sleep(2.0)
    rig.see_it_home_and_move(rig.reopen())


def test_a_speed_that_a_controller_does_not_keep_is_named(rig) -> None:
    rig.controller.speed_step = 10**10
    rig.controller.restart(rig.line.clock.now_s)
    rig.line.clock.sleep(2.0)
    with pytest.raises(DeviceRefused, match=r"speed .*\(0, 0\)"):
        rig.reopen()


def answer_once(rig: DirectStage, request: bytes, answer: bytes) -> None:
    """Lose the next such request, and let the controller send a message in its place."""
    rig.line.lose_next(request)
    lose = rig.line.lose

    def lose_and_answer(data: bytes) -> bool:
        lost = lose(data)
        if lost:
            rig.line.ready += answer
        return lost

    rig.line.lose = lose_and_answer


@pytest.mark.parametrize(
    ("answer", "cause"),
    [
        (
            struct.pack("<HHBBHH64s", 0x0081, 68, 0x81, 0x50, 0x0453, 17, b"Target position out of range"),
            r"reports 'Target position out of range' \(code 17, request 0x0453\)",
        ),
        (struct.pack("<HBBBB", 0x0080, 0, 0, 0x01, 0x50), "reports a fault of itself"),
    ],
    ids=["in words", "without words"],
)
def test_what_a_controller_says_against_a_move_is_the_cause_that_is_told(rig, answer, cause) -> None:
    rig.stage.home()
    answer_once(rig, b"\x53\x04", answer)
    with pytest.raises(MoveFailed, match=cause):
        rig.stage.move_to({"pan": 5.0})
    assert rig.true_deg() == pytest.approx(0.0, abs=1e-6)
    rig.see_it_home_and_move(rig.stage)


@pytest.mark.parametrize("bits", [0x1011_2000, 0x2000_1000])
def test_status_bits_of_healthy_controllers_are_no_faults(rig, bits) -> None:
    """As published: power, interlock and digital inputs, tracking, settled, and bits that nobody explains."""
    rig.controller.inputs = bits
    rig.see_it_home_and_move(rig.stage)
