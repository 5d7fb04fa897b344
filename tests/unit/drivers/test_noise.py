"""Drivers on lines that lose, cut, change, double and delay what they carry: an error, or the truth."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from drivers.errors import DriverError
from drivers.light import LightSettings
from drivers.light.scpi import ScpiLight
from drivers.stage.zaber import ZaberStage
from tests.unit.drivers.generator_peer import Generator
from tests.unit.drivers.noisy_port import NoisyPort
from tests.unit.drivers.zaber_peer import ZaberPeer, axes

FEW = pytest.param(3_000)
MANY = pytest.param(100_000, marks=pytest.mark.slow)


def until(port: NoisyPort, exchanges: int, act: Callable[[], None]) -> tuple[int, int]:
    """Act until that many requests went out; return how often it succeeded and how often it was an error."""
    good = bad = 0
    while port.writes < exchanges:
        try:
            act()
        except DriverError:
            bad += 1
        else:
            good += 1
    return good, bad


@pytest.mark.parametrize("exchanges", [FEW, MANY])
@pytest.mark.parametrize("rate", [0.02, 0.3])
def test_no_position_that_is_told_is_wrong(clock, exchanges, rate) -> None:
    peer = ZaberPeer(clock)
    rng = np.random.default_rng(1)
    port = NoisyPort(peer, rng, 0.0)
    stage = ZaberStage(port, axes(), clock=clock)
    stage.home()
    port.rate = rate

    def read() -> None:
        peer.pan.start = peer.pan.goal = float(rng.integers(-15000, 15000))
        peer.tilt.start = peer.tilt.goal = float(rng.integers(-15000, 15000))
        assert stage.position_deg() == {"pan": peer.pan.goal / 1000, "tilt": peer.tilt.goal / 1000}

    good, bad = until(port, exchanges, read)
    assert port.spoiled > 0.5 * rate * exchanges
    assert good > bad


@pytest.mark.parametrize("exchanges", [FEW, MANY])
def test_no_move_that_is_told_to_have_arrived_is_elsewhere(clock, exchanges) -> None:
    peer = ZaberPeer(clock)
    rng = np.random.default_rng(2)
    port = NoisyPort(peer, rng, 0.0)
    stage = ZaberStage(port, axes(), clock=clock)
    stage.home()
    port.rate = 0.05

    def move() -> None:
        for controller in (peer.pan, peer.tilt):
            controller.flags = []
        target = {"pan": rng.integers(-15000, 15000) / 1000, "tilt": rng.integers(-15000, 15000) / 1000}
        stage.move_to(target)
        assert {"pan": peer.pan.position() / 1000, "tilt": peer.tilt.position() / 1000} == target

    good, bad = until(port, exchanges, move)
    assert good > 10
    assert bad > 0


@pytest.mark.parametrize("exchanges", [FEW, MANY])
@pytest.mark.parametrize("rate", [0.02, 0.2])
def test_no_light_setting_that_is_told_is_wrong(clock, exchanges, rate) -> None:
    generator = Generator()
    rng = np.random.default_rng(3)
    port = NoisyPort(generator, rng, 0.0)
    light = ScpiLight(port, clock=clock)
    light.apply(LightSettings())
    port.rate = rate

    def read() -> None:
        generator.values["FREQ"] = float(rng.integers(1, 1000))
        generator.values["VOLT:HIGH"] = float(rng.integers(1, 10))
        before = dict(generator.values)
        told = light.read()
        if generator.values == before:  # a query changed on its way can become a command
            assert (told.frequency_hz, told.high_v) == (before["FREQ"], before["VOLT:HIGH"])

    good, _ = until(port, exchanges, read)
    assert good > 10
