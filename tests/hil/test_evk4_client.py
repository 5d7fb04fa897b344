"""The client of the simulated EVK4, against a scripted peer on a socket that can do everything wrong."""

import json
import os
import socket
import struct
import threading
import time
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.camera import CameraSettings
from drivers.camera.raw_file import RawFile
from drivers.camera.simulated_evk4 import SimulatedEvk4Camera
from drivers.clock import SystemClock
from drivers.errors import (
    CameraError,
    CameraLost,
    CameraNotFound,
    CameraSettingRefused,
    DeviceRefused,
    DriverError,
    RecordingFailed,
    ReplyGarbled,
    ReplyTimeout,
    WrongDevice,
)

WHO = {
    "maker": "Prophesee",
    "model": "EVK4 (simulated)",
    "sensor": "IMX636",
    "serial": "00050423",
    "firmware": "1.0",
    "width": 1280,
    "height": 720,
    "format": "EVT3",
}
NOW = datetime(2026, 11, 20, 4, 5, 6, tzinfo=UTC)


def words_of(step):
    """2 ms of the sensor's clock: clock words, one event in its middle."""
    t = 5_000_000 + 2000 * step
    words = [0x8000 | t >> 12 & 0xFFF, 0x6000 | t & 0xFFF, step % 720, 0x2800 | step % 1280]
    t += 1999
    return np.array([*words, 0x8000 | t >> 12 & 0xFFF, 0x6000 | t & 0xFFF], "<u2").tobytes()


class Peer:
    """A camera that answers as the protocol says, but for what a test changes."""

    def __init__(self):
        self.identity = dict(WHO)
        self.biases = {"bias_diff_on": 0, "bias_diff_off": 0, "bias_fo": 0, "bias_hpf": 0, "bias_refr": 0}
        self.filters = {"afk": True, "stc": False, "trail": False, "erc": True}
        self.trigger_in = False
        self.deaf_to = set()
        self.before_frame = {}
        self.frames = 10**9
        self.asked = []
        self.kept = None
        self.closed = threading.Event()
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.address = f"127.0.0.1:{self._listener.getsockname()[1]}"
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def close(self):
        self._listener.close()
        self._thread.join(10)

    def send(self, kind, payload):
        self.link.sendall(kind + struct.pack("<I", len(payload)) + payload)

    def answer(self, number, **values):
        self.send(b"A", json.dumps({"id": number, "ok": True, **values}).encode())

    def refuse(self, number, code, message):
        self.send(b"A", json.dumps({"id": number, "ok": False, "error": code, "message": message}).encode())

    def _serve(self):
        try:
            self.link, _ = self._listener.accept()
            with self.link:
                while True:
                    self._handle(self._request())
        except (OSError, EOFError):
            self.closed.set()

    def _request(self):
        head = self._exactly(5)
        assert head[:1] == b"Q"
        request = json.loads(self._exactly(struct.unpack("<I", head[1:])[0]))
        self.asked.append(request["cmd"])
        self.kept = request.get("frames")
        return request

    def _exactly(self, n):
        data = b""
        while len(data) < n:
            more = self.link.recv(n - len(data))
            if not more:
                raise EOFError
            data += more
        return data

    def _handle(self, request):
        if request["cmd"] not in self.deaf_to:
            getattr(self, "do_" + request["cmd"])(request["id"], request)

    def do_identify(self, number, _):
        self.answer(number, **self.identity)

    def do_get_biases(self, number, _):
        self.answer(number, biases=self.biases)

    def do_set_bias(self, number, request):
        if not -150 <= request["value"] <= 255:
            self.refuse(number, "out_of_range", f"{request['name']} takes -150 to 255.")
            return
        self.biases[request["name"]] = request["value"]
        self.answer(number)

    def do_get_filters(self, number, _):
        self.answer(number, **self.filters)

    def do_set_filter(self, number, request):
        self.filters[request["name"]] = request["enabled"]
        self.answer(number)

    def do_get_trigger_in(self, number, _):
        self.answer(number, enabled=self.trigger_in)

    def do_set_trigger_in(self, number, request):
        self.trigger_in = request["enabled"]
        self.answer(number)

    def do_monitor(self, number, _):
        self.answer(number, temperature_c=41.5, illumination_lux=120.0, pixel_dead_time_us=6.0)

    def do_stop(self, number, _):
        self.answer(number)

    def do_start(self, number, _):
        self.answer(number)
        self.link.setblocking(False)
        for step in range(self.frames):
            self.before_frame.get(step, lambda: None)()
            self.link.setblocking(True)
            self.send(b"D", words_of(step))
            self.link.setblocking(False)
            try:
                if self.link.recv(1, socket.MSG_PEEK) is not None:
                    break
            except BlockingIOError:
                continue
        self.link.setblocking(True)
        self._stop_with_a_last_frame()

    def _stop_with_a_last_frame(self):
        request = self._request()
        if request["cmd"] not in self.deaf_to:
            self.send(b"D", words_of(10**6))
            self.answer(request["id"])


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


class Interrupted(Exception):
    pass


class InterruptingClock(SystemClock):
    """Raises in its sleep as soon as it is told to, and from then on."""

    def __init__(self):
        self.now = False

    def sleep(self, seconds):
        if self.now:
            raise Interrupted
        super().sleep(seconds)


class HurryingClock(SystemClock):
    """Stands still until told to hurry; then every wait takes a second."""

    def __init__(self):
        self.now = 0.0
        self.hurry = False

    def monotonic(self):
        return self.now

    def sleep(self, seconds):
        self.now += 1.0 if self.hurry else 0.0


def test_identity_is_what_the_camera_says(connect):
    identity = connect().identify()
    assert (identity.serial, identity.sensor, identity.width, identity.height) == (
        "00050423",
        "IMX636",
        1280,
        720,
    )


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
    with pytest.raises(CameraNotFound, match="no address of a camera"):
        SimulatedEvk4Camera.open(address, clock=SystemClock(), utc_now=lambda: NOW)


def test_settings_are_set_read_back_and_all_filters_switched_off(peer, connect):
    found = connect().apply(CameraSettings({"bias_diff_on": 20}, trigger_in=True))
    assert found.biases == {
        "bias_diff_on": 20,
        "bias_diff_off": 0,
        "bias_fo": 0,
        "bias_hpf": 0,
        "bias_refr": 0,
    }
    assert found.trigger_in
    assert peer.filters == {"afk": False, "stc": False, "trail": False, "erc": False}


def test_biases_not_named_go_back_to_the_factory_value(peer, connect):
    peer.biases["bias_fo"] = 30
    assert connect().apply(CameraSettings()).biases["bias_fo"] == 0


def test_a_bias_out_of_range_is_refused_with_the_cameras_words(connect):
    with pytest.raises(CameraSettingRefused, match="takes -150 to 255"):
        connect().apply(CameraSettings({"bias_diff_on": 400}))


def test_an_unknown_bias_is_refused_before_anything_is_sent(peer, connect):
    camera = connect()
    asked = len(peer.asked)
    with pytest.raises(CameraSettingRefused, match="no bias bias_wrong"):
        camera.apply(CameraSettings({"bias_wrong": 1}))
    assert len(peer.asked) == asked


def test_a_bias_that_does_not_stick_is_noticed(peer, connect):
    peer.do_set_bias = lambda number, _: peer.answer(number)
    with pytest.raises(CameraSettingRefused, match="reads back"):
        connect().apply(CameraSettings({"bias_fo": 10}))


def test_a_filter_that_stays_on_is_noticed(peer, connect):
    peer.do_set_filter = lambda number, _: peer.answer(number)
    with pytest.raises(CameraSettingRefused, match="afk, erc stays on"):
        connect().apply(CameraSettings())


def test_a_recording_covers_the_time_asked_of_the_sensors_clock(connect, tmp_path):
    path = tmp_path / "pose.raw"
    facts = connect().record(path, 0.033)
    assert 0.033 <= facts.duration_s < 0.035
    assert facts.complete
    assert facts.bytes == path.stat().st_size
    assert facts.temperature_c == 41.5
    assert facts.illumination_lux == 120.0
    assert facts.gaps == ()


def test_the_file_is_a_header_and_the_cameras_own_words(connect, tmp_path):
    path = tmp_path / "pose.raw"
    facts = connect().record(path, 0.033)
    recording = RawFile.open(path)
    assert path.read_bytes().endswith(b"% end\n" + b"".join(words_of(k) for k in range(17)))
    assert recording.header["date"] == "2026-11-20 04:05:06"
    assert recording.serial == "00050423"
    assert recording.scan().events == facts.events == 17


def test_equal_streams_make_equal_files_however_late_they_are_stopped(connect, tmp_path):
    camera = connect()
    for name in ("a.raw", "b.raw"):
        camera.record(tmp_path / name, 0.02)
    assert (tmp_path / "a.raw").read_bytes() == (tmp_path / "b.raw").read_bytes()


def test_the_camera_is_told_how_many_frames_were_kept(peer, connect, tmp_path):
    camera = connect()
    camera.record(tmp_path / "pose.raw", 0.033)
    assert peer.kept == 17
    camera.record(tmp_path / "again.raw", 0.002)
    assert peer.kept == 2


def test_the_camera_answers_after_a_recording(connect, tmp_path):
    camera = connect()
    camera.record(tmp_path / "pose.raw", 0.01)
    assert camera.temperature_c() == 41.5


def test_an_existing_file_is_never_overwritten(peer, connect, tmp_path):
    path = tmp_path / "pose.raw"
    path.write_bytes(b"precious")
    with pytest.raises(RecordingFailed, match="such a file already"):
        connect().record(path, 0.01)
    assert path.read_bytes() == b"precious"
    assert "start" not in peer.asked


def test_a_missing_folder_is_told_before_the_camera_starts(peer, connect, tmp_path):
    with pytest.raises(RecordingFailed, match="no such folder"):
        connect().record(tmp_path / "none" / "pose.raw", 0.01)
    assert "start" not in peer.asked


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full")
def test_a_full_disk_is_told_and_the_camera_usable_after(connect, tmp_path, monkeypatch):
    camera = connect()
    real_open = os.open

    def open_full(path, flags, *rest):
        return real_open("/dev/full" if str(path).endswith(".raw") else path, flags & ~os.O_EXCL, *rest)

    monkeypatch.setattr(os, "open", open_full)
    with pytest.raises(RecordingFailed, match=r"disk is full.*Free space"):
        camera.record(tmp_path / "pose.raw", 0.01)
    monkeypatch.undo()
    assert camera.record(tmp_path / "again.raw", 0.01).complete


def test_an_interrupt_stops_the_stream_and_leaves_a_readable_file(peer, connect, tmp_path):
    clock = InterruptingClock()
    camera = connect(clock=clock)
    peer.before_frame[5] = lambda: setattr(clock, "now", True)
    path = tmp_path / "pose.raw"
    with pytest.raises(Interrupted):
        camera.record(path, 10.0)
    assert peer.asked[-1] == "stop"
    assert RawFile.open(path).scan().events <= 6
    clock.now = False
    peer.before_frame.clear()
    assert camera.record(tmp_path / "again.raw", 0.01).complete


def test_stop_from_another_thread_ends_the_recording_early(peer, connect, tmp_path):
    camera = connect()
    peer.before_frame[5] = camera.stop
    path = tmp_path / "pose.raw"
    facts = camera.record(path, 1000.0)
    assert not facts.complete
    assert RawFile.open(path).scan().events == facts.events


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


def test_other_notifications_are_let_pass(peer, connect, tmp_path):
    peer.before_frame[3] = lambda: peer.send(b"N", b'{"event": "warm"}')
    assert connect().record(tmp_path / "pose.raw", 0.02).complete


def test_malformed_words_fail_the_recording_and_are_kept(peer, connect, tmp_path):
    peer.before_frame[3] = lambda: peer.send(b"D", b"\x00\x90")
    path = tmp_path / "pose.raw"
    with pytest.raises(RecordingFailed, match=r"0x9000.*pose\.raw"):
        connect().record(path, 1.0)
    assert path.read_bytes().endswith(b"\x00\x90")


def test_a_gap_in_the_sensors_clock_is_in_the_facts(peer, connect, tmp_path):
    late = np.array([0x8000 | 4000, 0x6000], "<u2").tobytes()
    peer.before_frame[3] = lambda: peer.send(b"D", late)
    assert "missing" in connect().record(tmp_path / "pose.raw", 0.02).gaps[0]


def test_a_stream_that_dries_up_is_noticed(peer, connect, tmp_path):
    peer.frames = 3
    clock = HurryingClock()
    camera = connect(clock=clock)
    peer.before_frame[2] = lambda: setattr(clock, "hurry", True)
    with pytest.raises(CameraLost, match="it has sent nothing for 30 s"):
        camera.record(tmp_path / "pose.raw", 1.0)


class SteppedClock(SystemClock):
    """Goes on where a test says so; counts the rounds that a driver waits."""

    def __init__(self):
        self.now = 0.0
        self.rounds = 0

    def monotonic(self):
        return self.now

    def sleep(self, seconds):
        self.rounds += 1

    def let_pass(self, seconds, peer):
        """Let time pass in which the peer says that it computes, as long as somebody waits for it."""
        for _ in range(round(seconds / 20)):
            peer.send(b"N", b'{"event": "computing"}')
            heard, deadline = self.rounds + 2, time.monotonic() + 10
            while self.rounds < heard:
                if time.monotonic() > deadline:
                    return
                time.sleep(0.001)
            self.now += 20.0


def test_a_camera_that_computes_is_waited_for(peer, connect, tmp_path):
    clock = SteppedClock()
    camera = connect(clock=clock)
    peer.before_frame[2] = lambda: clock.let_pass(500, peer)
    assert camera.record(tmp_path / "pose.raw", 0.02).complete
    assert clock.now == 500


def test_a_camera_that_computes_is_not_waited_for_for_ever(peer, connect, tmp_path, monkeypatch):
    monkeypatch.setattr("drivers.camera.simulated_evk4.STOP_S", 0.1)
    clock = SteppedClock()
    camera = connect(clock=clock)
    peer.before_frame[2] = lambda: clock.let_pass(700, peer)
    with pytest.raises(CameraLost, match="clock has not gone on for 600 s"):
        camera.record(tmp_path / "pose.raw", 1.0)


def test_an_answer_that_is_long_in_computing_is_waited_for(peer, connect):
    clock = SteppedClock()
    camera = connect(clock=clock)
    peer.do_monitor = lambda number, _: (
        clock.let_pass(500, peer),
        peer.answer(number, temperature_c=41.5),
    )
    assert camera.temperature_c() == 41.5
    assert clock.now == 500


def test_a_camera_that_does_not_answer_is_given_up_after_its_time(peer, connect):
    peer.deaf_to.add("monitor")
    clock = HurryingClock()
    camera = connect(clock=clock)
    clock.hurry = True
    with pytest.raises(ReplyTimeout, match=r'"monitor"; for 3[0-9.]+ s it has sent nothing'):
        camera.temperature_c()


def test_a_deaf_camera_does_not_hold_up_the_way_out(peer, connect, tmp_path, monkeypatch):
    monkeypatch.setattr("drivers.camera.simulated_evk4.STOP_S", 0.1)
    clock = HurryingClock()
    camera = connect(clock=clock)
    peer.deaf_to.add("stop")
    peer.before_frame[3] = lambda: peer.send(b"D", b"\x00\x90")
    with pytest.raises(RecordingFailed, match="0x9000"):
        camera.record(tmp_path / "pose.raw", 1.0)


def test_a_late_answer_is_not_taken_for_the_next_one(peer, connect):
    peer.deaf_to.add("monitor")
    clock = HurryingClock()
    camera = connect(clock=clock)
    clock.hurry = True
    with pytest.raises(ReplyTimeout):
        camera.temperature_c()
    clock.hurry = False
    peer.do_get_filters = lambda number, _: (
        peer.answer(number - 1, temperature_c=41.5),
        peer.answer(number, afk=False),
    )
    assert camera.filters() == {"afk": False}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"serial": 50423}, '"serial"'),
        ({"width": "1280"}, '"width"'),
        ({"height": None}, '"height"'),
        ({"format": "EVT2"}, "EVT2, not EVT3"),
    ],
)
def test_an_answer_of_another_shape_is_refused(peer, connect, change, message):
    peer.identity.update(change)
    with pytest.raises(ReplyGarbled, match=message):
        connect()


@pytest.mark.parametrize(
    ("kind", "payload"),
    [(b"X", b""), (b"A", b"{"), (b"A", b"[]"), (b"D", b"\x00"), (b"A", b"[" * 100_000)],
)
def test_bytes_that_are_no_frame_are_refused(peer, connect, kind, payload):
    camera = connect()
    peer.do_monitor = lambda *_: peer.send(kind, payload)
    with pytest.raises(ReplyGarbled):
        camera.temperature_c()


def frame(kind, payload):
    return kind + struct.pack("<I", len(payload)) + payload


ANSWERS = st.sampled_from(
    [
        frame(b"A", json.dumps({"id": 1, "ok": True, **WHO}).encode()),
        frame(b"A", b'{"id": 1, "ok": true}'),
        frame(b"A", b'{"id": 1, "ok": false, "error": 5}'),
        frame(b"A", b'{"id": 1, "ok": true, "maker": [], "format": "EVT3"}'),
        frame(b"N", b'{"event": "fault"}'),
        frame(b"N", b"[]"),
        frame(b"D", words_of(0)),
    ]
)


@settings(max_examples=150)
@given(st.lists(ANSWERS | st.binary(max_size=60), max_size=5), st.integers(1, 40))
def test_whatever_a_peer_sends_ends_in_an_identity_or_a_drivers_error(pieces, cut):
    sent = b"".join(pieces)
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def serve():
            link, _ = listener.accept()
            with link, suppress(OSError):  # the client may have hung up on it
                for k in range(0, len(sent), cut):
                    link.sendall(sent[k : k + cut])

        peer = threading.Thread(target=serve)
        peer.start()
        with suppress(DriverError):  # anything else it raises fails the test
            SimulatedEvk4Camera.open(
                f"127.0.0.1:{listener.getsockname()[1]}",
                clock=SystemClock(),
                utc_now=lambda: NOW,
                silence_s=5.0,
            ).close()
        peer.join()


def test_a_refused_start_is_told(peer, connect, tmp_path):
    peer.do_start = lambda number, _: peer.refuse(number, "busy", "It is already streaming.")
    with pytest.raises(CameraError, match="already streaming"):
        connect().record(tmp_path / "pose.raw", 0.01)


def test_a_refusal_says_what_was_asked(peer, connect):
    peer.do_monitor = lambda number, _: peer.refuse(number, "broken", "The sensor is off.")
    with pytest.raises(DeviceRefused, match='refused "monitor": The sensor is off'):
        connect().temperature_c()


@pytest.mark.parametrize("duration_s", [0.0, -1.0, float("nan"), float("inf")])
def test_no_time_at_all_is_refused(connect, tmp_path, duration_s):
    path = tmp_path / "pose.raw"
    with pytest.raises(RecordingFailed):
        connect().record(path, duration_s)
    assert not path.exists()
