"""The client of the simulated EVK4 at a scripted camera that can do everything wrong."""

import pytest

from drivers.camera.simulated_evk4 import SimulatedEvk4Camera
from drivers.clock import SystemClock
from tests.hil.evk4_client.peer import NOW, Peer


@pytest.fixture
def peer():
    peer = Peer()
    yield peer
    peer.close()


@pytest.fixture
def connect(peer):
    """Opens the camera at the peer; closed at the end."""
    opened = []

    def open_camera(*, serial="00050423", clock=None):
        clock = clock or SystemClock()
        camera = SimulatedEvk4Camera.open(
            peer.address, serial=serial, clock=clock, utc_now=lambda: NOW, silence_s=30.0
        )
        opened.append(camera)
        return camera

    yield open_camera
    for camera in opened:
        camera.close()
