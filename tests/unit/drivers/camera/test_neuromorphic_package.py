"""neuromorphic-drivers itself, where it is installed: the fake agrees with it, and its errors are told."""

import dataclasses
import inspect
import sys
from datetime import UTC, datetime

import pytest

from drivers.camera.neuromorphic_evk4 import NeuromorphicEvk4
from drivers.errors import CameraNotFound
from tests.unit.drivers.camera.neuromorphic_fake import BIASES, Biases, Configuration, Device, Ring


@pytest.fixture
def real():
    return pytest.importorskip("neuromorphic_drivers", reason="the extra evk4 is not installed")


def fields(kind):
    return {field.name for field in dataclasses.fields(kind)}


def parameters(call):
    return list(inspect.signature(call).parameters)


def test_the_fake_has_what_the_real_package_has(real):
    evk4 = real.prophesee_evk4
    assert fields(Configuration) <= fields(evk4.Configuration)
    assert fields(Biases) <= fields(evk4.Biases)
    assert fields(Ring) == fields(sys.modules["neuromorphic_drivers.status"].RawRingStatus)
    device = evk4.PropheseeEvk4DeviceRawOptional
    for call in ("serial", "properties", "biases_bounds", "temperature_celsius", "illuminance", "close"):
        assert hasattr(Device, call)
        assert hasattr(device, call)
    for call in ("clear_backlog", "update_configuration"):
        assert parameters(getattr(device, call)) == parameters(getattr(Device, call))


def test_the_real_package_has_the_fields_that_are_read(real):
    evk4 = real.prophesee_evk4
    assert {"width", "height"} <= fields(evk4.Properties)
    assert {"minimum", "maximum"} <= fields(evk4.Bounds)
    assert set(BIASES) <= fields(evk4.BiasesBounds)
    assert {"name", "serial", "error"} <= fields(real.ListedDevice)
    assert real.Name.PROPHESEE_EVK4


def test_opening_takes_the_parameters_that_the_driver_gives(real):
    assert {"configuration", "iterator_timeout", "raw", "serial"} <= set(parameters(real.open))


def test_without_a_camera_the_real_package_gives_a_clear_error(real, clock):
    try:
        present = [device for device in real.list_devices() if device.name == real.Name.PROPHESEE_EVK4]
    except RuntimeError:
        present = []
    if present:
        pytest.skip("an EVK4 is connected")
    with pytest.raises(CameraNotFound, match="connected EVK4: none"):
        NeuromorphicEvk4.open(serial="00000001", clock=clock, utc_now=lambda: datetime.now(UTC))
