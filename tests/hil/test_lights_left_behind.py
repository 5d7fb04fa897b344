"""Lights as other programs leave them: what was left on does not survive into a recording, and is read back."""

import pytest

from drivers.errors import DriverError, SettingRefused
from drivers.light import LightSettings
from drivers.light.gardasoft import GardasoftLight
from simulators.assembly import make_light
from simulators.config import LightConfig
from simulators.errors import ConfigError
from tests.hil.direct_lights import OPENED
from tests.hil.direct_stages import VirtualClock, direct_line
from tests.unit.drivers.light.generator_bench import Bench

pytestmark = pytest.mark.usefixtures("never_late")

FLICKER = LightSettings("square", 50.0, 40.0, 0.0, 3.0, sync_output=True)
STEADY = LightSettings("steady", high_v=3.0)
LEFT = [
    ("keysight", "AM FM FSKey SWEep BURSt"),
    ("rigol", "MOD AM FM PM ASK FSKey PSK PWM SWEep BURSt SYNC2"),
    ("siglent", "MDWV SWWV BTWV CMBN PLRT INVT"),
    ("siglent", "CHDR-LONG MDWV PLRT INVT"),
    ("siglent", "CHDR-OFF BTWV CMBN"),
    ("gardasoft", "echo events"),
    ("gardasoft", "switched"),
    ("gardasoft", "selected echo"),
    ("gardasoft", "retrigger events"),
]


class Rig:
    """A simulated light as another program left it, its line, and the driver for it."""

    def __init__(self, kind: str, left: str) -> None:
        self.clock, self.states = VirtualClock(), []
        self.device = make_light(
            LightConfig(kind, left_behind=left), self.clock.monotonic, self.states.append
        )
        self.line = direct_line(self.device, self.clock)
        self.light = OPENED[kind](self.line, self.clock)


@pytest.mark.parametrize(("kind", "left"), LEFT)
@pytest.mark.parametrize(
    ("asked", "expected"),
    [(FLICKER, {"sync": True, "low_v": 0.0, "frequency_hz": 50.0, "high_v": 3.0}), (STEADY, {"low_v": 3.0})],
    ids=["flicker", "steady"],
)
def test_a_light_is_the_one_that_was_asked_for_whatever_was_left_behind(kind, left, asked, expected) -> None:
    rig = Rig(kind, left)
    before = len(rig.states)
    rig.light.apply(asked)
    assert not any(state.output and state.high_v > 0 for state in rig.states[before:])
    rig.light.on()
    now = rig.states[-1]
    assert now.output
    assert {name: getattr(now, name) for name in expected} == pytest.approx(expected, abs=2e-3)
    assert rig.light.faults() == []
    rig.light.off()
    assert not rig.states[-1].output or (asked == STEADY and rig.states[-1].high_v == 0.0)


def test_what_a_light_cannot_have_left_behind_is_refused_with_what_it_can() -> None:
    with pytest.raises(ConfigError, match=r"'AM' .*CHDR-LONG"):
        Rig("siglent", "AM")


# ---------------------------------------------------------------- generators


@pytest.mark.parametrize(
    "modulations",
    [
        ("AM", "FM", "PM", "PWM", "FSKey", "BPSK", "SUM", "SWEep", "BURSt"),  # 33500B
        ("AM", "FM", "PM", "ASK", "FSKey", "PSK", "PWM", "SWEep", "BURSt"),  # DG1000Z
        ("MOD", "SWEep", "BURSt"),  # DG4000
        ("QPSK", "OSK", "IQ", "HARM", "BURSt"),
    ],
)
@pytest.mark.parametrize("numbered", [True, False])
@pytest.mark.parametrize("error_queue", [True, False])
def test_every_modulation_that_a_generator_has_is_ended_and_read_back(
    modulations, numbered, error_queue
) -> None:
    dialect = "numbered" if numbered else "keysight"
    bench = Bench(dialect, modulations=modulations, error_queue=error_queue)
    for name in modulations:
        bench.device.leave(name)
    bench.open().apply(FLICKER)
    assert bench.device.modulations == set()
    prefix = "SOUR1:" if numbered else ""
    short = "".join(letter for letter in modulations[0] if letter.isupper())
    assert f"{prefix}{short}:STAT?" in bench.sent()


@pytest.mark.parametrize(
    ("left", "ignored", "fault"),
    [
        ("PWM", "SOUR1:PWM:STAT OFF", r"modulation PWM stays .* 'SOUR1:PWM:STAT\?' is answered by 'ON'"),
        ("SYNC2", "OUTP:SYNC:SOUR CH1", r"sync output's channel stays .* is answered by 'CH2'"),
    ],
)
def test_what_stays_on_although_the_command_was_accepted_is_refused_by_its_name(left, ignored, fault) -> None:
    bench = Bench("numbered", modulations=("PWM",))
    bench.device.leave(left)
    bench.line.turn(ignored, "")
    with pytest.raises(SettingRefused, match=fault):
        bench.open().apply(FLICKER)


def test_a_siglent_that_loses_the_command_after_that_of_the_waveform_is_set_all_the_same() -> None:
    """A BK 4055B hangs at a command of 52 bytes by USB, too (the package BK4055B's tests)."""
    bench = Bench("siglent", loses_next=True)
    light = bench.open()
    assert light.apply(FLICKER) == FLICKER
    bench.device.change(sync=False, shape="sine")
    assert light.apply(FLICKER) == FLICKER
    assert max(map(len, bench.line.sent)) < 30


@pytest.mark.parametrize(("low_v", "high_v"), [(6.0, 8.0), (-8.0, -6.0), (-5.0, 0.5)])
def test_the_levels_of_a_siglent_never_cross_those_that_were_left(low_v, high_v) -> None:
    bench = Bench("siglent")
    bench.device.change(load_ohm=float("inf"), shape="square", low_v=low_v, high_v=high_v)
    got = bench.open().apply(FLICKER)
    assert (got.low_v, got.high_v) == (0.0, 3.0)


# ---------------------------------------------------------------- strobe controllers


def test_events_that_come_unasked_are_faults_and_no_answers() -> None:
    rig = Rig("gardasoft", "events")
    rig.device.trip()
    assert not rig.light.is_on()
    (fault,) = rig.light.faults()
    assert "Evt1,130;" in fault
    assert rig.light.apply(FLICKER).frequency_hz == pytest.approx(50.0)


@pytest.mark.parametrize("event", ["Evt1,5\r\n", "Evt0,12;", "\n\rEvt2,131;\n\r"])
@pytest.mark.parametrize("where", ["before", "after"])
def test_an_event_within_a_reply_is_kept_and_the_reply_is_read(event, where) -> None:
    rig = Rig("gardasoft", "")
    mixed = [1]

    def spoil(reply: bytes) -> bytes:
        if not mixed:
            return reply
        mixed.clear()
        text = event.encode()
        return text + reply if where == "before" else reply.replace(b">", text + b">")

    rig.line.spoil = spoil
    assert rig.light.apply(FLICKER).frequency_hz == pytest.approx(50.0)
    (fault,) = rig.light.faults()
    assert fault.partition(" event ")[2].partition(" (")[0] == event.strip()


@pytest.mark.parametrize(
    "echo",
    [
        lambda sent, reply: sent.strip() + reply,
        lambda sent, reply: sent + reply,
        lambda sent, reply: sent.strip() + b"\n\r" + reply,
        lambda sent, reply: sent.strip().lower() + b" " + reply.replace(b"\r\n", b"\n\r"),
    ],
)
def test_a_controller_that_echoes_is_served_whatever_the_form_of_its_echo(echo) -> None:
    rig = Rig("gardasoft", "")
    rig.line.spoil = lambda reply: echo(rig.line.sent[-1], reply)
    light = GardasoftLight(rig.line, clock=rig.clock)
    assert light.identify().model == "RT460-20"
    light.apply(FLICKER)
    light.on()
    assert rig.states[-1].output
    assert light.faults() == []
    light.off()
    assert not rig.states[-1].output


def test_a_lamp_that_an_input_may_switch_on_is_not_said_to_be_off() -> None:
    rig = Rig("gardasoft", "switched")
    assert rig.light.is_on()
    rig.light.off()
    assert rig.device.outputs[1].percent == 0.0


def test_a_controller_that_ignores_triggers_for_longer_than_a_period_is_refused() -> None:
    rig = Rig("gardasoft", "retrigger")
    rig.line.turn("60.0,0\r", "60.0\r")
    with pytest.raises(SettingRefused, match=r"retrigger delay: .* 0\.0000 ms, .* 500\.0000 ms"):
        rig.light.apply(FLICKER)


@pytest.mark.parametrize(
    "version", ["RT420F-20 (HW02) V031", "TR-RC120 (HW01) V012", "VTR1 (HW001) V001", "RT860F-2 V1.20"]
)
def test_a_controller_of_the_family_is_known_by_its_model(version) -> None:
    rig = Rig("gardasoft", "")
    rig.line.spoil = lambda reply: reply.replace(b"RT460-20 (HW02) V031", version.encode())
    light = GardasoftLight(rig.line, clock=rig.clock)
    assert light.identify().model == version.split()[0]


@pytest.mark.parametrize(
    "form",
    [
        lambda reply: reply.replace(b", ", b","),
        lambda reply: reply.replace(b", ", b",\r\n"),
        lambda reply: reply.replace(b"MD ", b"MD=").replace(b"S ", b"S").replace(b"TM ", b"TM="),
        lambda reply: reply.replace(b"TP 20.000ms", b"TP 20ms").replace(b"PU 8.000ms", b"PU 8000us"),
        lambda reply: reply.replace(b"PU 8.000ms", b"PU 0.008s").replace(b"60.0%", b"60%"),
    ],
)
def test_the_state_of_a_channel_is_read_in_another_layout(form) -> None:
    rig = Rig("gardasoft", "")
    rig.line.spoil = form
    got = rig.light.apply(FLICKER)
    assert (got.frequency_hz, got.duty_percent, got.high_v) == pytest.approx((50.0, 40.0, 3.0))


# ---------------------------------------------------------------- restarts


@pytest.mark.parametrize("boot", ["SBLIGHT booting...\r\n", "Arduino ready\r\n"])
def test_a_board_that_restarts_while_it_is_lit_is_told_as_off(boot) -> None:
    rig = Rig("microcontroller", "")
    rig.light.apply(FLICKER)
    rig.light.on()
    rig.device.exchange("SG0042")
    rig.line.ready += boot.encode()
    assert any("is off" in fault for fault in rig.light.faults())
    with pytest.raises(DriverError):
        rig.light.apply(LightSettings("sine"))
    assert rig.light.apply(FLICKER).frequency_hz == pytest.approx(50.0)
