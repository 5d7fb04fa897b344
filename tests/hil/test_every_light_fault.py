"""Every fault that can be ordered of a light or its line, on every family: a typed error in time, or the truth.

What only the light itself does (lamp open, another frequency, sync edges gone) no driver can know: the recordings do.
"""

import numpy as np
import pytest

from drivers.errors import DriverError, LightError, PortLost, ReplyError, SettingRefused, WrongDevice
from drivers.light import LightSettings
from simulators.faults.catalogue import LIGHT_FAULTS
from simulators.lights.lamp import LAMP_FAULTS
from tests.hil.direct_lights import OPENED, DirectLight, direct_light
from tests.hil.direct_stages import VirtualClock
from tests.hil.test_every_fault import MESSAGES
from tests.hil.test_fault_line_fuzz import like

pytestmark = pytest.mark.usefixtures("never_late")

LONGEST_S = 30.0
BRIGHT = LightSettings(frequency_hz=50.0, high_v=5.0)


@pytest.fixture(params=OPENED)
def rig(request) -> DirectLight:
    rig = direct_light(request.param, VirtualClock(), np.random.default_rng(3))
    rig.light.apply(BRIGHT)
    rig.light.on()
    return rig


def tried(rig: DirectLight, act) -> DriverError | None:
    """Return the error that an act ends in, if any; it must come in time."""
    return rig.line.error_of(act, LONGEST_S)


def test_every_fault_of_the_catalogue_is_spoken_of_here() -> None:
    assert set(LIGHT_FAULTS) == {*LAMP_FAULTS, "clip", "trip", "exchange"}


def test_a_clipped_level_is_refused(rig) -> None:
    rig.order("clip most_v=2")
    with pytest.raises(SettingRefused):
        rig.light.apply(BRIGHT)
    rig.order("mend")
    rig.light.apply(BRIGHT)


def test_a_light_that_goes_dark_by_itself_is_told(rig) -> None:
    rig.order("trip")
    assert not rig.states[-1].output
    assert rig.light.faults() != []


def test_another_driver_in_its_place_is_refused_when_it_is_opened_and_dark_before(rig) -> None:
    rig.order("exchange serial=XX9999")
    assert not rig.states[-1].output
    assert rig.light.faults() != []
    if rig.kind == "gardasoft":  # it tells no serial number
        return
    with pytest.raises(WrongDevice, match="XX9999"):
        OPENED[rig.kind](rig.line, rig.line.clock)


@pytest.mark.parametrize("fault", sorted(LAMP_FAULTS))
def test_what_the_lamp_does_alone_its_driver_cannot_know(rig, fault) -> None:
    rig.order(fault)
    assert like(rig.light.read(), BRIGHT)
    assert rig.light.faults() == []


@pytest.mark.parametrize("skip", [0, 2, 5])
@pytest.mark.parametrize("fault", sorted(MESSAGES))
def test_one_spoilt_message_never_becomes_a_setting(rig, fault, skip) -> None:
    asked = LightSettings(frequency_hz=75.0, high_v=3.0)
    rig.order(f"{fault} skip={skip} delay_s=1.2 pattern=1 replacement=7")
    error = tried(rig, lambda: rig.light.apply(asked))
    if error is None:
        assert rig.states[-1].frequency_hz == pytest.approx(75.0, rel=1e-4)
    rig.line.device.clear()
    rig.line.clock.sleep(2.0)
    assert tried(rig, rig.light.off) is None or not rig.states[-1].output


@pytest.mark.parametrize("fault", ["lost", "request_lost", "stranger", "baud rate=2400"])
def test_a_line_that_is_bad_for_ever_is_an_error_in_time(rig, fault) -> None:
    rig.order(fault if "baud" in fault else f"{fault} count=0")
    assert isinstance(tried(rig, rig.light.read), ReplyError | LightError)
    assert isinstance(tried(rig, rig.light.off), ReplyError | LightError)


def test_a_pulled_cable_is_a_lost_port(rig) -> None:
    rig.order("unplug")
    assert isinstance(tried(rig, rig.light.read), PortLost)
    assert isinstance(tried(rig, rig.light.off), PortLost)


@pytest.mark.parametrize("text", ["Evt1,130;", "+60", "ON", "1"])
def test_what_nobody_asked_for_is_no_answer(rig, text) -> None:
    rig.order(f"say text='{text}\\r\\n'")
    error = tried(rig, lambda: like(rig.light.read(), BRIGHT) or pytest.fail("a wrong setting"))
    assert error is None or isinstance(error, ReplyError)
