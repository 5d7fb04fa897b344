"""Thorlabs' protocol, byte by byte: our driver's messages, and what it reads out of those of a controller.

The bytes and the names of the bits are those of the package `thorlabs_apt_protocol` 29.0.0, which others wrote from the
same document.
"""

import numpy as np
import pytest

from drivers.stage.thorlabs_messages import CONNECTED, FAMILIES, STATUS_LAYOUT, Information, Status
from tests.hil.direct_stages import FAMILIES as RIGS
from tests.hil.direct_stages import PRM1Z8_COUNTS_PER_DEG, VirtualClock, of_bench

REQUEST_UPDATE, STILL_THERE = bytes.fromhex("900401005001"), bytes.fromhex("920400005001")
OF_ALL = {
    "hw_req_info": "05 00 00 00 50 01",
    "hw_stop_updatemsgs": "12 00 00 00 50 01",
    "mod_req_chanenablestate": "11 02 01 00 50 01",
    "mod_set_chanenablestate": "10 02 01 01 50 01",
    "mot_req_poscounter": "11 04 01 00 50 01",
    "mot_req_velparams": "14 04 01 00 50 01",
    "mot_req_homeparams": "41 04 01 00 50 01",
    "mot_req_genmoveparams": "3b 04 01 00 50 01",
    "mot_req_statusbits": "29 04 01 00 50 01",  # from the document: the package has none
    "mot_move_home": "43 04 01 00 50 01",
    "mot_move_stop": "65 04 01 02 50 01",
}
OF_FAMILY = {
    "thorlabs": {
        "mot_set_velparams": "13 04 0e 00 d0 01 01 00 00 00 00 00 b9 05 00 00 d1 1a 0d 00",
        "mot_set_homeparams": "40 04 0e 00 d0 01 01 00 02 00 01 00 68 8d 06 00 ff 1d 00 00",
        "mot_move_absolute to 3 deg": "53 04 06 00 d0 01 01 00 7f 16 00 00",
        "mot_move_absolute to -2 deg": "53 04 06 00 d0 01 01 00 01 f1 ff ff",
        "mot_ack_dcstatusupdate": STILL_THERE.hex(),
    },
    "k10cr1": {
        "mot_set_velparams": "13 04 0e 00 d0 01 01 00 00 00 00 00 ba 4a 02 00 aa aa bc 08",
        "mot_set_homeparams": "40 04 0e 00 d0 01 01 00 02 00 01 00 55 55 5e 04 55 55 08 00",
        "mot_move_absolute to 3 deg": "53 04 06 00 d0 01 01 00 00 40 06 00",
        "mot_move_absolute to -2 deg": "53 04 06 00 d0 01 01 00 55 d5 fb ff",
    },
}


@pytest.mark.parametrize("family", OF_FAMILY)
def test_a_driver_sends_what_another_encoder_builds_and_nothing_else(family) -> None:
    """From opening to a stop, with a speed of 20 deg/s: each of these messages is sent, and no other."""
    rig = RIGS[family](VirtualClock(), np.random.default_rng(1))
    rig.controller.switch_off_channel(rig.line.clock.now_s)
    rig.stage.home()
    rig.stage.move_to({"pan": 3.0})
    rig.stage.move_to({"pan": -2.0})
    rig.stage.stop()
    known = {bytes.fromhex(text): name for name, text in {**OF_ALL, **OF_FAMILY[family]}.items()}
    rest, sent = b"".join(rig.line.sent), set()
    while rest:
        message = next((message for message in known if rest.startswith(message)), None)
        assert message is not None, rest[:20].hex(" ")
        sent.add(known[message])
        rest = rest[len(message) :]
    assert sent == set(known.values())


BITS = {
    **dict.fromkeys(range(4), "limits"),  # forward and reverse: of a switch, of the controller
    **dict.fromkeys(range(4, 8), "moving"),  # forward and reverse, jogging forward and reverse
    9: "homing moving",
    10: "homed",
    **dict.fromkeys((14, 15, 17, 18, 19, 24, 25, 26, 27, 30), "faults"),
}
WORDS = {14: "position error", 17: "too hot", 18: "supply voltage", 25: "encoder", 26: "current"}


def test_the_bits_of_a_status_have_the_meanings_that_another_decoder_gives_them() -> None:
    for bit in range(32):
        status = Status.unpack(STATUS_LAYOUT.pack(1, 1 << bit | CONNECTED))
        told = {name for name in ("limits", "moving", "homing", "homed", "faults") if getattr(status, name)}
        assert told == set(BITS.get(bit, "").split()), bit
        assert WORDS.get(bit, "") in "".join(status.faults)


def test_serial_number_model_and_firmware_stand_at_their_places() -> None:
    device, _ = of_bench("thorlabs_apt", 136_533, "27000123")(VirtualClock().monotonic)
    answer = device.receive(bytes.fromhex(OF_ALL["hw_req_info"]))
    data = answer[6:]
    information = Information.unpack(data)
    assert answer[:6].hex(" ") == "06 00 54 00 81 50"
    assert information.serial == str(int.from_bytes(data[:4], "little")) == "27000123"
    assert information.model == data[4:12].rstrip(b"\0").decode()
    assert information.firmware == ".".join(map(str, data[16:13:-1]))


def test_the_scales_of_speed_are_those_of_the_document() -> None:
    k10 = FAMILIES["K10CR1"]
    assert k10.counts_per_deg * k10.speed_factor == pytest.approx(7_329_109, rel=1e-4)
    assert k10.counts_per_deg * k10.acceleration_factor == pytest.approx(1502, rel=1e-3)
    kdc = FAMILIES["KDC101"]
    assert PRM1Z8_COUNTS_PER_DEG * kdc.speed_factor == pytest.approx(42_941.66, rel=1e-4)
    assert PRM1Z8_COUNTS_PER_DEG * kdc.acceleration_factor == pytest.approx(14.66, rel=1e-3)


def test_a_servo_controller_sends_no_more_updates_without_signs_of_life() -> None:
    device = RIGS["thorlabs"](VirtualClock(), np.random.default_rng(1)).controller
    assert len([1 for _ in range(60) if device.receive(REQUEST_UPDATE)]) == 50
    assert device.receive(STILL_THERE + REQUEST_UPDATE)
