"""The Metavision driver with the vendor's own software, a RAW file opened as the camera."""

import numpy as np
import pytest

from drivers.camera.metavision import MetavisionEvk4
from drivers.camera.raw_file import RawFile
from drivers.clock import SystemClock

hal = pytest.importorskip(
    "metavision_hal", reason="the vendor's software (OpenEB or Metavision SDK) is not installed"
)


@pytest.fixture
def camera(evk4_recording):
    """The real recording, played by the vendor's software."""
    config = hal.RawFileConfig()
    config.do_time_shifting = False
    config.build_index = False
    path = evk4_recording
    device = hal.DeviceDiscovery.open_raw_file(str(path), config)
    return MetavisionEvk4(device, hal, serial=None, clock=SystemClock()), path


def test_a_file_played_as_a_camera_is_recorded_word_for_word(camera, tmp_path):
    driver, played = camera
    facts = driver.record(tmp_path / "again.raw", 3600.0)
    assert not facts.complete
    ours, theirs = RawFile.open(tmp_path / "again.raw").read()[0], RawFile.open(played).read()[0]
    assert all(np.array_equal(a, b) for a, b in zip(ours, theirs, strict=True))


def test_facilities_that_a_file_lacks_are_left_out(camera):
    driver, _ = camera
    assert driver.temperature_c() is None
    assert driver.identify().width == 1280
