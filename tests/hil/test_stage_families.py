"""Every family of stages on its simulated controllers, on a virtual clock: one behaviour.

What its faults do stands in test_every_fault.py, what a port does in test_plugin_contract.py.
"""

import pytest

from drivers.errors import DriverError, MoveFailed, NotHomed, OutsideLimits
from drivers.stage.thorlabs_messages import STOP, STOP_BY_RAMP, short
from simulators.faults.line_faults import LineFault
from tests.hil.direct_stages import FAMILIES, DirectStage, rig_of, stop_in_mid_move

pytestmark = pytest.mark.usefixtures("never_late")

STOPS = {
    "zaber": b" stop:",
    "ximc": b"sstp",
    "esp": b"ST\r",
    "grbl": b"\x85",
    "flir": b"H ",
    "thorlabs": short(STOP, 1, STOP_BY_RAMP),
    "k10cr1": short(STOP, 1, STOP_BY_RAMP),
}
"""What a request holds that stops an axis."""


IDENTITIES = {
    "zaber": ("Zaber", "device id 50958", "100101", "7.38"),
    "ximc": ("XIMC", "8SMC5", "4242", "4.6.12"),
    "esp": ("Newport", "URS75BCC", "SN1263", "ESP301 Version 3.0.1 6/1/99"),
    "grbl": ("GRBL", "GRBL 1.1", "GIMBAL", "1.1h.20190830"),
    "thorlabs": ("Thorlabs", "KDC101", "27000123", "2.0.3"),
    "k10cr1": ("Thorlabs", "K10CR1", "27000123", "2.0.3"),
}
"""Maker, model, serial number and firmware; a described stage tells what its description says."""


class Interrupted(Exception):
    """What a run's clock raises when the operator aborts."""


@pytest.fixture(params=FAMILIES)
def rig(request) -> DirectStage:
    return rig_of(request.param)


def test_a_stage_is_identified_homed_and_moved(rig) -> None:
    (axis,) = rig.stage.identify()
    assert axis.name == "pan"
    identity = (axis.maker, axis.model, axis.serial, axis.firmware)
    assert identity == IDENTITIES.get(rig.family, ("FLIR", "E series pan-tilt unit", "E1042", axis.firmware))
    assert not rig.stage.is_homed()
    with pytest.raises(NotHomed):
        rig.stage.move_to({"pan": 1.0})
    assert rig.present_deg() == pytest.approx(2.4, abs=1e-3)
    rig.stage.home()
    assert rig.stage.is_homed()
    assert rig.stage.faults() == []
    for angle in (5.0, -14.9, 9.5):
        rig.stage.move_to({"pan": angle})
        assert rig.stage.position_deg()["pan"] == pytest.approx(angle, abs=0.002)
        assert rig.true_deg() == pytest.approx(angle, abs=0.002)
    with pytest.raises(OutsideLimits):
        rig.stage.move_to({"pan": 15.5})
    assert rig.true_deg() == pytest.approx(9.5, abs=0.002)


def test_a_stranger_on_the_port_is_refused(rig) -> None:
    rig.line.device.inject(LineFault("stranger", count=None))
    with pytest.raises(DriverError):
        rig.reopen()


def test_closing_moves_nothing(rig) -> None:
    rig.stage.home()
    rig.stage.move_to({"pan": 5.0})
    rig.stage.close()
    assert rig.line.closed
    rig.line.clock.sleep(5.0)
    assert rig.present_deg() == pytest.approx(5.0, abs=0.002)


def test_a_stop_from_another_thread_ends_a_move(rig) -> None:
    rig.stage.home()
    rig.stage.move_to({"pan": 10.0})
    error = stop_in_mid_move(rig.line.clock, rig.stage, {"pan": -15.0}, 0.2)
    assert isinstance(error, MoveFailed)
    rest = rig.see_it_stand()
    assert -14.0 < rest < 9.9
    assert rig.stage.position_deg()["pan"] == pytest.approx(rest, abs=0.01)


@pytest.mark.parametrize("rig", STOPS, indirect=True)
def test_a_stop_does_not_wait_for_the_line_to_come_into_step(rig) -> None:
    rig.stage.home()
    rig.line.lose_step(rig.stage.position_deg)
    rig.stage.stop()
    assert STOPS[rig.family] in rig.line.sent[0]


@pytest.mark.parametrize("order", ["move_to", "home"])
def test_an_order_to_move_is_not_given_again_when_the_next_reply_is_lost(rig, monkeypatch, order) -> None:
    rig.see_it_home_and_move(rig.stage)
    given, real = [], getattr(rig.controller.axis, order)

    def lose_one(_reply: bytes) -> bytes:
        rig.line.spoil = lambda reply: reply
        return b""

    def noted(*words, **more) -> None:
        given.append(words)
        rig.line.spoil = lose_one
        real(*words, **more)

    monkeypatch.setattr(rig.controller.axis, order, noted)
    rig.line.error_of(lambda: rig.stage.home() if order == "home" else rig.stage.move_to({"pan": -5.0}), 60.0)
    assert len(given) == 1


@pytest.mark.parametrize("waits", [1, 2])
def test_homing_that_is_interrupted_and_stopped_leaves_no_reference(rig, waits) -> None:
    clock, sleep, waited = rig.line.clock, rig.line.clock.sleep, iter(range(1, 1000))

    def interrupt(seconds: float) -> None:
        sleep(seconds)
        if next(waited) == waits:
            raise Interrupted

    clock.sleep = interrupt
    with pytest.raises(Interrupted):
        rig.stage.home()
    clock.sleep = sleep
    rig.stage.stop()
    rig.see_it_stand(60.0)
    assert not rig.stage.is_homed()
    with pytest.raises((NotHomed, MoveFailed)):
        rig.stage.move_to({"pan": 1.0})
    rig.see_it_home_and_move(rig.stage, 1.0)


def test_an_axis_found_moving_is_stopped_at_opening(rig) -> None:
    rig.stage.home()
    rig.stage.move_to({"pan": 10.0})
    axis, scale = rig.controller.axis, rig.controller.axis.mechanics.counts_per_deg
    axis.move_to(-15.0 * scale, rig.line.clock.now_s, 20.0 * scale, 100.0 * scale)
    rig.line.clock.sleep(0.3)
    rig.reopen()
    assert -14.0 < rig.see_it_stand() < 9.9
