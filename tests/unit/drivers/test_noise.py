"""Drivers on lines that lose, cut, change, double and delay what they carry: an error, or the truth."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from drivers.errors import DriverError
from drivers.stage.zaber import ZaberStage
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
