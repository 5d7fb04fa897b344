"""Recordings of a camera behind the Metavision HAL: whole, or the reason told."""

import gc
import weakref
from types import SimpleNamespace

import pytest
from camera_words import words_of

from drivers.camera import CameraSettings
from drivers.camera import metavision as metavision_driver
from drivers.camera.metavision import MetavisionEvk4
from drivers.camera.raw_file import RawFile
from drivers.errors import CameraLost, RecordingFailed
from tests.unit.drivers.camera.metavision.fake_hal import HEADER, RISING, SERIAL, Device


def test_a_camera_without_optional_facilities_works(device, camera, tmp_path):
    for name in (
        "ll_biases",
        "antiflicker_module",
        "event_trail_filter_module",
        "erc_module",
        "roi",
        "trigger_in",
        "monitoring",
    ):
        device.facilities[name] = None
    assert camera.apply(CameraSettings(trigger_in=False)) == CameraSettings({}, trigger_in=False)
    assert camera.temperature_c() is None
    facts = camera.record(tmp_path / "pose.raw", 0.01)
    assert (facts.filters, facts.biases, facts.complete) == ({}, {}, True)


@pytest.mark.parametrize("name", ["events_stream", "events_stream_decoder", "geometry", "hw_identification"])
def test_a_camera_without_what_every_camera_has_is_told(device, camera, tmp_path, name):
    device.facilities[name] = None
    with pytest.raises(metavision_driver.CameraError, match="cannot be reached"):
        camera.record(tmp_path / "pose.raw", 0.01)


def test_a_recording_holds_all_buffers_and_covers_the_time(device, camera, tmp_path):
    path = tmp_path / "pose.raw"
    facts = camera.record(path, 0.033)
    recording = RawFile.open(path)
    scan = recording.scan()
    assert path.read_bytes() == HEADER + b"".join(
        words_of(k, RISING) for k in range(device.facilities["events_stream"].step)
    )
    assert 0.033 <= facts.duration_s < 0.038
    assert (facts.events, facts.triggers, facts.bytes) == (scan.events, scan.triggers, path.stat().st_size)
    assert recording.serial == SERIAL


def test_an_existing_file_is_never_overwritten(camera, tmp_path):
    path = tmp_path / "pose.raw"
    path.write_bytes(b"precious")
    with pytest.raises(RecordingFailed, match="file exists already"):
        camera.record(path, 0.01)
    assert path.read_bytes() == b"precious"


@pytest.mark.parametrize(
    ("log", "free", "fault"),
    [
        ({"may_log": False}, 1, "cannot write"),
        ({"log_takes": 5}, 10**12, r"covers only 0\.009999 s"),
        ({"log_takes": 5}, 0, "disk is full"),
    ],
)
def test_bytes_that_do_not_reach_the_file_are_noticed(
    device, camera, tmp_path, monkeypatch, log, free, fault
):
    vars(device.facilities["events_stream"]).update(log)
    monkeypatch.setattr("shutil.disk_usage", lambda _: SimpleNamespace(free=free))
    with pytest.raises(RecordingFailed, match=fault):
        camera.record(tmp_path / "pose.raw", 0.033)


def test_unplugging_is_told_with_the_partial_file(device, camera, tmp_path):
    def unplug():
        raise RuntimeError("HalConnectionException: device disconnected")

    device.facilities["events_stream"].hook[4] = unplug
    path = tmp_path / "pose.raw"
    with pytest.raises(CameraLost, match=r"device disconnected.*pose\.raw"):
        camera.record(path, 1.0)
    assert RawFile.open(path).scan().events == 4
    assert not device.facilities["events_stream"].running


def test_a_silent_camera_is_given_up(device, camera, clock, tmp_path):
    device.facilities["events_stream"].buffers = 3
    with pytest.raises(CameraLost, match=r" 5 s.*pose\.raw"):
        camera.record(tmp_path / "pose.raw", 1.0)
    assert clock.now_s < 10


def test_a_stream_that_ends_by_itself_is_not_complete(device, camera, tmp_path):
    device.facilities["events_stream"].buffers = 3
    device.facilities["events_stream"].ends_with = -1
    facts = camera.record(tmp_path / "pose.raw", 1.0)
    assert not facts.complete
    assert facts.events == 3


def test_stop_ends_a_recording_early(device, camera, tmp_path):
    device.facilities["events_stream"].hook[4] = camera.stop
    assert not camera.record(tmp_path / "pose.raw", 1.0).complete


def test_an_interrupt_stops_the_stream_and_leaves_a_readable_file(device, camera, clock, tmp_path):
    device.facilities["events_stream"].hook[4] = lambda: setattr(clock, "error", KeyboardInterrupt())
    path = tmp_path / "pose.raw"
    with pytest.raises(KeyboardInterrupt):
        camera.record(path, 1.0)
    assert not device.facilities["events_stream"].running
    assert RawFile.open(path).scan().events == 5


def test_garbled_words_fail_the_recording(device, camera, tmp_path):
    stream = device.facilities["events_stream"]
    stream.hook[2] = lambda: stream.log.write(b"\x00\x90")
    with pytest.raises(RecordingFailed, match="0x9000"):
        camera.record(tmp_path / "pose.raw", 0.01)


def test_work_is_seen_to_go_on_while_a_long_recording_is_scanned(camera, clock, tmp_path, monkeypatch):
    path, asked = tmp_path / "pose.raw", []
    words, scan = RawFile.words, RawFile.scan
    monkeypatch.setattr(RawFile, "words", lambda file: words(file, piece_words=8))
    monkeypatch.setattr(RawFile, "scan", lambda file, now: scan(file, lambda: asked.append(now)))
    camera.record(path, 0.01)
    assert set(asked) == {clock.monotonic}
    assert len(asked) == len(list(RawFile.open(path).words())) > 3


@pytest.mark.parametrize("facility", ["hw_identification", "antiflicker_module", "events_stream"])
def test_an_error_that_is_kept_does_not_keep_the_camera(devices, clock, monkeypatch, tmp_path, facility):
    """A hold keeps its cause. The maker's objects in it kept the camera claimed, and it could not be opened again."""

    def gone(*_):
        raise RuntimeError("Error 5: LibUSB connection error: **UNKNOWN**")

    devices[SERIAL] = Device()
    camera = MetavisionEvk4.open(serial=SERIAL, clock=clock)
    objects = devices.pop(SERIAL).facilities
    calls = {"hw_identification": "get_serial", "antiflicker_module": "is_enabled"}
    monkeypatch.setattr(type(objects[facility]), calls.get(facility, "poll_buffer"), gone)
    alive = weakref.WeakSet(objects.values())
    del objects
    with pytest.raises(CameraLost, match="the device is gone") as kept:
        camera.record(tmp_path / "pose.raw", 0.01)
    camera.close()
    gc.collect()
    assert kept.value.__traceback__ is not None
    assert list(alive) == []
