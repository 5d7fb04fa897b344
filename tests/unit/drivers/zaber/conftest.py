"""A Zaber stage on the model of two chained controllers, opened and homed."""

from __future__ import annotations

import pytest

from drivers.stage.zaber import ZaberStage
from tests.unit.drivers.zaber_peer import ZaberPeer, axes


@pytest.fixture
def peer(clock) -> ZaberPeer:
    return ZaberPeer(clock)


@pytest.fixture
def stage(peer, clock) -> ZaberStage:
    return ZaberStage(peer, axes(), clock=clock)


@pytest.fixture
def homed(stage, peer) -> ZaberStage:
    stage.home()
    peer.sent.clear()
    return stage
