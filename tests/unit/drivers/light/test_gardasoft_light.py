"""The Gardasoft light on its simulated controller: what it sends, and that no setting is taken for made that was not."""

import pytest

from drivers.errors import LightFault, SettingRefused, WrongDevice
from drivers.light import LightSettings
from drivers.light.gardasoft import GardasoftLight
from simulators.lights.gardasoft import CONTINUOUS, GardasoftRt
from simulators.world.world import LightState
from tests.hil.direct_stages import VirtualClock, direct_line

pytestmark = pytest.mark.usefixtures("never_late")

FLICKER = LightSettings("square", 60.0, 30.0, 0.0, 2.5, sync_output=True)


class Bench:
    """A controller on a line, and the driver for it."""

    def __init__(self) -> None:
        self.clock = VirtualClock()
        self.states: list[LightState] = []
        self.device = GardasoftRt(self.clock.monotonic, self.states.append, "RT260-20 (HW02) V031")
        self.line = direct_line(self.device, self.clock)

    def open(self, **changes) -> GardasoftLight:
        return GardasoftLight(self.line, clock=self.clock, **changes)

    def sent(self, *letters: str) -> list[str]:
        lines = [data.decode().rstrip("\r") for data in self.line.sent]
        return [line for line in lines if not letters or line.startswith(letters)]

    def lit(self) -> bool:
        return self.states[-1].output


@pytest.fixture
def bench() -> Bench:
    return Bench()


@pytest.fixture
def light(bench) -> GardasoftLight:
    return bench.open(model="RT260-20")


def test_a_flicker_is_set_in_the_controllers_words_and_in_the_dark(light, bench) -> None:
    light.apply(FLICKER)
    flicker = ["RT1,5.0000,0.01,50.0", "RT2,5.0000,0.01,100.0"]
    assert bench.sent("RS", "RT", "TT") == ["RS1,0", "TT1,16.6667", "TT0", *flicker]
    assert not any(state.output and state.high_v > 0.0 for state in bench.states)


def test_a_light_that_is_on_stays_on_when_it_is_set_anew(light, bench) -> None:
    light.apply(FLICKER)
    light.on()
    light.apply(LightSettings(frequency_hz=50.0))
    assert bench.lit()
    assert bench.states[-1].frequency_hz == 50.0


def test_without_sync_the_second_channel_is_dark(light, bench) -> None:
    light.apply(LightSettings(sync_output=False))
    assert (bench.device.outputs[2].mode, bench.device.outputs[2].percent) == (CONTINUOUS, 0.0)


def test_another_model_is_refused(bench) -> None:
    with pytest.raises(WrongDevice, match="RT820, but RT260-20 answers"):
        bench.open(model="RT820")
    assert bench.line.closed


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (LightSettings("sine"), "square pulses only"),
        (LightSettings(low_v=1.0), "low_v must be 0"),
        (LightSettings(high_v=6.0), "at most 5 V"),
        (LightSettings(high_v=0.0), "above 0 V"),
    ],
)
def test_what_it_cannot_do_is_refused_before_anything_is_sent(light, bench, settings, message) -> None:
    bench.line.sent.clear()
    with pytest.raises(SettingRefused, match=message):
        light.apply(settings)
    assert bench.line.sent == []


def test_a_sync_without_a_channel_for_it_is_refused(bench) -> None:
    light = bench.open(sync_channel=None)
    with pytest.raises(SettingRefused, match="no sync channel"):
        light.apply(FLICKER)


def test_a_setting_that_does_not_stick_is_refused_with_both_values(light, bench) -> None:
    bench.line.turn("RT1,5.0000", "RT1,4.9000")
    with pytest.raises(SettingRefused, match=r"pulse width: .* 5\.0000 ms, .* 4\.9000 ms"):
        light.apply(FLICKER)


def test_a_channel_that_shines_steadily_is_no_flicker(light) -> None:
    with pytest.raises(LightFault, match="pulse mode"):
        light.read()


def test_a_trigger_that_does_not_obey_is_a_fault(light, bench) -> None:
    light.apply(FLICKER)
    bench.line.turn("TT1", "")
    with pytest.raises(LightFault, match="does not run"):
        light.on()
    bench.device.receive(b"TT1\r")
    bench.line.turn("TT0", "")
    with pytest.raises(LightFault, match="still runs"):
        light.off()


def test_a_steady_light_is_switched_off_by_who_did_not_switch_it_on(light, bench) -> None:
    light.apply(LightSettings("steady", high_v=2.5))
    light.on()
    another = bench.open()
    assert another.is_on()
    another.off()
    assert not bench.lit()


def test_a_steady_light_that_burns_takes_another_level_at_once(light, bench) -> None:
    light.apply(LightSettings("steady", high_v=2.5))
    light.on()
    assert light.apply(LightSettings("steady", high_v=1.0)).high_v == pytest.approx(1.0)
    assert bench.states[-1].high_v == pytest.approx(1.0)
    assert bench.sent("GT") == ["GT0"]  # once


def test_a_steady_light_that_the_controller_holds_lower_is_refused(light, bench) -> None:
    light.apply(LightSettings("steady", high_v=2.5))
    bench.line.turn("RS1,50.0", "RS1,40.0")
    with pytest.raises(SettingRefused, match=r"50\.0 %"):
        light.on()
