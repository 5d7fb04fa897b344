"""Lights that a user describes from the maker's manual: prompts, other units that are read, commands without an answer."""

import pytest

from bench.stations.text_descriptions import LightProtocol
from drivers.errors import SettingRefused
from drivers.light import LightSettings
from drivers.light.text import TextLight
from sequences.reader import read_document
from tests.hil.text_wire import LINES, Wire, described


def test_an_echo_and_a_prompt_around_an_answer_are_described(clock) -> None:
    protocol = read_document(described("mc2000b"), LightProtocol).value.for_driver()
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


def test_a_generator_may_read_back_in_other_units_than_it_is_set(clock) -> None:
    protocol = read_document(described("fy6900"), LightProtocol).value.for_driver()
    wire = Wire(clock, LINES)
    answers = {
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
            return f"{answers.get(request, '')}\n"
        answers[name] = {
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


def test_settings_of_a_light_that_answers_queries_alone_are_read_back(clock) -> None:
    protocol = read_document(described("dc2100"), LightProtocol).value.for_driver()
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
