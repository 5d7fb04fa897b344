"""The Gardasoft light: what it sends, and that no setting is taken for made that was not."""

from __future__ import annotations

import pytest

from drivers.errors import DriverError, LightFault, ReplyError, SettingRefused, WrongDevice
from drivers.light import LightSettings
from drivers.light.gardasoft import GardasoftLight
from tests.unit.drivers.rt_peer import RtPeer

FLICKER = LightSettings("square", 60.0, 30.0, 0.0, 2.5, sync_output=True)


@pytest.fixture
def peer() -> RtPeer:
    return RtPeer()


@pytest.fixture
def light(peer, clock) -> GardasoftLight:
    return GardasoftLight(peer, model="RT260-20", clock=clock)


def test_opening_sets_and_switches_nothing(light, peer) -> None:
    assert set(peer.sent) == {"VR"}
    assert light.identify().model == "RT260-20"
    assert light.identify().firmware == "V031"


def test_a_flicker_is_set_in_the_controllers_words_and_in_the_dark(light, peer) -> None:
    got = light.apply(FLICKER)
    assert got.frequency_hz == pytest.approx(60.0, rel=3e-4)
    assert got.duty_percent == pytest.approx(30.0, rel=3e-4)
    assert (got.high_v, got.low_v, got.sync_output) == (2.5, 0.0, True)
    assert [text for text in peer.sent if text[:2] in {"RS", "RT", "TT"}] == [
        "RS1,0",
        "TT1,16.6667",
        "TT0",
        "RT1,5.0000,0.01,50.0",
        "RT2,5.0000,0.01,100.0",
    ]
    assert not peer.lit


def test_a_light_that_is_on_stays_on_when_it_is_set_anew(light, peer) -> None:
    light.apply(FLICKER)
    light.on()
    light.apply(LightSettings(frequency_hz=50.0))
    assert peer.running == 1
    assert peer.period_ms == 20.0


def test_the_light_is_switched_by_its_trigger(light, peer) -> None:
    light.apply(FLICKER)
    light.on()
    assert light.is_on()
    assert peer.lit
    light.off()
    assert not light.is_on()


def test_without_sync_the_second_channel_is_dark(light, peer) -> None:
    light.apply(LightSettings(sync_output=False))
    assert peer.channels[2]["MD"] == 0
    assert peer.channels[2]["S"] == 0.0


def test_another_model_is_refused(peer, clock) -> None:
    with pytest.raises(WrongDevice, match="RT820, but RT260-20 answers"):
        GardasoftLight(peer, model="RT820", clock=clock)
    assert peer.closed


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (LightSettings("sine"), "square pulses only"),
        (LightSettings(low_v=1.0), "low_v must be 0"),
        (LightSettings(high_v=6.0), "at most 5 V"),
        (LightSettings(high_v=0.0), "above 0 V"),
    ],
)
def test_what_it_cannot_do_is_refused_before_anything_is_sent(light, peer, settings, message) -> None:
    peer.sent.clear()
    with pytest.raises(SettingRefused, match=message):
        light.apply(settings)
    assert peer.sent == []


def test_a_sync_without_a_channel_for_it_is_refused(peer, clock) -> None:
    light = GardasoftLight(peer, sync_channel=None, clock=clock)
    with pytest.raises(SettingRefused, match="no sync channel"):
        light.apply(FLICKER)


def test_a_period_that_is_held_in_its_range_is_refused(light, peer) -> None:
    with pytest.raises(SettingRefused, match=r"Err 5.*changed to a valid one"):
        light.apply(LightSettings(frequency_hz=300.0))


def test_a_brightness_beyond_the_lamp_is_refused(peer, clock) -> None:
    light = GardasoftLight(peer, full_percent=300.0, clock=clock)
    with pytest.raises(SettingRefused, match="Err 1"):
        light.apply(LightSettings(high_v=5.0))


def test_a_setting_that_does_not_stick_is_refused_with_both_values(light, peer) -> None:
    serve = peer.serve
    peer.serve = lambda command: serve(command.replace("RT1,5.0000", "RT1,4.9000"))
    with pytest.raises(SettingRefused, match=r"pulse width: asked 5\.0000 ms, got 4\.9000 ms"):
        light.apply(FLICKER)


def test_a_channel_that_shines_steadily_is_no_flicker(light) -> None:
    with pytest.raises(LightFault, match="channel 1 is not in pulse mode"):
        light.read()


def test_an_event_is_told_and_darkness_too(light, peer) -> None:
    light.apply(FLICKER)
    light.on()
    assert light.faults() == []
    peer.event = "Evt1,130"
    peer.running = 0
    assert light.faults() == [
        "the controller reports event Evt1,130 (see section 13.5 of its manual)",
        "the light was switched on, but is off",
    ]


def test_a_trigger_that_does_not_obey_is_a_fault(light, peer) -> None:
    light.apply(FLICKER)
    serve = peer.serve
    peer.serve = lambda command: "" if command in {"TT1", "TT0"} else serve(command)
    with pytest.raises(LightFault, match="does not run"):
        light.on()
    peer.running = 1
    with pytest.raises(LightFault, match="still runs"):
        light.off()


def test_off_goes_out_before_the_line_comes_into_step(light, peer) -> None:
    light.apply(FLICKER)
    light.on()
    peer.spoil = lambda reply: b""
    with pytest.raises(ReplyError):
        light.is_on()
    peer.spoil = lambda reply: reply
    peer.sent.clear()
    light.off()
    assert peer.sent[0] == "TT0"
    assert peer.running == 0


@pytest.mark.parametrize(
    "spoil",
    [
        lambda reply: reply[:-1],
        lambda reply: b"VR\r" + reply,
        lambda reply: reply + b">",
        lambda reply: b"\xff" + reply,
        lambda reply: b"TP 20.00ms>" if b"TM" in reply else reply,
    ],
    ids=["no prompt", "echo", "prompt twice", "eighth bit", "field missing"],
)
def test_a_controller_with_one_thing_wrong_is_refused(peer, clock, spoil) -> None:
    peer.spoil = spoil

    def open_and_apply() -> None:
        GardasoftLight(peer, clock=clock).apply(FLICKER)

    with pytest.raises(DriverError):
        open_and_apply()
    assert not peer.lit


STEADY = LightSettings("steady", low_v=2.5, high_v=2.5, sync_output=False)


def test_a_steady_light_is_dark_until_switched_on_and_dark_again_after(light, peer) -> None:
    assert light.apply(LightSettings("steady", high_v=2.5)) == STEADY
    assert not peer.lit
    light.on()
    assert (peer.running, peer.channels[1]["MD"], peer.channels[1]["S"]) == (0, 0, 50.0)
    assert light.is_on()
    assert light.read() == STEADY
    light.off()
    assert not light.is_on()
    assert peer.channels[1]["S"] == 0.0


def test_a_steady_light_is_switched_off_by_who_did_not_switch_it_on(light, peer, clock) -> None:
    light.apply(LightSettings("steady", high_v=2.5))
    light.on()
    another = GardasoftLight(peer, clock=clock)
    assert another.is_on()
    another.off()
    assert peer.channels[1]["S"] == 0.0


def test_a_steady_light_that_the_controller_holds_lower_is_refused(light, peer) -> None:
    light.apply(LightSettings("steady", high_v=2.5))
    serve = peer.serve
    peer.serve = lambda command: serve("RS1,40.0" if command == "RS1,50.0" else command)
    with pytest.raises(SettingRefused, match=r"a steady level of 50\.0 % was asked for"):
        light.on()


def test_a_flicker_follows_a_steady_light(light, peer) -> None:
    light.apply(LightSettings("steady", high_v=2.5))
    light.apply(FLICKER)
    light.on()
    assert peer.running == 1
    assert light.read().waveform == "square"


def test_a_period_beyond_all_numbers_is_no_period(light, peer) -> None:
    light.apply(LightSettings(frequency_hz=60.0))
    peer.spoil = lambda reply: reply.replace(b"TP ", b"TP " + 400 * b"9")
    with pytest.raises(ReplyError, match="no quantity TP"):
        light.read()
