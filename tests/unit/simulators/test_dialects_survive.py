"""Whatever a client sends, a simulated device answers or is silent; it never raises."""

import struct
from collections.abc import Callable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulators.assembly import make_light, make_stage
from simulators.config import LIGHT_KINDS, STAGE_KINDS, BenchConfig, LightConfig, bench_config
from simulators.ports.serial_device import Dialect
from simulators.stages.ximc import crc16


def with_crc(letters: bytes, data: bytes) -> bytes:
    return letters + data + struct.pack("<H", crc16(data))


def words(text: str) -> list[bytes]:
    """Split a text at its bars."""
    return [word.encode("latin-1") for word in text.split("|")]


NUMBERS = words("0|-1|1e999|nan|inf|1_0|99999999999999999999|.|-|0x10|5|-3.5")

#: Messages of each kind's protocol, which are joined at random, with noise between.
WORDS: dict[str, list[bytes]] = {
    "zaber": words(
        "/1 1 |/0 0 7 |home|move abs |move rel |set maxspeed |set limit.max |get pos"
        "|tools parking park|stop|warnings clear|set pos |\n|:00| "
    ),
    "grbl": words("$H|$X|$$|$J=|G0 |G1 |X|Y|F|G91 |$110=|$120=|$100=|\n|?|\x18|\x85"),
    "esp301": words("1MO|1OR|1PA|2PA|1VA|1AC|1DH|1WS|TB?|1TP|;|\r"),
    "keysight": words(
        "FREQ |VOLT:HIGH |VOLT:OFFS |FUNC:SQU:DCYC |OUTP |OUTP:LOAD |SYST:ERR?|*CLS|;|:|,|\n|?"
    ),
    "siglent": words("C1:BSWV |FRQ,|HLEV,|LLEV,|DUTY,|C1:OUTP LOAD,|C1:BSWV?|,|;|\n"),
    "flir_ptu": words("PP|TP|PS|PA|PNU|RP|R|H|FT|LU|VS| |-"),
    "microcontroller": words("FREQ |DUTY |LEVEL |WAVE |ON*01|ID?*28|DOG |*|?|\n"),
    "gardasoft": words("RT1,|RS1,|TT1,|ST1|GR|,|us|;|\r"),
    "ximc": [
        *words("gets|home|zero|stop|sstp|left|gmov|\0"),
        with_crc(b"move", struct.pack("<ih6x", 2**31 - 1, 32767)),
        with_crc(b"move", struct.pack("<ih6x", -(2**31), 0)),
        with_crc(b"shom", struct.pack("<IBIBihH9x", 0, 0, 0, 0, 0, 0, 0)),
        with_crc(b"smov", struct.pack("<IBHHIBB9x", 2**32 - 1, 255, 65535, 1, 0, 0, 0)),
        with_crc(b"seds", struct.pack("<BBihih6x", 0, 0, 5, 0, -5, 0)),
    ],
    "thorlabs_apt": [
        bytes.fromhex(message)
        for message in (
            "05 00 00 00 50 01",
            "11 00 00 00 50 01",
            "43 04 01 00 50 01",
            "65 04 01 01 50 01",
            "29 04 01 00 50 01",
            "90 04 01 00 50 01",
            "92 04 00 00 50 01",
            "10 02 01 02 50 01",
            "53 04 06 00 d0 01 01 00 ff ff ff 7f",
            "48 04 06 00 d0 01 01 00 00 00 00 80",
            "13 04 0e 00 d0 01 01 00 00 00 00 00 00 00 00 00 ff ff ff ff",
            "13 04 ff ff d0 01",
        )
    ],
}
WORDS["rigol"] = [word.replace(b"FREQ", b":SOUR1:FREQ") for word in WORDS["keysight"]]


def build(kind: str, clock: Callable[[], float]) -> Dialect:
    if kind in LIGHT_KINDS:
        return make_light(LightConfig(kind=kind), clock, lambda _state: None)
    config: BenchConfig = bench_config({"stage": {"kind": kind}})
    stage = make_stage(kind, config.axes, clock, lambda _name, _pointing: None)
    return next(iter(stage.dialects.values()))


@pytest.mark.parametrize("kind", [*STAGE_KINDS, *LIGHT_KINDS])
@settings(max_examples=50, deadline=None)
@given(data=st.data())
def test_a_device_survives_everything(kind, data):
    now_s = 0.0
    device = build(kind, lambda: now_s)
    alone, ends = [*WORDS[kind], *NUMBERS], (b"\r", b"\n")
    lines = [word + number + end for word in WORDS[kind] for number in NUMBERS for end in ends]
    piece = st.one_of(st.sampled_from(alone), st.sampled_from(lines), st.binary(max_size=8))
    for pieces, wait_s in data.draw(
        st.lists(st.tuples(st.lists(piece, max_size=8), st.floats(0.0, 2.0)), max_size=8)
    ):
        assert isinstance(device.receive(b"".join(pieces)), bytes)
        now_s += wait_s
        assert isinstance(device.unsolicited(), bytes)
