"""Whatever a client sends, a simulated device answers or is silent; it never raises."""

from __future__ import annotations

import struct
from collections.abc import Callable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulators.assembly import make_light, make_stage
from simulators.config import LIGHT_KINDS, STAGE_KINDS, BenchConfig, LightConfig, bench_config
from simulators.ports.serial_device import Dialect
from simulators.stages.dynamixel import crc_of
from simulators.stages.ximc import crc16


def with_crc(letters: bytes, data: bytes) -> bytes:
    return letters + data + struct.pack("<H", crc16(data))


def packet(servo: int, *content: int) -> bytes:
    begins = b"\xff\xff\xfd\x00" + struct.pack("<BH", servo, len(content) + 2) + bytes(content)
    return begins + crc_of(begins).to_bytes(2, "little")


apt = bytes.fromhex


NUMBERS = [
    b"0",
    b"-1",
    b"1e999",
    b"nan",
    b"inf",
    b"1_0",
    b"99999999999999999999",
    b".",
    b"-",
    b"0x10",
    b"5",
    b"-3.5",
]

#: Messages of each kind's protocol, which are joined at random, with noise between.
WORDS: dict[str, list[bytes]] = {
    "zaber": [
        b"/1 1 ",
        b"/0 0 7 ",
        b"home",
        b"move abs ",
        b"move vel ",
        b"set maxspeed ",
        b"set limit.max ",
        b"get pos",
        b"tools parking park",
        b"stop",
        b"warnings clear",
        b"system reset",
        b"set pos ",
        b"\n",
        b":00",
        b" ",
    ],
    "ximc": [
        b"gets",
        b"home",
        b"zero",
        b"stop",
        b"sstp",
        b"left",
        b"rigt",
        b"gmov",
        b"\0",
        with_crc(b"move", struct.pack("<ih6x", 2**31 - 1, 32767)),
        with_crc(b"movr", struct.pack("<ih6x", -(2**31), 0)),
        with_crc(b"shom", struct.pack("<IBIBihH9x", 0, 0, 0, 0, 0, 0, 0)),
        with_crc(b"smov", struct.pack("<IBHHIBB9x", 2**32 - 1, 255, 65535, 1, 0, 0, 0)),
        with_crc(b"seds", struct.pack("<BBihih6x", 0, 0, 5, 0, -5, 0)),
    ],
    "grbl": [
        b"$H",
        b"$X",
        b"$$",
        b"$J=",
        b"G0 ",
        b"G1 ",
        b"G4 P",
        b"X",
        b"Y",
        b"F",
        b"G91 ",
        b"$110=",
        b"$120=",
        b"$100=",
        b"\n",
        b"?",
        b"!",
        b"~",
        b"\x18",
        b"\x85",
    ],
    "esp301": [
        b"1MO",
        b"1OR",
        b"1PA",
        b"1PR",
        b"2PA",
        b"1VA",
        b"1AC",
        b"1DH",
        b"1WS",
        b"TB?",
        b"1TP",
        b"RS",
        b"AB",
        b";",
        b"\r",
    ],
    "keysight": [
        b"FREQ ",
        b"VOLT:HIGH ",
        b"VOLT ",
        b"FUNC:SQU:DCYC ",
        b"OUTP ",
        b"OUTP:LOAD ",
        b"SYST:ERR?",
        b"*RST",
        b";",
        b":",
        b",",
        b"\n",
        b"?",
    ],
    "siglent": [
        b"C1:BSWV ",
        b"FRQ,",
        b"HLEV,",
        b"LLEV,",
        b"DUTY,",
        b"C1:OUTP LOAD,",
        b"C1:BSWV?",
        b",",
        b";",
        b"\n",
    ],
    "flir_ptu": [
        b"PP",
        b"TP",
        b"PO",
        b"PS",
        b"PA",
        b"PNU",
        b"RP",
        b"R",
        b"H",
        b"FT",
        b"LU",
        b"VS",
        b" ",
        b"-",
    ],
    "microcontroller": [
        b"FREQ ",
        b"DUTY ",
        b"LEVEL ",
        b"WAVE ",
        b"ON*01",
        b"ID?*28",
        b"DOG ",
        b"*",
        b"?",
        b"\n",
    ],
    "thorlabs_apt": [
        apt("05 00 00 00 50 01"),
        apt("11 00 00 00 50 01"),
        apt("43 04 01 00 50 01"),
        apt("65 04 01 01 50 01"),
        apt("29 04 01 00 50 01"),
        apt("90 04 01 00 50 01"),
        apt("92 04 00 00 50 01"),
        apt("10 02 01 02 50 01"),
        apt("53 04 06 00 d0 01 01 00 ff ff ff 7f"),
        apt("48 04 06 00 d0 01 01 00 00 00 00 80"),
        apt("10 04 06 00 d0 01 01 00 ff ff ff 7f"),
        apt("13 04 0e 00 d0 01 01 00 00 00 00 00 00 00 00 00 ff ff ff ff"),
        apt("13 04 ff ff d0 01"),
    ],
    "dynamixel": [
        packet(1, 1),
        packet(254, 1),
        packet(1, 2, 0, 0, 147, 0),
        packet(1, 2, 255, 255, 255, 255),
        packet(1, 3, 11, 0, 4),
        packet(1, 3, 64, 0, 1),
        packet(1, 3, 108, 0, 255, 127, 0, 0),
        packet(1, 3, 116, 0, 255, 255, 15, 0),
        packet(1, 3, 116, 0, 1, 0),
        packet(2, 4, 116, 0, 1, 0, 0, 0),
        packet(254, 5),
        packet(1, 8),
        packet(254, 131, 116, 0, 4, 0, 1, 9),
        packet(254, 130, 132, 0, 4, 0, 1, 2, 3),
        packet(1, 16),
        b"\xff\xff\xfd\x00\x01\xff\xff",
    ],
    "gardasoft": [b"RT1,", b"RS1,", b"TT1,", b"ST1", b"TR", b"GR", b",", b"us", b";", b"\r"],
}
WORDS["rigol"] = [word.replace(b"FREQ", b":SOUR1:FREQ") for word in WORDS["keysight"]]


def build(kind: str, clock: Callable[[], float]) -> Dialect:
    if kind in LIGHT_KINDS:
        return make_light(LightConfig(kind=kind), clock, lambda _state: None)
    config: BenchConfig = bench_config({"stage": {"kind": kind}})
    stage = make_stage(kind, config.axes, clock, lambda _name, _pointing: None)
    return next(iter(stage.dialects.values()))


@pytest.mark.parametrize("kind", [*STAGE_KINDS, *LIGHT_KINDS])
@settings(max_examples=150, deadline=None)
@given(data=st.data())
def test_a_device_survives_everything(kind, data):
    now_s = 0.0
    device = build(kind, lambda: now_s)
    word, number = st.sampled_from(WORDS[kind]), st.sampled_from(NUMBERS)
    piece = st.one_of(
        word,
        number,
        st.binary(max_size=8),
        st.tuples(word, number, st.sampled_from([b"\r", b"\n"])).map(b"".join),
    )
    for said, wait_s in data.draw(
        st.lists(st.tuples(st.lists(piece, max_size=8), st.floats(0.0, 2.0)), max_size=8)
    ):
        assert isinstance(device.receive(b"".join(said)), bytes)
        now_s += wait_s
        assert isinstance(device.unsolicited(), bytes)
