"""Thorlabs' protocol by another encoder and decoder: our driver's bytes, and the simulated controllers' bytes.

The package `thorlabs_apt_protocol` (MIT) was written by others from the same document.
"""

import io
import math

import numpy as np
import pytest

from drivers.stage import thorlabs_messages as ours
from drivers.stage.thorlabs_messages import FAMILIES, Information, Status
from simulators.stages.axis_motion import AxisModel, Mechanics
from simulators.stages.thorlabs_apt import AptController
from tests.hil.direct_stages import FAMILIES as RIGS
from tests.hil.direct_stages import K10CR1_COUNTS_PER_DEG, PRM1Z8_COUNTS_PER_DEG, VirtualClock

apt = pytest.importorskip("thorlabs_apt_protocol", reason="pip install thorlabs-apt-protocol")
UNIT, HOST = 0x50, 0x01
REQUEST_STATUS_BITS = bytes.fromhex("29 04 01 00 50 01")
"""From the document: the other package decodes the answer, but has no function for this request."""


def decoded(answer: bytes) -> list:
    return list(apt.Unpacker(io.BytesIO(answer), on_error="raise"))


def controller(name: str) -> tuple[AptController, VirtualClock]:
    clock = VirtualClock()
    scale = K10CR1_COUNTS_PER_DEG if name == "K10CR1" else PRM1Z8_COUNTS_PER_DEG
    model = AxisModel(
        Mechanics(scale, -170.0, 170.0, start_deg=20.0), "55000123", 15.0, 10.0, 10.0, name=name
    )
    return AptController(model, clock.monotonic), clock


@pytest.mark.parametrize("name", ["K10CR1", "KDC101"])
def test_another_client_homes_moves_and_stops_the_simulated_controller(name) -> None:
    device, clock = controller(name)
    (information,) = decoded(device.receive(apt.hw_req_info(UNIT, HOST)))
    assert (information.serial_number, information.model_number.rstrip(b"\0")) == (55_000_123, name.encode())

    device.receive(apt.mot_move_home(UNIT, HOST, 1))
    clock.sleep(0.5)
    (status,) = decoded(device.receive(apt.mot_req_dcstatusupdate(UNIT, HOST, 1)))
    assert status.homing
    assert not status.homed
    clock.sleep(30.0)
    (homed,) = decoded(device.unsolicited())
    assert (homed.msg, homed.chan_ident) == ("mot_move_homed", 1)

    goal = round(90.0 * device.model.mechanics.counts_per_deg)
    device.receive(apt.mot_move_absolute(UNIT, HOST, 1, goal))
    clock.sleep(1.0)
    (status,) = decoded(device.receive(REQUEST_STATUS_BITS))
    assert status.moving_forward
    clock.sleep(30.0)
    (completed,) = decoded(device.unsolicited())
    assert completed.msg == "mot_move_completed"
    (position,) = decoded(device.receive(apt.mot_req_poscounter(UNIT, HOST, 1)))
    assert position.position == goal

    device.receive(apt.mot_move_relative(UNIT, HOST, 1, -goal))
    clock.sleep(2.0)
    device.receive(apt.mot_move_stop(UNIT, HOST, 1, 2))
    clock.sleep(3.0)
    (stopped,) = decoded(device.unsolicited())
    assert stopped.msg == "mot_move_stopped"
    (status,) = decoded(device.receive(REQUEST_STATUS_BITS))
    assert not status.moving_forward
    assert not status.moving_reverse
    (speed,) = decoded(device.receive(apt.mot_req_velparams(UNIT, HOST, 1)))
    factor = {"K10CR1": 7_329_109, "KDC101": 42_941.66}[name]
    """Units of speed for one degree a second, as the document states them."""
    assert speed.max_velocity / 10.0 == pytest.approx(factor, rel=1e-4)


def test_a_servo_controller_sends_no_more_updates_without_signs_of_life() -> None:
    device, _ = controller("KDC101")
    request = apt.mot_req_dcstatusupdate(UNIT, HOST, 1)
    assert len([1 for _ in range(60) if device.receive(request)]) == 50
    assert device.receive(apt.mot_ack_dcstatusupdate(UNIT, HOST) + request)


def test_updates_come_until_they_are_switched_off() -> None:
    device, clock = controller("KDC101")
    device.receive(apt.hw_start_updatemsgs(UNIT, HOST))
    updates = b""
    for _ in range(10):
        clock.sleep(0.11)
        updates += device.unsolicited()
    assert len(decoded(updates)) == 10
    device.receive(apt.hw_stop_updatemsgs(UNIT, HOST))
    clock.sleep(1.0)
    assert device.unsolicited() == b""


def test_the_driver_reads_bits_and_identity_as_the_other_decoder_does() -> None:
    rng = np.random.default_rng(1)
    for bits in (1 << np.arange(32, dtype=np.int64)).tolist() + rng.integers(0, 2**32, 300).tolist():
        data = ours.STATUS_LAYOUT.pack(1, bits)
        frame = (0x042A).to_bytes(2, "little") + b"\6\0\x81\x50" + data
        (theirs,) = decoded(frame)
        mine = Status.unpack(data)
        assert mine.homed == theirs.homed
        assert mine.homing == theirs.homing
        assert mine.moving == any(
            getattr(theirs, word)
            for word in ("moving_forward", "moving_reverse", "jogging_forward", "jogging_reverse", "homing")
        )
        ends = [f"{way}_limit_{kind}" for way in ("forward", "reverse") for kind in ("switch", "soft")]
        assert len(mine.limits) == sum(getattr(theirs, end) for end in ends)
        assert ("too hot" in mine.faults) == theirs.overtemp
        assert ("encoder fault" in mine.faults) == theirs.encoder_fault
        assert any("(position error)" in fault for fault in mine.faults) == theirs.motion_error
    device, _ = controller("K10CR1")
    answer = device.receive(apt.hw_req_info(UNIT, HOST))
    (theirs,) = decoded(answer)
    mine = Information.unpack(answer[6:])
    assert (mine.serial, mine.model) == (str(theirs.serial_number), "K10CR1")
    assert mine.firmware == ".".join(map(str, theirs.firmware_version))


@pytest.mark.parametrize("family", ["thorlabs", "k10cr1"])
def test_a_driver_sends_what_the_other_encoder_builds_and_nothing_else(family) -> None:
    """From opening to a stop: each message is one that the other package builds, and each of these is sent."""
    rig = RIGS[family](VirtualClock(), np.random.default_rng(1))
    rig.controller.switch_off_channel(rig.line.clock.now_s)
    rig.stage.home()
    rig.stage.move_to({"pan": 3.0})
    rig.stage.move_to({"pan": -2.0})
    rig.stage.stop()
    scale = rig.controller.model.mechanics.counts_per_deg
    of_family = FAMILIES[{"thorlabs": "KDC101", "k10cr1": "K10CR1"}[family]]
    ramp = math.floor(100.0 * scale * of_family.acceleration_factor)
    speed = math.floor(20.0 * scale * of_family.speed_factor)
    home_speed = math.floor(10.0 * scale * of_family.speed_factor)
    built = {
        apt.hw_req_info(UNIT, HOST),
        apt.hw_stop_updatemsgs(UNIT, HOST),
        apt.mod_req_chanenablestate(UNIT, HOST, 1),
        apt.mod_set_chanenablestate(UNIT, HOST, 1, 1),
        apt.mot_req_poscounter(UNIT, HOST, 1),
        apt.mot_req_velparams(UNIT, HOST, 1),
        apt.mot_set_velparams(UNIT, HOST, 1, 0, ramp, speed),
        apt.mot_req_homeparams(UNIT, HOST, 1),
        apt.mot_set_homeparams(UNIT, HOST, 1, 2, 1, home_speed, round(4.0 * scale)),
        apt.mot_req_genmoveparams(UNIT, HOST, 1),
        REQUEST_STATUS_BITS,
        apt.mot_move_home(UNIT, HOST, 1),
        apt.mot_move_stop(UNIT, HOST, 1, 2),
        apt.mot_move_absolute(UNIT, HOST, 1, round(3.0 * scale)),
        apt.mot_move_absolute(UNIT, HOST, 1, round(-2.0 * scale)),
    }
    built |= {apt.mot_ack_dcstatusupdate(UNIT, HOST)} if of_family.sign_of_life else set()
    rest, unsent = b"".join(rig.line.sent), set(built)
    while rest:
        message = next((candidate for candidate in built if rest.startswith(candidate)), None)
        assert message is not None, rest[:20].hex(" ")
        unsent.discard(message)
        rest = rest[len(message) :]
    assert unsent == set()


def test_the_scales_of_speed_are_those_of_the_document() -> None:
    k10 = FAMILIES["K10CR1"]
    assert k10.counts_per_deg * k10.speed_factor == pytest.approx(7_329_109, rel=1e-4)
    assert k10.counts_per_deg * k10.acceleration_factor == pytest.approx(1502, rel=1e-3)
    kdc = FAMILIES["KDC101"]
    assert PRM1Z8_COUNTS_PER_DEG * kdc.speed_factor == pytest.approx(42_941.66, rel=1e-4)
    assert PRM1Z8_COUNTS_PER_DEG * kdc.acceleration_factor == pytest.approx(14.66, rel=1e-3)
