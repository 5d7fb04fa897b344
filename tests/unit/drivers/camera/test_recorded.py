"""RAW files played as a camera."""

import numpy as np
import pytest

from drivers.camera import CameraSettings
from drivers.camera.raw_file import RawFile
from drivers.camera.recorded import RecordedCamera
from drivers.clock import SystemClock
from drivers.errors import CameraNotFound, CameraSettingRefused, RecordingFailed, WrongDevice

HEADER = b"% evt 3.0\n% format EVT3;height=720;width=1280\n% serial_number %s\n% sensor_name IMX636\n% end\n"


def stream(milliseconds, *, column=3):
    """One event and a clock word every 100 us."""
    words = []
    for k in range(10 * milliseconds + 1):
        t = 2_000_000 + 100 * k
        words += [0x8000 | t >> 12 & 0xFFF, 0x6000 | t & 0xFFF, 0x0007, 0x2000 | column]
    return words


def write(path, words, serial=b"42"):
    path.write_bytes(HEADER.replace(b"%s", serial) + np.array(words, "<u2").tobytes())


@pytest.fixture
def play():
    return lambda path, **options: RecordedCamera.open(path, clock=SystemClock(), **options)


@pytest.fixture
def folder(tmp_path):
    """Two recordings of one camera, told apart by the column of their events."""
    source = tmp_path / "captures"
    source.mkdir()
    write(source / "pose-001.raw", stream(50, column=1))
    write(source / "pose-002.raw", stream(50, column=2))
    (source / "notes.txt").write_text("not played")
    return source


def test_each_recording_asked_for_plays_the_next_file_byte_for_byte(play, folder, tmp_path):
    camera = play(folder)
    for name in ("pose-001.raw", "pose-002.raw"):
        facts = camera.record(tmp_path / name, 0.033)
        assert facts.complete
        assert facts.duration_s == pytest.approx(0.05)
        assert (tmp_path / name).read_bytes() == (folder / name).read_bytes()


def test_the_end_of_the_files_is_told(play, folder, tmp_path):
    camera = play(folder)
    for name in ("a.raw", "b.raw"):
        camera.record(tmp_path / name, 0.01)
    with pytest.raises(RecordingFailed, match=r"have been played \(2 taken\)"):
        camera.record(tmp_path / "c.raw", 0.01)
    assert not (tmp_path / "c.raw").exists()


def test_stop_ends_a_recording_early(folder, tmp_path):
    class StoppingClock(SystemClock):
        def sleep(self, seconds):
            camera.stop()

    camera = RecordedCamera.open(folder, clock=StoppingClock())
    assert not camera.record(tmp_path / "a.raw", 0.001).complete


def test_one_long_file_is_taken_piece_after_piece(play, tmp_path):
    write(tmp_path / "long.raw", stream(200))
    camera = play(tmp_path / "long.raw")
    last_t = 0
    for k in range(3):
        path = tmp_path / f"{k}.raw"
        assert camera.record(path, 0.033).complete
        scan = RawFile.open(path).scan()
        assert scan.first_t_us >= last_t
        last_t = scan.last_t_us


def test_a_file_exactly_as_long_as_asked_is_complete(play, tmp_path):
    write(tmp_path / "long.raw", stream(40))
    facts = play(tmp_path / "long.raw").record(tmp_path / "a.raw", 0.04)
    assert (facts.complete, facts.duration_s) == (True, pytest.approx(0.04))


@pytest.mark.parametrize("duration_s", [0.0, -1.0, float("nan"), float("inf")])
def test_no_time_at_all_is_refused(play, folder, tmp_path, duration_s):
    with pytest.raises(RecordingFailed, match="is not possible"):
        play(folder).record(tmp_path / "a.raw", duration_s)


def test_a_recording_that_has_been_played_is_not_played_again(play, tmp_path):
    write(tmp_path / "long.raw", stream(40))
    camera = play(tmp_path / "long.raw")
    assert not camera.record(tmp_path / "a.raw", 1.0).complete
    with pytest.raises(RecordingFailed, match="have been played"):
        camera.record(tmp_path / "b.raw", 0.01)


def test_words_before_the_first_time_high_are_not_taken(play, tmp_path):
    write(tmp_path / "joined.raw", [0x2001, 0x0005, 0x2001, *stream(20)])
    camera = play(tmp_path / "joined.raw")
    camera.record(tmp_path / "a.raw", 0.005)
    first = (tmp_path / "a.raw").read_bytes().partition(b"% end\n")[2][:2]
    assert first == np.array(stream(20)[:1], "<u2").tobytes()


def test_identity_is_that_of_the_header(play, folder):
    identity = play(folder, serial="42").identify()
    assert (identity.serial, identity.sensor, identity.width) == ("42", "IMX636", 1280)
    assert identity.model == "recorded"


def test_files_of_another_camera_are_refused(play, folder):
    with pytest.raises(WrongDevice, match="by camera 42, not 43"):
        play(folder, serial="43")


def test_files_of_two_cameras_are_refused(play, folder):
    write(folder / "pose-003.raw", stream(5), serial=b"99")
    with pytest.raises(WrongDevice, match="99, not 42"):
        play(folder)


def test_an_empty_folder_is_told(play, tmp_path):
    with pytest.raises(CameraNotFound, match="holds no RAW file"):
        play(tmp_path)


def test_biases_cannot_be_set_any_more(play, folder):
    camera = play(folder)
    assert camera.apply(CameraSettings({"bias_fo": 0})).biases == {}
    with pytest.raises(CameraSettingRefused, match="bias_fo"):
        camera.apply(CameraSettings({"bias_fo": 3}))
