"""Lights that a user describes from the maker's manual: prompts, other units that are read, commands without an answer."""

from __future__ import annotations

import pytest

from bench.stations.station_text import read_light_protocol
from drivers.errors import SettingRefused
from drivers.light import LightSettings
from drivers.light.text import TextLight
from tests.hil.direct_stages import VirtualClock
from tests.hil.text_wire import LINES, Wire


@pytest.fixture
def clock() -> VirtualClock:
    return VirtualClock()


MC2000B = """
format: starbench/light-protocol/1
maker: Thorlabs
model: MC2000B
line: {baudrate: 115200, request_end: CR, prompt: "> "}
identity: {send: "id?", reply: "{request} {firmware:text}"}
on: {send: "enable=1", reply: "{request} >"}
off: {send: "enable=0", reply: "{request} >"}
output: {send: "enable?", reply: "{request} {state:integer} >", when: [1]}
settings:
  - {quantity: frequency_hz, range: [4, 200], set: {send: "freq={value:integer}", reply: "{request} >"}, query: {send: "freq?", reply: "{request} {value:integer} >"}}
  - {quantity: level_percent, set: {send: "oncycle={value:integer}", reply: "{request} >"}, query: {send: "oncycle?", reply: "{request} {value:integer} >"}}
"""
"""Thorlabs MC2000B, Operating Manual, serial commands; published clients read up to a carriage return, ``>`` and a blank."""


def test_an_echo_and_a_prompt_around_an_answer_are_described(tmp_path, clock) -> None:
    (tmp_path / "light.yaml").write_text(MC2000B)
    protocol = read_light_protocol(tmp_path / "light.yaml").value.for_driver()
    wire, known = (
        Wire(clock, LINES),
        {"id": "MC2000B Ver 1.0.10", "enable": "0", "freq": "20", "oncycle": "50"},
    )

    def answer(request: str) -> str:
        name, is_set, value = request.partition("=")
        if is_set:
            known[name] = value
            return f"{request}\r> "
        return f"{request}\r{known.get(name.rstrip('?'), 'CMD_NOT_DEFINED')}\r> "

    wire.answer = answer
    light = TextLight(wire, protocol, clock=clock)
    light.apply(LightSettings(frequency_hz=60.0, sync_output=False))
    light.on()
    assert (known["freq"], known["enable"]) == ("60", "1")
    assert light.is_on()
    assert wire.sent.count("id?") == 1  # nothing brought the line out of step


FY6900 = """
format: starbench/light-protocol/1
maker: FeelElec
model: FY6900
line: {baudrate: 115200}
identity: {send: UMO, reply: "{firmware:text}"}
serial: {send: UID, reply: "{serial:word}"}
on: {send: WMN1}
off: {send: WMN0}
output: {send: RMN, reply: "{state:integer}", when: [255]}
settings:
  - {quantity: waveform, words: {square: "01", sine: "00"}, set: {send: "WMW{value:word}"}, query: {send: RMW, reply: "{value:integer}"}}
  - {quantity: frequency_hz, factor: 1.0e+6, query_factor: 1, set: {send: "WMF{value:integer.14}"}, query: {send: RMF, reply: "{value:number}"}}
  - {quantity: duty_percent, query_factor: 1000, set: {send: "WMD{value:number.1}"}, query: {send: RMD, reply: "{value:integer}"}}
  - {quantity: level_percent, factor: 0.05, query_factor: 500, set: {send: "WMA{value:number.2}"}, query: {send: RMA, reply: "{value:integer}"}}
"""
"""FeelElec FY6900, "Serial communication protocol": each command is answered by a line feed; what is read has other units."""


def test_a_generator_may_read_back_in_other_units_than_it_is_set(tmp_path, clock) -> None:
    (tmp_path / "light.yaml").write_text(FY6900)
    protocol = read_light_protocol(tmp_path / "light.yaml").value.for_driver()
    wire = Wire(clock, LINES)
    told = {
        "UMO": "FY6900-60M",
        "UID": "8112345678",
        "RMN": "0",
        "RMW": "0",
        "RMF": "00000100.000000",
        "RMD": "50000",
        "RMA": "10000",
    }

    def answer(request: str) -> str:
        name, value = f"R{request[1:3]}", request[3:]
        if not request.startswith("W"):
            return f"{told.get(request, '')}\n"
        told[name] = {
            "RMN": lambda: "255" if value == "1" else "0",
            "RMW": lambda: str(int(value)),
            "RMF": lambda: f"{int(value) / 1e6:015.6f}",
            "RMD": lambda: str(round(float(value) * 1000)),
            "RMA": lambda: str(round(float(value) * 10000)),
        }[name]()
        return "\n"

    wire.answer = answer
    light = TextLight(wire, protocol, serial="8112345678", clock=clock)
    got = light.apply(LightSettings(frequency_hz=60.0, duty_percent=25.0, high_v=2.5, sync_output=False))
    assert {"WMW01", "WMF00000060000000", "WMD25.0", "WMA2.50"} <= set(wire.sent)
    assert (got.waveform, got.frequency_hz, got.duty_percent, got.high_v) == ("square", 60.0, 25.0, 2.5)
    light.on()
    assert light.is_on()


DC2100 = """
format: starbench/light-protocol/1
maker: Thorlabs
model: DC2100
line: {baudrate: 115200, reply_end: CRLF}
identity: {send: "N?", reply: "{firmware:text}"}
serial: {send: "S?", reply: "{serial:word}"}
on: {send: "O 1"}
off: {send: "O 0"}
output: {send: "O?", reply: "{state:integer}", when: [1]}
faults: {send: "R?", reply: "{state:integer}", when: [0], bits: [1, 3, 5]}
settings:
  - {quantity: constant, value: 1, set: {send: "M {value:integer}"}, query: {send: "M?", reply: "{value:integer}"}}
  - {quantity: frequency_hz, range: [1, 10000], set: {send: "PF {value:integer}"}, query: {send: "PF?", reply: "{value:integer}"}}
  - {quantity: duty_percent, range: [1, 99], set: {send: "PD {value:integer}"}, query: {send: "PD?", reply: "{value:integer}"}}
  - {quantity: level_percent, factor: 10, set: {send: "PC {value:integer}"}, query: {send: "PC?", reply: "{value:integer}"}}
"""
"""Thorlabs DC2100, Operation Manual, commands M, PF, PD, PC, O, R: mode 1 is PWM; the current in mA, 1000 at 100 %."""


def test_settings_of_a_light_that_answers_queries_alone_are_read_back(tmp_path, clock) -> None:
    (tmp_path / "light.yaml").write_text(DC2100)
    protocol = read_light_protocol(tmp_path / "light.yaml").value.for_driver()
    wire = Wire(clock, LINES)
    known = {
        "M": "0",
        "PF": "100",
        "PD": "50",
        "PC": "0",
        "O": "0",
        "N": "DC2100 V1.2",
        "S": "M00245678",
        "R": "16",
    }

    def answer(request: str) -> str:
        if request.endswith("?"):
            return f"{known[request[:-1]]}\r\n"
        name, _, value = request.partition(" ")
        known[name] = value if name != "PF" else str(min(int(value), 5000))
        return ""

    wire.answer = answer
    light = TextLight(wire, protocol, serial="M00245678", clock=clock)
    got = light.apply(LightSettings(frequency_hz=60.0, duty_percent=25.0, high_v=2.5, sync_output=False))
    assert (known["M"], known["PF"], known["PD"], known["PC"]) == ("1", "60", "25", "500")
    assert (got.frequency_hz, got.duty_percent, got.high_v) == (60.0, 25.0, 2.5)
    light.on()
    assert light.is_on()
    assert light.faults() == []
    with pytest.raises(SettingRefused, match="asked 9000"):
        light.apply(LightSettings(frequency_hz=9000.0, sync_output=False))
