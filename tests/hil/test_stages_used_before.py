"""Stages as another program, or a power-up, has left them: zeros, modes and speeds that survive in the controller.

Each of these would move an axis, give a wrong angle, or refuse a healthy stage, if the driver took it as it is. The
reports stand in the pages of the devices.
"""

from __future__ import annotations

import struct
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import event, given, settings
from hypothesis import strategies as st

from drivers.errors import DeviceRefused, DriverError, MoveFailed, MoveTimeout, NotHomed, OutsideLimits
from drivers.stage import thorlabs_controller as apt
from drivers.stage.esp import EspAxis, EspStage
from drivers.stage.thorlabs import ThorlabsAxis, ThorlabsStage
from drivers.stage.ximc import XimcStage
from drivers.stage.ximc_protocol import request
from simulators.stages.axis_motion import AxisModel, Mechanics
from simulators.stages.thorlabs_apt import AptController
from simulators.stages.ximc import LAYOUTS
from tests.hil.direct_stages import (
    FAMILIES,
    K10CR1_COUNTS_PER_DEG,
    LIMITS,
    PRM1Z8_COUNTS_PER_DEG,
    XIMC,
    DirectLine,
    DirectStage,
    VirtualClock,
    direct_line,
)

pytestmark = pytest.mark.usefixtures("never_late")


def rig_of(family: str) -> DirectStage:
    return FAMILIES[family](VirtualClock(), np.random.default_rng(1))


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
    [
        None,
        {},
        {"offset_deg": 0.0},
        {"offset_deg": -7.5},
        {"direction": 1, "switch": 4},
        {"speed_deg_s": 0.0},
        {"speed_deg_s": 0.05, "offset_deg": 1.0},
    ],
    ids=["power-up", "maker's", "no offset", "negative", "forward", "stands", "slow"],
)
@pytest.mark.parametrize("when", ["before opening", "before homing"])
def test_a_zero_does_not_depend_on_who_was_connected_before(rig, left, when) -> None:
    """One K10CR1, one station: 14 or 10 degrees, by whether Kinesis was connected since the power-up."""
    if left is None:
        rig.controller.restart(rig.line.clock.now_s)
        rig.line.clock.sleep(2.0)
    else:
        rig.controller.receive(home_message(rig, **left))
    stage = rig.reopen() if when == "before opening" else rig.stage
    stage.home()
    stage.move_to({"pan": 10.0})
    assert stage.faults() == []
    assert rig.true_deg() == pytest.approx(10.0, abs=0.002)


def test_the_station_says_where_a_zero_is(rig) -> None:
    scale = rig.controller.model.mechanics.counts_per_deg
    axis = ThorlabsAxis(
        name="pan",
        port="",
        counts_per_deg=scale,
        limits=LIMITS,
        home_offset_deg=1.0,
        home_direction="forward",
        home_speed_deg_s=3.0,
    )
    stage = ThorlabsStage([rig.line], [axis], clock=rig.line.clock)
    _, direction, switch, speed, offset = apt.HOME_LAYOUT.unpack(
        rig.controller.receive(apt.short(apt.REQUEST_HOME, 1))[6:]
    )
    factor = apt.FAMILIES[rig.controller.model.name or "K10CR1"].speed_factor
    assert (direction, switch, offset) == (1, 4, round(scale))
    assert speed == pytest.approx(3.0 * scale * factor, abs=1)
    stage.home()
    stage.move_to({"pan": 5.0})
    assert rig.true_deg() == pytest.approx(5.0 + 1.0 - 4.0 + 1.5, abs=0.002)


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


@pytest.mark.parametrize("speed_deg_s", [0.4, 2.0])
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
    with pytest.raises(MoveTimeout, match="search of the reference has not ended after 102"):
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
    assert "pan: the controller does not tell its home parameters, so its zero is not known" in stage.faults()


def test_a_controller_that_rounds_speeds_and_ramps_to_its_own_steps_is_healthy(rig) -> None:
    rig.controller.speed_step = 8
    stage = rig.reopen()
    stage.home()
    stage.move_to({"pan": 5.0})
    assert stage.faults() == []


def test_a_speed_that_a_controller_does_not_keep_is_named(rig) -> None:
    rig.controller.speed_step = 10**10
    rig.controller.restart(rig.line.clock.now_s)
    rig.line.clock.sleep(2.0)
    with pytest.raises(
        DeviceRefused, match=r"acceleration and speed read back differently.*\(0, 0\) instead of"
    ):
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
    rig.stage.home()
    rig.stage.move_to({"pan": 5.0})
    assert rig.stage.faults() == []


@pytest.mark.parametrize("bits", [0x1001_2000, 0x1011_2000, 0x1000, 0x2000_2000])
def test_status_bits_of_healthy_controllers_are_no_faults(rig, bits) -> None:
    """As published: power, interlock and digital inputs, tracking, settled, and bits that nobody explains."""
    rig.controller.inputs = bits
    rig.stage.home()
    rig.stage.move_to({"pan": 5.0})
    assert rig.stage.faults() == []
    assert rig.true_deg() == pytest.approx(5.0, abs=0.002)


# ---------------------------------------------------------------- FLIR


@pytest.fixture
def unit() -> DirectStage:
    return rig_of("flir")


def left_in(unit: DirectStage, commands: bytes, after_s: float = 0.0) -> float:
    """Let another program send commands; return where the axis then stands, in degrees."""
    unit.line.device.receive(commands)
    unit.line.clock.sleep(after_s)
    unit.line.device.unsolicited()
    return unit.present_deg()


FLIR_LEFT = {
    "pure velocity": b"CV ",
    "pure velocity, an axis stopped on its way": b"CV PS-800 PS0 ",
    "slaved": b"S ",
    "slaved, a move waits": b"S PP4000 ",
    "pure velocity and slaved": b"S PP-4000 CV ",
    "limits off": b"LD ",
    "narrow limits": b"PNU-100 PXU100 LU ",
    "silent and in sentences": b"ED FV ",
    "slow": b"PS60 PA100 ",
    "a step mode that was not reset": b"WPH ",
}


@pytest.mark.parametrize("left", FLIR_LEFT.values(), ids=FLIR_LEFT)
@pytest.mark.parametrize("when", ["before opening", "before homing"])
def test_a_unit_in_any_mode_stands_until_it_is_homed_and_then_points_right(unit, left, when) -> None:
    """ROS flir_ptu sends CI first: in CV, opening drove both axes to their limits."""
    stood_deg = left_in(unit, left, after_s=3.0)
    stage = unit.reopen()
    if when == "before homing":
        stood_deg = left_in(unit, left, after_s=3.0)
    unit.line.clock.sleep(5.0)
    assert unit.present_deg() == pytest.approx(stood_deg, abs=1e-3)
    stage.home()
    for angle_deg in (5.0, -14.9, 0.0):
        stage.move_to({"pan": angle_deg})
        assert unit.true_deg() == pytest.approx(angle_deg, abs=0.002)
    assert stage.faults() == []


def test_a_unit_found_moving_in_velocity_control_is_stopped_and_stays(unit) -> None:
    left_in(unit, b"CV PS400 ", after_s=2.0)
    unit.reopen()
    stood_deg = unit.true_deg()
    assert 2.5 < stood_deg < 6.0
    unit.line.clock.sleep(20.0)
    assert unit.true_deg() == pytest.approx(stood_deg, abs=1e-3)


@pytest.mark.parametrize("mode", [b"WPQ ", b"WPA ", b"WPF "])
def test_a_step_mode_that_comes_into_force_by_the_homing_is_no_other_scale(unit, mode) -> None:
    left_in(unit, mode)
    stage = unit.reopen()
    with pytest.raises(OutsideLimits, match=r"the station file gives 800 counts per degree, the controller"):
        stage.home()
    assert not stage.is_homed()
    with pytest.raises(NotHomed):
        stage.move_to({"pan": 5.0})


def test_a_unit_that_knows_no_scale_before_its_first_reset_is_homed(unit) -> None:
    unit.controller.controller.before_reset = True
    stage = unit.reopen()
    stage.home()
    stage.move_to({"pan": 5.0})
    assert unit.true_deg() == pytest.approx(5.0, abs=0.002)


def test_a_unit_in_its_reset_of_power_up_is_waited_for(unit) -> None:
    """It answers nothing for 20 s; ROS flir_ptu 13."""
    clock, receive = unit.line.clock, unit.line.device.receive
    awake_s = clock.now_s + 20.0
    unit.line.device.receive = lambda data: receive(data) if clock.now_s >= awake_s else b""
    unit.reopen()
    assert clock.now_s >= awake_s


# ---------------------------------------------------------------- Newport


@pytest.fixture
def esp() -> DirectStage:
    return rig_of("esp")


@pytest.mark.parametrize(
    "left",
    ["1SH5", "1SH-2.5", "1CO2.5", "1TJ2", "1TJ6", "1BA0.2", "1VA1;1AC1", "1SH3;1CO-1;1TJ4"],
)
@pytest.mark.parametrize("when", ["before opening", "before homing"])
def test_an_axis_points_right_whatever_another_client_has_set(esp, left, when) -> None:
    esp.line.device.receive(f"{left}\r".encode())
    stage = esp.reopen() if when == "before opening" else esp.stage
    stage.home()
    for angle_deg in (5.0, -14.9):
        stage.move_to({"pan": angle_deg})
        assert esp.true_deg() == pytest.approx(angle_deg, abs=0.002)
        assert stage.position_deg()["pan"] == pytest.approx(angle_deg, abs=0.002)
    assert stage.faults() == []


@pytest.mark.parametrize("when", ["before opening", "before homing"])
def test_limits_within_those_of_the_station_may_be_those_of_the_mechanics(esp, when) -> None:
    esp.line.device.receive(b"1SL0;1SR1\r")
    with pytest.raises(OutsideLimits, match="the controller allows only 0 to 1 deg"):
        esp.reopen() if when == "before opening" else esp.stage.home()


def test_a_command_that_a_controller_does_not_know_is_no_fault(esp) -> None:
    for name in ("TJ", "SH", "BA", "CO", "OH"):
        del esp.controller.settings[name]
    esp.controller.settings |= {"OH": 20.0}
    stage = esp.reopen()
    assert stage.faults() == ["pan: motor off"]


def test_a_search_at_a_speed_of_0_is_named_and_not_begun(esp) -> None:
    esp.controller.settings["OH"] = 0.0
    with pytest.raises(MoveFailed, match="the controller's speed of the reference search is 0"):
        esp.stage.home()
    assert esp.present_deg() == pytest.approx(2.4, abs=1e-3)


def test_another_resolution_is_refused_where_the_station_states_it(esp) -> None:
    axis = EspAxis(name="pan", number=1, serial="1263", limits=LIMITS, resolution_deg=1e-4)
    EspStage(esp.line, [axis], clock=esp.line.clock)
    esp.line.device.receive(b"1SU0.0002\r")
    with pytest.raises(
        OutsideLimits, match=r"has 0.0001 deg a count, the controller 0.0002\. Nothing was set"
    ):
        EspStage(esp.line, [axis], clock=esp.line.clock)


# ---------------------------------------------------------------- Standa


@pytest.fixture
def ximc() -> DirectStage:
    return rig_of("ximc")


def leave(rig: DirectStage, name: str, **places) -> None:
    """Change settings as another program does; ``places`` are numbered p0, p1, ... in the order of their data."""
    values = list(rig.controller.settings[name])
    for place, value in places.items():
        values[int(place[1:])] = value
    data = LAYOUTS[name][0].pack(*values)
    assert rig.line.device.receive(request(f"s{name}", data)) == f"s{name}".encode()


def again(rig: DirectStage, **changes) -> XimcStage:
    return XimcStage([rig.line], [replace(XIMC, **changes)], clock=rig.line.clock)


@pytest.mark.parametrize("when", ["before opening", "before homing"])
def test_what_moves_overruns_or_frees_an_axis_is_switched_off(ximc, when) -> None:
    if when == "before homing":
        stage = ximc.reopen()
    leave(ximc, "sni", p0=0x05)  # a pulse goes to a position
    leave(ximc, "pwr", p4=0x07)  # the motor is switched off at rest
    leave(ximc, "eng", p4=0x0C)  # full speed, compensation of backlash, no ramps
    if when == "before opening":
        stage = ximc.reopen()
    stage.home()
    settings = ximc.controller.settings
    assert (settings["sni"][0], settings["pwr"][4], settings["eng"][4]) == (0x04, 0x05, 0x10)
    stage.move_to({"pan": 5.0})
    assert ximc.true_deg() == pytest.approx(5.0, abs=0.002)


@pytest.mark.parametrize("when", ["before opening", "before homing"])
def test_a_way_from_the_sensor_that_the_station_does_not_state_is_refused(ximc, when) -> None:
    """Homing goes on by it, and the driver counts from there: 3 degrees, without a word."""
    leave(ximc, "hom", p4=300)
    with pytest.raises(OutsideLimits, match=r"the controller goes 3 deg on from its sensor") as caught:
        ximc.reopen() if when == "before opening" else ximc.stage.home()
    assert "home_offset_deg: 3 " in caught.value.remedy


@pytest.mark.parametrize("offset_deg", [0.0, -2.0, 1.5])
def test_the_station_says_how_far_a_zero_is_from_the_sensor(ximc, offset_deg) -> None:
    leave(ximc, "hom", p4=300)
    stage = again(ximc, home_offset_deg=offset_deg)
    stage.home()
    stage.move_to({"pan": 5.0})
    assert ximc.true_deg() == pytest.approx(5.0 + offset_deg, abs=0.002)


def test_a_reversed_motor_is_refused_where_the_station_states_it(ximc) -> None:
    again(ximc, reversed=False)
    leave(ximc, "eng", p4=0x11)
    with pytest.raises(OutsideLimits, match="reversed: false, but the controller reverses the motor"):
        again(ximc, reversed=False)
    again(ximc, reversed=True)


def test_a_motor_whose_speed_is_limited_is_refused(ximc) -> None:
    leave(ximc, "eng", p2=500, p3=0, p4=0x90)
    with pytest.raises(OutsideLimits, match="limits the motor to 5 deg/s"):
        ximc.reopen()


def test_other_microsteps_than_at_opening_are_refused(ximc) -> None:
    stage = ximc.reopen()
    leave(ximc, "eng", p6=5)
    with pytest.raises(MoveFailed, match="counts 16 microsteps a step, and 256 when it was opened"):
        stage.home()


@pytest.mark.parametrize("fast", [20, 400])
def test_a_slow_search_of_a_standa_axis_is_no_blockage(ximc, fast) -> None:
    leave(ximc, "hom", p0=fast, p2=2)
    stage = ximc.reopen()
    stage.home()
    assert stage.is_homed()


# ---------------------------------------------------------------- all of them


@pytest.mark.parametrize("family", ["thorlabs", "k10cr1", "ximc", "esp", "flir", "grbl"])
def test_an_axis_that_another_program_has_homed_has_no_zero_that_is_known(family) -> None:
    """It may have homed to another zero, or set its counter to 0 anywhere."""
    rig = rig_of(family)
    rig.stage.home()
    rig.stage.move_to({"pan": 3.0})
    axis = rig.controller.axis
    axis.set_counter(0.0, rig.line.clock.now_s)
    axis.set_encoder(0.0, rig.line.clock.now_s)
    stage = rig.reopen()
    assert not stage.is_homed()
    with pytest.raises(NotHomed):
        stage.move_to({"pan": 5.0})
    assert rig.true_deg() == pytest.approx(3.0, abs=0.002)
    stage.home()
    stage.move_to({"pan": 5.0})
    assert rig.true_deg() == pytest.approx(5.0, abs=0.002)


def numbered(*forms: str, largest: int) -> st.SearchStrategy[bytes]:
    number = st.integers(-largest, largest)
    return st.builds(lambda form, value: form.format(value).encode(), st.sampled_from(forms), number)


def thorlabs_settings(counts: int) -> st.SearchStrategy[bytes]:
    number = st.integers(-counts, counts)
    home = st.builds(
        lambda way, speed, offset: apt.long(
            apt.SET_HOME, apt.HOME_LAYOUT.pack(1, way, apt.SWITCHES[way], abs(speed), offset)
        ),
        st.sampled_from([apt.FORWARD, apt.REVERSE]),
        number,
        number,
    )
    ramp = st.builds(
        lambda ramp, speed: apt.long(apt.SET_SPEED, apt.SPEED_LAYOUT.pack(1, 0, abs(ramp), abs(speed))),
        number,
        number,
    )
    backlash = st.builds(lambda way: apt.long(apt.SET_BACKLASH, apt.POSITION_LAYOUT.pack(1, way)), number)
    switched = st.sampled_from([apt.short(apt.SET_ENABLED, 1, 2), apt.short(0x0011), apt.short(0x0012)])
    return st.one_of(home, ramp, backlash, switched)


ANY_COMMAND = {
    "flir": st.one_of(
        st.sampled_from([*FLIR_LEFT.values(), b"CI ", b"I ", b"A ", b"LU ", b"LE ", b"WPQ ", b"WPA ", b"H "]),
        numbered("PS{} ", "PP{} ", "PNU{} ", "PXU{} ", "PA{} ", largest=9000),
    ),
    "esp": numbered(
        *("1SH{}\r", "1CO{}\r", "1TJ{}\r", "1BA{}\r", "1VA{}\r", "1AC{}\r", "1OH{}\r", "1PA{}\r", "1DH{}\r"),
        *("1MO\r", "1MF\r"),
        largest=12,
    ),
    "k10cr1": thorlabs_settings(500_000),
    "thorlabs": thorlabs_settings(20_000),
}


@pytest.mark.parametrize("family", ANY_COMMAND)
@settings(max_examples=40, deadline=None)
@given(data=st.data())
def test_whatever_other_programs_have_sent_opening_moves_nothing_and_an_angle_is_right_or_refused(
    family, data
) -> None:
    rig = rig_of(family)
    for command in data.draw(st.lists(ANY_COMMAND[family], max_size=8)):
        rig.line.device.receive(command)
        rig.line.clock.sleep(data.draw(st.sampled_from([0.0, 0.2, 200.0])))
        rig.line.device.unsolicited()
    rig.line.clock.sleep(200.0)
    stood_deg = rig.true_deg()
    try:
        stage = rig.reopen()
        rig.line.clock.sleep(5.0)
        assert rig.true_deg() == pytest.approx(stood_deg, abs=1e-3)
        stage.home()
        stage.move_to({"pan": 5.0})
    except DriverError:
        event("refused")
        return
    event("right")
    assert rig.true_deg() == pytest.approx(5.0, abs=0.005)
    assert stage.faults() == []
