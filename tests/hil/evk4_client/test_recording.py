"""Recordings by the client of the simulated EVK4: whole, or the reason told with the partial file."""

import json
import socket

import pytest
from camera_words import words_of

from drivers.camera.raw_file import RawFile
from drivers.errors import CameraLost, RecordingFailed
from tests.hil.evk4_client.clocks import HurryingClock, SteppedClock


def test_the_file_is_a_header_and_the_cameras_own_words(connect, tmp_path):
    path = tmp_path / "pose.raw"
    facts = connect().record(path, 0.033)
    recording = RawFile.open(path)
    assert path.read_bytes().endswith(b"% end\n" + b"".join(words_of(k) for k in range(17)))
    assert recording.header["date"] == "2026-11-20 04:05:06"
    assert recording.serial == "00050423"
    assert recording.scan().events == facts.events == 17


def test_a_camera_that_goes_away_names_the_partial_file(peer, connect, tmp_path):
    camera = connect()
    peer.before_frame[3] = lambda: peer.link.shutdown(socket.SHUT_RDWR)
    path = tmp_path / "pose.raw"
    with pytest.raises(CameraLost, match=r"pose\.raw"):
        camera.record(path, 1.0)
    assert RawFile.open(path).scan().events <= 3


def test_a_fault_that_the_camera_reports_fails_the_recording(peer, connect, tmp_path):
    fault = json.dumps({"event": "fault", "message": "sensor overheated"}).encode()
    peer.before_frame[3] = lambda: peer.send(b"N", fault)
    with pytest.raises(RecordingFailed, match=r"sensor overheated.*pose\.raw"):
        connect().record(tmp_path / "pose.raw", 1.0)


def test_malformed_words_fail_the_recording_and_are_kept(peer, connect, tmp_path):
    peer.before_frame[3] = lambda: peer.send(b"D", b"\x00\x90")
    path = tmp_path / "pose.raw"
    with pytest.raises(RecordingFailed, match=r"0x9000.*pose\.raw"):
        connect().record(path, 1.0)
    assert path.read_bytes().endswith(b"\x00\x90")


def test_a_stream_that_dries_up_is_noticed(peer, connect, tmp_path):
    peer.frames = 3
    clock = HurryingClock()
    camera = connect(clock=clock)
    peer.before_frame[2] = lambda: setattr(clock, "hurry", True)
    with pytest.raises(CameraLost, match="30 s"):
        camera.record(tmp_path / "pose.raw", 1.0)


def test_a_camera_that_computes_is_waited_for(peer, connect, tmp_path):
    clock = SteppedClock()
    camera = connect(clock=clock)
    peer.before_frame[2] = lambda: clock.let_pass(500, peer)
    assert camera.record(tmp_path / "pose.raw", 0.02).complete
    assert clock.now_s == 500


def test_a_camera_that_computes_is_not_waited_for_for_ever(peer, connect, tmp_path, monkeypatch):
    monkeypatch.setattr("drivers.camera.simulated_evk4.STOP_S", 0.1)
    clock = SteppedClock()
    camera = connect(clock=clock)
    peer.before_frame[2] = lambda: clock.let_pass(700, peer, patience_s=2.0)
    with pytest.raises(CameraLost, match="600 s"):
        camera.record(tmp_path / "pose.raw", 1.0)


def test_a_deaf_camera_does_not_hold_up_the_way_out(peer, connect, tmp_path, monkeypatch):
    monkeypatch.setattr("drivers.camera.simulated_evk4.STOP_S", 0.1)
    clock = HurryingClock()
    camera = connect(clock=clock)
    peer.deaf_to.add("stop")
    peer.before_frame[3] = lambda: peer.send(b"D", b"\x00\x90")
    with pytest.raises(RecordingFailed, match="0x9000"):
        camera.record(tmp_path / "pose.raw", 1.0)
