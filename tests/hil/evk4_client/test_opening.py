"""The client of the simulated EVK4: who is there, and settings that hold or are refused."""

import socket

import pytest

from drivers.camera import CameraSettings
from drivers.camera.simulated_evk4 import SimulatedEvk4Camera
from drivers.clock import SystemClock
from drivers.errors import CameraNotFound, CameraSettingRefused, WrongDevice
from tests.hil.evk4_client.peer import NOW


def test_another_serial_number_is_refused_and_the_connection_given_back(peer, connect):
    with pytest.raises(WrongDevice, match="camera 00050423, not 00099999"):
        connect(serial="00099999")
    assert peer.closed.wait(10)
    assert peer.asked == ["identify"]


def test_nobody_listening_is_told_with_the_address():
    with socket.create_server(("127.0.0.1", 0)) as free:
        address = f"127.0.0.1:{free.getsockname()[1]}"
    with pytest.raises(CameraNotFound, match=address):
        SimulatedEvk4Camera.open(address, clock=SystemClock(), utc_now=lambda: NOW)


@pytest.mark.parametrize("address", ["", "localhost", "127.0.0.1:", "127.0.0.1:x", "127.0.0.1:99999"])
def test_an_address_without_host_and_port_is_told(address):
    with pytest.raises(CameraNotFound, match="not a camera address"):
        SimulatedEvk4Camera.open(address, clock=SystemClock(), utc_now=lambda: NOW)


def test_a_bias_that_does_not_stick_is_noticed(peer, connect):
    peer.before_answer["set_bias"] = lambda _: None
    with pytest.raises(CameraSettingRefused, match="reads back"):
        connect().apply(CameraSettings({"bias_fo": 10}))


def test_a_filter_that_stays_on_is_noticed(peer, connect):
    peer.before_answer["set_filter"] = lambda _: None
    with pytest.raises(CameraSettingRefused, match="filters afk, erc"):
        connect().apply(CameraSettings())
