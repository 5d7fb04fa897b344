"""EVK4 through neuromorphic-drivers, against a strict fake of that package's device."""

import sys
from datetime import UTC, datetime
from types import SimpleNamespace

import numpy as np
import pytest
from camera_words import words_of

from drivers.camera import CameraSettings, FoundCamera
from drivers.camera.neuromorphic_evk4 import NeuromorphicEvk4, discover
from drivers.camera.raw_file import RawFile
from drivers.errors import (
    CameraError,
    CameraLost,
    CameraNotFound,
    CameraSettingRefused,
    CameraSoftwareMissing,
    WrongDevice,
)
from tests.unit.drivers.camera.neuromorphic_fake import SERIAL, Biases, Configuration, Device

NOW = datetime(2026, 11, 20, 4, 5, 6, tzinfo=UTC)


@pytest.fixture
def device():
    return Device()


@pytest.fixture
def package(monkeypatch, device):
    """The package with one EVK4 and another camera connected."""

    def open_device(configuration, *, iterator_timeout, raw, serial):
        assert raw
        assert 0 < iterator_timeout <= 0.1
        if package.trouble:
            raise RuntimeError(package.trouble)
        device.configuration = configuration
        return device

    def list_devices():
        if package.no_usb:
            raise RuntimeError("Other error")
        return [
            SimpleNamespace(name="evk4", serial=SERIAL, error=None),
            SimpleNamespace(name="evk4", serial=None, error="access denied"),
            SimpleNamespace(name="davis", serial="7", error=None),
        ]

    package = SimpleNamespace(
        open=open_device,
        list_devices=list_devices,
        Name=SimpleNamespace(PROPHESEE_EVK4="evk4"),
        prophesee_evk4=SimpleNamespace(Configuration=Configuration, Biases=Biases),
        trouble="",
        no_usb=False,
    )
    monkeypatch.setitem(sys.modules, "neuromorphic_drivers", package)
    return package


@pytest.fixture
def camera(package, clock):
    return NeuromorphicEvk4.open(serial=SERIAL, clock=clock, utc_now=lambda: NOW)


def test_a_missing_package_is_told_with_how_to_install_it(monkeypatch, clock):
    monkeypatch.setitem(sys.modules, "neuromorphic_drivers", None)
    with pytest.raises(CameraSoftwareMissing, match=r"pip install 'starbench\[evk4\]'"):
        NeuromorphicEvk4.open(clock=clock, utc_now=lambda: NOW)


@pytest.mark.usefixtures("package")
def test_connected_evk4_are_listed_with_their_troubles(monkeypatch):
    monkeypatch.setattr("drivers.camera.neuromorphic_evk4.only_camera_kind", lambda: ("Prophesee", "EVK4"))
    assert discover() == (
        FoundCamera("neuromorphic_evk4", SERIAL, "Prophesee EVK4, USB"),
        FoundCamera("neuromorphic_evk4", "", "Prophesee EVK4, USB", "access denied"),
    )


def test_a_machine_without_usb_says_so_instead_of_having_no_cameras(package, clock):
    package.no_usb = True
    with pytest.raises(CameraError, match="Other error"):
        discover()
    package.trouble = "Other error"
    with pytest.raises(CameraNotFound, match="connected EVK4: none"):
        NeuromorphicEvk4.open(serial="1", clock=clock, utc_now=lambda: NOW)


def test_a_camera_that_cannot_be_opened_is_told_with_those_that_are_there(package, clock):
    package.trouble = "Device not found"
    with pytest.raises(CameraNotFound, match=rf"not found\).*: {SERIAL}, without .*\(access"):
        NeuromorphicEvk4.open(serial="1", clock=clock, utc_now=lambda: NOW)


def test_a_camera_that_has_gone_does_not_say_who_it_is(camera, device, monkeypatch):
    """The serial number may be remembered; a run then said that the camera answers."""

    def gone():
        raise RuntimeError("temperature timeout")

    assert camera.identify().serial == SERIAL
    monkeypatch.setattr(device, "temperature_celsius", gone)
    with pytest.raises(CameraLost, match="does not answer"):
        camera.identify()
    NeuromorphicEvk4(
        device, None, serial=SERIAL, clock=None, utc_now=lambda: NOW
    ).identify()  # it never measured


@pytest.mark.usefixtures("package")
def test_another_camera_is_refused_and_given_back(device, clock):
    with pytest.raises(WrongDevice, match="00051234, not 00099999"):
        NeuromorphicEvk4.open(serial="00099999", clock=clock, utc_now=lambda: NOW)
    assert device.closed


def test_the_trigger_input_is_off_until_settings_switch_it_on(device, camera):
    assert not device.configuration.enable_external_trigger
    camera.apply(CameraSettings(trigger_in=True))
    assert device.configuration.enable_external_trigger


def test_settings_are_sent_and_biases_not_named_are_zero(device, camera):
    applied = camera.apply(CameraSettings({"bias_diff_on": 20, "bias_fo": -5}))
    assert applied.biases == dict.fromkeys(applied.biases, 0) | {"bias_diff_on": 20, "bias_fo": -5}
    assert device.configuration.biases == Biases(diff_on=20, fo=-5)
    assert device.configuration.rate_limiter is None


def test_a_bias_out_of_range_is_refused_before_it_is_sent(device, camera):
    before = device.configuration
    with pytest.raises(CameraSettingRefused, match=r"bias_fo .*-100 .* 100, .* 101"):
        camera.apply(CameraSettings({"bias_fo": 101}))
    assert device.configuration is before


def test_a_recording_holds_the_packets_and_covers_the_time(device, camera, tmp_path):
    path = tmp_path / "pose.raw"
    facts = camera.record(path, 0.033)
    recording = RawFile.open(path)
    assert path.read_bytes().endswith(b"% end\n" + b"".join(words_of(k) for k in range(1, device.step)))
    assert 0.033 <= facts.duration_s < 0.036
    assert facts.events == recording.scan().events == device.step - 1
    assert recording.header["date"] == "2026-11-20 04:05:06"
    assert (facts.temperature_c, facts.illumination_lux) == (41.25, None)
    assert (facts.biases, facts.gaps, facts.complete) == ({}, (), True)


def test_what_has_piled_up_before_and_the_packet_in_filling_are_dropped(device, camera, tmp_path):
    camera.record(tmp_path / "pose.raw", 0.01)
    assert device.cleared == [0]
    assert RawFile.open(tmp_path / "pose.raw").scan().first_t_us == 9_002_000


def test_a_stream_joined_in_its_middle_begins_at_its_first_time_word(device, camera, tmp_path):
    device.packets[1] = np.array([0x2001, 0x4FFF], "<u2").tobytes()
    device.packets[2] = np.array([0x0005, 0x2803], "<u2").tobytes() + words_of(2)
    path = tmp_path / "pose.raw"
    camera.record(path, 0.005)
    assert path.read_bytes().split(b"% end\n", 1)[1].startswith(words_of(2) + words_of(3))


def test_words_split_between_packets_are_put_together(device, camera, tmp_path):
    device.packets[2] = words_of(2)[:-1]
    device.packets[3] = words_of(2)[-1:] + words_of(3)
    path = tmp_path / "pose.raw"
    camera.record(path, 0.009)
    assert path.read_bytes().split(b"% end\n", 1)[1].startswith(b"".join(words_of(k) for k in range(1, 5)))


def test_packets_lost_on_the_way_are_in_the_facts(device, camera, tmp_path):
    device.overflows[2] = [0]
    device.dropped = dict.fromkeys(range(4, 100), 3)
    gaps = camera.record(tmp_path / "pose.raw", 0.02).gaps
    assert len(gaps) == 2
    assert "1002.000000" in gaps[0]
    assert "1004.000000" in gaps[1]


def test_packets_lost_before_the_recording_are_not(device, camera, tmp_path):
    device.overflows = {0: [0], 1: [0]}
    device.dropped = dict.fromkeys(range(100), 7)
    assert camera.record(tmp_path / "pose.raw", 0.02).gaps == ()


def test_unplugging_is_told_with_the_partial_file(device, camera, tmp_path):
    device.gone_at = 3
    path = tmp_path / "pose.raw"
    with pytest.raises(CameraLost, match=r"NoDevice.*pose\.raw"):
        camera.record(path, 1.0)
    assert RawFile.open(path).scan().events == 2


def test_an_interrupt_leaves_a_readable_file(device, camera, clock, tmp_path):
    camera.record(tmp_path / "a.raw", 0.002)
    clock.error = KeyboardInterrupt()
    with pytest.raises(KeyboardInterrupt):
        camera.record(tmp_path / "b.raw", 1.0)
    assert RawFile.open(tmp_path / "b.raw").scan().events == 0


def test_stop_ends_a_recording_early(device, camera, clock, tmp_path):
    clock.sleep = lambda _: camera.stop() if device.step > 3 else None
    assert not camera.record(tmp_path / "pose.raw", 1.0).complete


def test_a_camera_on_usb_2_is_refused_and_free_again(package, clock, monkeypatch):
    speeds = iter([480, 5000])
    monkeypatch.setattr("drivers.camera.neuromorphic_evk4.only_camera_mbit_s", lambda: next(speeds))
    with pytest.raises(CameraSettingRefused, match=r"480 Mbit/s \(USB 2\)"):
        NeuromorphicEvk4.open(serial=SERIAL, clock=clock, utc_now=lambda: NOW)
    NeuromorphicEvk4.open(serial=SERIAL, clock=clock, utc_now=lambda: NOW).close()
    assert not package.trouble


@pytest.mark.parametrize(
    ("on_usb", "maker_and_model"),
    [
        (("IDS", "uEye XCP-E"), ("IDS", "uEye XCP-E")),
        (("Prophesee", "EVK4"), ("Prophesee", "EVK4")),
        (None, ("unknown maker", "camera with an IMX636")),
    ],
)
def test_a_camera_of_another_maker_is_journaled_as_what_it_is(camera, monkeypatch, on_usb, maker_and_model):
    monkeypatch.setattr("drivers.camera.neuromorphic_evk4.only_camera_kind", lambda: on_usb)
    identity = camera.identify()
    assert (identity.maker, identity.model) == maker_and_model
