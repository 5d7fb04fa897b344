"""Lights that a user describes from the maker's manual: prompts, other units that are read, commands without an answer."""

from __future__ import annotations

import pytest

from bench.stations.station_text import read_light_protocol
from drivers.errors import SettingRefused
from drivers.light import LightSettings
from drivers.light.text import TextLight
from tests.hil.text_wire import LINES, Wire, described


def test_settings_of_a_light_that_answers_queries_alone_are_read_back(clock) -> None:
    protocol = read_light_protocol(described("dc2100")).value.for_driver()
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
