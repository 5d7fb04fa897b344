"""Settings of a camera behind the Metavision HAL: set, read back, refused where they do not hold."""

import pytest

from drivers.camera import CameraSettings
from drivers.camera.metavision import MetavisionEvk4
from drivers.errors import CameraLost, CameraSettingRefused
from tests.unit.drivers.camera.metavision.fake_hal import (
    OTHER_SENSORS,
    SERIAL,
    Channel,
    Device,
    RoiMode,
    Trail,
    TrailType,
)


def test_settings_are_set_and_read_back_with_all_filters_off(device, camera):
    applied = camera.apply(CameraSettings({"bias_diff_on": 20}, trigger_in=True))
    assert applied.biases == dict.fromkeys(applied.biases, 0) | {"bias_diff_on": 20}
    assert applied.trigger_in
    assert device.facilities["trigger_in"].is_enabled(Channel.MAIN)
    assert camera.filters() == {"afk": False, "stc": False, "trail": False, "erc": False}
    assert device.facilities["roi"].on is False


@pytest.mark.parametrize(
    ("kind", "expected"),
    [
        (TrailType.TRAIL, {"stc": False, "trail": True}),
        (TrailType.STC_CUT_TRAIL, {"stc": True, "trail": True}),
        (TrailType.STC_KEEP_TRAIL, {"stc": True, "trail": False}),
    ],
)
def test_the_trail_filter_is_told_as_what_it_does(device, camera, kind, expected):
    device.facilities["event_trail_filter_module"] = Trail(True, kind)
    assert camera.filters() == {"afk": True, "erc": True, **expected}


def test_a_filter_that_stays_on_is_noticed(device, camera):
    device.facilities["antiflicker_module"].sticks = True
    with pytest.raises(CameraSettingRefused, match="filters afk"):
        camera.apply(CameraSettings())


def test_a_region_of_interest_is_set_and_taken_away_again(device, camera):
    region = device.facilities["roi"]
    assert camera.apply(CameraSettings(roi=(320, 180, 640, 360))).roi == (320, 180, 640, 360)
    assert (region.on, region.mode, region.window) == (True, RoiMode.ROI, (320, 180, 640, 360))
    camera.apply(CameraSettings())
    assert not region.on


def test_a_region_beyond_the_sensor_is_refused_before_it_is_set(device, camera):
    with pytest.raises(CameraSettingRefused, match="1280 x 720 px"):
        camera.apply(CameraSettings(roi=(640, 0, 641, 720)))
    assert device.facilities["roi"].window is None


def test_a_region_that_is_not_taken_or_that_there_is_none_of_is_told(device, camera):
    device.facilities["roi"].takes = False
    for roi in ((0, 0, 10, 10), None):
        with pytest.raises(CameraSettingRefused, match="not accept the region"):
            camera.apply(CameraSettings(roi=roi))
    device.facilities["roi"] = None
    with pytest.raises(CameraSettingRefused, match="no region"):
        camera.apply(CameraSettings(roi=(0, 0, 10, 10)))


def test_a_bias_out_of_range_is_refused_with_the_range(device, camera):
    with pytest.raises(CameraSettingRefused, match=r"bias_fo .*-35 .* 55, .* 60"):
        camera.apply(CameraSettings({"bias_fo": 60}))
    assert device.facilities["ll_biases"].values["bias_fo"] != 60


def test_a_bias_that_does_not_stick_is_noticed(device, camera):
    device.facilities["ll_biases"].deaf_to.add("bias_hpf")
    with pytest.raises(CameraSettingRefused, match=r"bias_hpf .* 7, .* 0"):
        camera.apply(CameraSettings({"bias_hpf": 7}))


@pytest.mark.parametrize(
    ("missing", "message"), [(False, "trigger input stays off"), (True, "no trigger input")]
)
def test_a_trigger_input_that_stays_off_or_is_missing_is_noticed(device, camera, missing, message):
    device.facilities["trigger_in"].deaf = True
    if missing:
        device.facilities["trigger_in"] = None
    with pytest.raises(CameraSettingRefused, match=message):
        camera.apply(CameraSettings(trigger_in=True))


def test_biases_that_are_missing_are_told_when_needed(device, camera):
    device.facilities["ll_biases"] = None
    with pytest.raises(CameraSettingRefused, match="no biases"):
        camera.apply(CameraSettings({"bias_fo": 3}, trigger_in=False))


FRAMED = "\n{0}\nLibUSB\n\nError fffffffc: LibUSB connection error: LIBUSB_ERROR_NO_DEVICE\n{0}\n".format(
    "-" * 48
)
"""As OpenEB 5.1.1 says it."""


def gone(*_):
    raise RuntimeError(FRAMED)


@pytest.mark.parametrize("method", ["set", "get", "get_all_biases"])
def test_a_camera_that_has_gone_is_lost_not_a_refused_setting(device, camera, monkeypatch, method):
    """The run was told to correct its bias, and failed instead of holding."""
    monkeypatch.setattr(device.facilities["ll_biases"], method, gone)
    with pytest.raises(CameraLost, match="LIBUSB_ERROR_NO_DEVICE") as caught:
        camera.apply(CameraSettings({"bias_diff_on": 0}))
    assert "cable" in caught.value.remedy
    assert "--" not in str(caught.value)  # the frame around the maker's words


def test_filters_of_a_camera_that_has_gone_are_a_loss_too(device, camera, monkeypatch):
    monkeypatch.setattr(device.facilities["antiflicker_module"], "is_enabled", gone)
    with pytest.raises(CameraLost, match="read its filters"):
        camera.filters()


def test_a_measurement_that_the_sensor_does_not_end_is_no_temperature(device, camera, monkeypatch, tmp_path):
    """OpenEB returns -1 then; it was kept as a temperature of -1 degree."""
    for call in ("get_temperature", "get_illumination"):
        monkeypatch.setattr(device.facilities["monitoring"], call, lambda: -1, raising=False)
    assert camera.temperature_c() is None
    facts = camera.record(tmp_path / "pose.raw", 0.01)
    assert (facts.temperature_c, facts.illumination_lux) == (None, None)


@pytest.mark.parametrize("sensor", OTHER_SENSORS)
def test_the_biases_of_another_sensor_keep_what_it_had_when_it_was_opened(devices, clock, sensor):
    devices[SERIAL] = device = Device(sensor=sensor)
    camera = MetavisionEvk4.open(serial=SERIAL, clock=clock)
    size, stated = OTHER_SENSORS[sensor]
    identity = camera.identify()
    assert ((identity.width, identity.height), identity.sensor) == (size, sensor)
    factory = {name: value for name, (value, _, _) in stated.items()}
    for biases in ({"bias_fo": 60}, {}):
        applied = camera.apply(CameraSettings(biases))
        assert device.facilities["ll_biases"].values == {**factory, **biases}
        assert applied.biases["bias_fo"] == biases.get("bias_fo", factory["bias_fo"])
    assert camera.bias_ranges()["bias_hpf"] == stated["bias_hpf"][1:]
    highest = stated["bias_fo"][2]
    with pytest.raises(CameraSettingRefused, match=f"bias_fo from 0 to {highest}, not -1"):
        camera.apply(CameraSettings({"bias_fo": -1}))
