"""Thorlabs controllers as they are: silent commands, lost commands, updates, a channel switched off."""

from dataclasses import replace

import pytest

from drivers.errors import DeviceRefused, MoveFailed, OutsideLimits, WrongDevice
from drivers.stage import AxisLimits
from drivers.stage import thorlabs_messages as apt
from drivers.stage.thorlabs import ThorlabsAxis, ThorlabsStage
from tests.hil.direct_stages import K10CR1_COUNTS_PER_DEG, LIMITS, DirectStage, rig_of, stop_in_mid_move

pytestmark = pytest.mark.usefixtures("never_late")


@pytest.fixture(params=["thorlabs", "k10cr1"], ids=["KDC101", "K10CR1"])
def rig(request) -> DirectStage:
    return rig_of(request.param)


def test_opening_a_controller_sends_no_motion_and_switches_no_motor_on() -> None:
    rig = rig_of("k10cr1")
    numbers = {int.from_bytes(sent[:2], "little") for sent in rig.line.sent}
    assert numbers.isdisjoint({apt.HOME, apt.MOVE_TO, apt.SET_ENABLED, 0x0448, 0x046A, 0x0457})
    assert apt.SET_SPEED in numbers
    for changes, error in (
        ({"counts_per_deg": 1919.64}, OutsideLimits),
        ({"serial": "27000124"}, WrongDevice),
        ({"limits": AxisLimits(-15.0, 15.0, 1e9, 10.0)}, OutsideLimits),
    ):
        axis = {
            "name": "pan",
            "port": "",
            "counts_per_deg": K10CR1_COUNTS_PER_DEG,
            "limits": LIMITS,
            **changes,
        }
        with pytest.raises(error):
            ThorlabsStage([rig.line], [ThorlabsAxis(**axis)], clock=rig.line.clock)
    rig.controller.model = replace(rig.controller.model, name="PPC001")
    with pytest.raises(DeviceRefused, match="PPC001"):
        rig.reopen()


def test_a_controller_without_its_motor_says_so_when_homing_does_not_begin(rig) -> None:
    """Bit 0x100 of the status: the cable of a PRM1Z8 at a KDC101 is off, so that nothing turns and nothing is an error."""

    def without_motor(reply: bytes) -> bytes:
        if reply[:2] != b"\x2a\x04":
            return reply
        return reply[:9] + bytes([reply[9] & ~0x01]) + reply[10:]

    rig.line.spoil = without_motor
    rig.line.lose = lambda sent: sent[:2] == b"\x43\x04"
    with pytest.raises(MoveFailed, match=r"home: .* no motor"):
        rig.stage.home()
    assert not rig.stage.is_homed()


def test_a_command_that_is_lost_is_no_homing_and_no_move(rig) -> None:
    rig.stage.home()
    rig.line.lose_next(apt.short(apt.HOME, 1))
    with pytest.raises(MoveFailed, match="did not begin"):
        rig.stage.home()
    assert not rig.stage.is_homed()
    rig.stage.home()
    assert rig.stage.is_homed()
    rig.line.lose_next(b"\x53\x04")
    with pytest.raises(MoveFailed, match="stopped at"):
        rig.stage.move_to({"pan": 5.0})
    assert rig.true_deg() == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("lost", [0, 1])
def test_a_stop_of_a_controller_is_confirmed_though_it_is_lost_once(rig, lost) -> None:
    rig.stage.home()
    rig.line.lose_next(apt.short(apt.STOP, 1, apt.STOP_BY_RAMP), lost)
    error = stop_in_mid_move(rig.line.clock, rig.stage, {"pan": 14.0}, 0.1)
    assert "stopped on request" in error.what
    assert 0.05 < rig.see_it_stand() < 13.9


def test_updates_that_another_program_has_switched_on_are_no_trouble(rig) -> None:
    rig.controller.receive(apt.short(0x0011))
    rig.stage.home()
    rig.controller.receive(apt.short(0x0011))
    rig.stage.move_to({"pan": 3.0})
    assert rig.stage.position_deg()["pan"] == pytest.approx(3.0, abs=1e-3)


def test_a_channel_switched_off_at_the_panel_is_told_and_homing_switches_it_on(rig) -> None:
    rig.stage.home()
    rig.controller.switch_off_channel(rig.line.clock.now_s)
    assert any("channel" in fault for fault in rig.stage.faults())
    with pytest.raises(MoveFailed, match="channel is switched off"):
        rig.stage.move_to({"pan": 5.0})
    rig.see_it_home_and_move(rig.stage)


def test_each_request_to_a_servo_controller_carries_a_sign_of_life() -> None:
    rig = rig_of("thorlabs")
    rig.stage.home()
    asked = [sent for sent in rig.line.sent if sent.endswith(apt.short(apt.REQUEST_STATUS, 1))]
    assert len(asked) > 20
    assert all(sent.startswith(apt.short(apt.STILL_THERE)) for sent in asked)
