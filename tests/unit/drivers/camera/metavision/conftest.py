"""A camera behind the fake HAL, alone on its bench."""

import sys

import pytest

from drivers.camera.metavision import MetavisionEvk4
from tests.unit.drivers.camera.metavision.fake_hal import SERIAL, Device, Hal


@pytest.fixture
def device():
    return Device()


@pytest.fixture
def devices(monkeypatch, device):
    connected = {SERIAL: device}
    monkeypatch.setitem(sys.modules, "metavision_hal", Hal(connected))
    return connected


@pytest.fixture
def camera(devices, clock):
    return MetavisionEvk4.open(serial=SERIAL, clock=clock)
