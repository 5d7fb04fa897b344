"""Stages as another program, or a power-up, has left them: zeros, modes and speeds that survive in the controller.

Each of these would move an axis, give a wrong angle, or refuse a healthy stage, if the driver took it as it is. The
reports stand in the pages of the devices.
"""

from dataclasses import replace

import pytest
from hypothesis import event, given, settings
from hypothesis import strategies as st

from drivers.errors import DriverError, MoveFailed, NotHomed, OutsideLimits
from drivers.stage import thorlabs_messages as apt
from drivers.stage.esp import EspAxis, EspStage
from drivers.stage.ximc import XimcStage
from drivers.stage.ximc_protocol import request
from simulators.stages.ximc import LAYOUTS
from tests.hil.direct_stages import LIMITS, XIMC, DirectStage, rig_of

pytestmark = pytest.mark.usefixtures("never_late")


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
    "slaved, a move waits": b"S PP4000 ",
    "narrow limits": b"PNU-100 PXU100 LU ",
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
    assert unit.see_it_stand() == pytest.approx(stood_deg, abs=1e-3)
    unit.see_it_home_and_move(stage, 5.0, -14.9, 0.0)


def test_a_unit_found_moving_in_velocity_control_is_stopped_and_stays(unit) -> None:
    left_in(unit, b"CV PS400 ", after_s=2.0)
    unit.reopen()
    assert 2.5 < unit.see_it_stand(20.0) < 6.0


@pytest.mark.parametrize("mode", [b"WPQ ", b"WPF "])
def test_a_step_mode_that_comes_into_force_by_the_homing_is_no_other_scale(unit, mode) -> None:
    left_in(unit, mode)
    stage = unit.reopen()
    with pytest.raises(OutsideLimits, match="800 counts per degree"):
        stage.home()
    assert not stage.is_homed()
    with pytest.raises(NotHomed):
        stage.move_to({"pan": 5.0})


def test_a_scale_of_another_step_mode_before_the_reset_is_read_and_not_refused(unit) -> None:
    """A PTU-E46 whose step mode another program has changed: the reset of the homing brings the chosen one back."""
    left_in(unit, b"WPF RP ", after_s=60.0)
    left_in(unit, b"WPH ")
    unit.see_it_home_and_move(unit.reopen())


def test_a_unit_that_knows_no_scale_before_its_first_reset_is_homed(unit) -> None:
    unit.controller.controller.before_reset = True
    unit.see_it_home_and_move(unit.reopen())


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


@pytest.mark.parametrize("left", ["1SH5", "1CO2.5", "1VA1;1AC1;1TJ2", "1FP0"])
@pytest.mark.parametrize("when", ["before opening", "before homing"])
def test_an_axis_points_right_whatever_another_client_has_set(esp, left, when) -> None:
    esp.line.device.receive(f"{left}\r".encode())
    esp.see_it_home_and_move(esp.reopen() if when == "before opening" else esp.stage, 5.0, -14.9)


@pytest.mark.parametrize("when", ["before opening", "before homing"])
def test_limits_within_those_of_the_station_may_be_those_of_the_mechanics(esp, when) -> None:
    esp.line.device.receive(b"1SL0;1SR1\r")
    with pytest.raises(OutsideLimits, match="0 to 1 deg"):
        esp.reopen() if when == "before opening" else esp.stage.home()


def test_a_command_that_a_controller_does_not_know_is_no_fault(esp) -> None:
    for name in ("TJ", "SH", "BA", "CO", "OH", "FP"):
        del esp.controller.settings[name]
    esp.controller.settings |= {"OH": 20.0}
    stage = esp.reopen()
    assert stage.faults() == ["pan: motor off"]


def test_a_search_at_a_speed_of_0_is_named_and_not_begun(esp) -> None:
    esp.controller.settings["OH"] = 0.0
    with pytest.raises(MoveFailed, match=r"speed .* is 0"):
        esp.stage.home()
    assert esp.present_deg() == pytest.approx(2.4, abs=1e-3)


def test_another_resolution_is_refused_where_the_station_states_it(esp) -> None:
    axis = EspAxis(name="pan", number=1, serial="1263", limits=LIMITS, resolution_deg=1e-4)
    EspStage(esp.line, [axis], clock=esp.line.clock)
    esp.line.device.receive(b"1SU0.0002\r")
    with pytest.raises(OutsideLimits, match=r"0.0001 deg .* 0.0002\."):
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
    ximc.see_it_home_and_move(stage)
    settings = ximc.controller.settings
    assert (settings["sni"][0], settings["pwr"][4], settings["eng"][4]) == (0x04, 0x05, 0x10)


@pytest.mark.parametrize("when", ["before opening", "before homing"])
def test_a_way_from_the_sensor_that_the_station_does_not_state_is_refused(ximc, when) -> None:
    """Homing goes on by it, and the driver counts from there: 3 degrees, without a word."""
    leave(ximc, "hom", p4=300)
    with pytest.raises(OutsideLimits, match=r"3 deg .* sensor") as caught:
        ximc.reopen() if when == "before opening" else ximc.stage.home()
    assert "home_offset_deg: 3 " in caught.value.remedy


@pytest.mark.parametrize("offset_deg", [0.0, -2.0])
def test_the_station_says_how_far_a_zero_is_from_the_sensor(ximc, offset_deg) -> None:
    leave(ximc, "hom", p4=300)
    ximc.see_it_home_and_move(again(ximc, home_offset_deg=offset_deg), off_deg=offset_deg)


def test_a_reversed_motor_is_refused_where_the_station_states_it(ximc) -> None:
    again(ximc, reversed=False)
    leave(ximc, "eng", p4=0x11)
    with pytest.raises(OutsideLimits, match="reversed: false"):
        again(ximc, reversed=False)
    again(ximc, reversed=True)


def test_a_motor_whose_speed_is_limited_is_refused(ximc) -> None:
    leave(ximc, "eng", p2=500, p3=0, p4=0x90)
    with pytest.raises(OutsideLimits, match="5 deg/s"):
        ximc.reopen()


def test_other_microsteps_than_at_opening_are_refused(ximc) -> None:
    stage = ximc.reopen()
    leave(ximc, "eng", p6=5)
    with pytest.raises(MoveFailed, match=r"16 microsteps .* 256"):
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
    rig.see_it_home_and_move(stage)


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


#: FLIR: 800 counts a degree, and what a float adds.
COARSEST_COUNT_DEG = 1 / 800 + 1e-9

ANY_COMMAND = {
    "flir": st.one_of(
        st.sampled_from([*FLIR_LEFT.values(), b"CI ", b"I ", b"A ", b"LU ", b"LE ", b"WPQ ", b"WPA ", b"H "]),
        numbered("PS{} ", "PP{} ", "PNU{} ", "PXU{} ", "PA{} ", largest=9000),
    ),
    "esp": numbered(
        *("1SH{}\r", "1CO{}\r", "1TJ{}\r", "1BA{}\r", "1VA{}\r", "1AC{}\r", "1OH{}\r", "1PA{}\r", "1DH{}\r"),
        *("1FP0\r", "1FP7\r"),
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
    before_deg = rig.true_deg()
    rig.line.clock.sleep(1.0)
    stood_deg = rig.true_deg()
    # A command such as CV PS3 still creeps here, for the second at most until the driver has stopped it.
    crept_deg = abs(stood_deg - before_deg)
    try:
        stage = rig.reopen()
        rig.line.clock.sleep(5.0)
        # A motor that is stopped while it presses against its end comes to rest at a whole count.
        assert rig.true_deg() == pytest.approx(stood_deg, abs=COARSEST_COUNT_DEG + crept_deg)
        stage.home()
        stage.move_to({"pan": 5.0})
    except DriverError:
        event("refused")
        return
    event("right")
    assert rig.true_deg() == pytest.approx(5.0, abs=0.005)
    assert stage.faults() == []
