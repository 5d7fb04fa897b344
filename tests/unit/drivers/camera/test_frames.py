"""Frame cameras and their files."""

import time
from unittest.mock import Mock

import cv2
import numpy as np
import pytest

from drivers.camera import frame_cameras
from drivers.camera import frames as frames_module
from drivers.camera.frame_cameras import STALE_FRAMES, FolderFrameCamera, OpenCvFrameCamera
from drivers.camera.frames import FrameSettings, mean_frame, read_frames, to_grey, write_frames
from drivers.clock import SystemClock
from drivers.errors import (
    CameraBusy,
    CameraError,
    CameraLost,
    CameraNotFound,
    CameraSettingRefused,
    NotARecording,
    RecordingFailed,
    RecordingFileError,
    WrongDevice,
)


def pictures(n, dtype=np.uint8, size=(48, 64)):
    rng = np.random.default_rng(n)
    return [rng.integers(0, np.iinfo(dtype).max, size, dtype) for _ in range(n)]


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("n", [1, 3])
def test_pictures_come_back_bit_for_bit(tmp_path, dtype, n):
    taken = pictures(n, dtype)
    length = write_frames(tmp_path / "pose.tiff", taken)
    frames_read = read_frames(tmp_path / "pose.tiff")
    assert frames_read.dtype == dtype
    assert np.array_equal(frames_read, taken)
    assert length == (tmp_path / "pose.tiff").stat().st_size
    assert [file.name for file in tmp_path.iterdir()] == ["pose.tiff"]


def test_the_mean_is_that_of_the_grey_values(tmp_path):
    taken = pictures(4, np.uint16)
    write_frames(tmp_path / "pose.tiff", taken)
    assert mean_frame(tmp_path / "pose.tiff") == pytest.approx(np.mean(taken, axis=0), rel=1e-6)


def test_pictures_are_never_overwritten(tmp_path):
    (tmp_path / "pose.tiff").write_bytes(b"precious")
    with pytest.raises(RecordingFailed, match="file exists already"):
        write_frames(tmp_path / "pose.tiff", pictures(1))
    assert (tmp_path / "pose.tiff").read_bytes() == b"precious"


def test_colours_become_grey():
    red = np.zeros((2, 2, 3), np.uint8)
    red[..., 2] = 255
    assert to_grey(red, where="x").tolist() == [[76, 76], [76, 76]]
    assert to_grey(np.full((2, 2, 1), 7, np.uint16), where="x").tolist() == [[7, 7], [7, 7]]


def test_pixels_of_another_kind_are_refused():
    with pytest.raises(RecordingFileError, match="float64"):
        to_grey(np.zeros((2, 2)), where="x")


def test_what_is_no_picture_is_told(tmp_path):
    (tmp_path / "a.png").write_bytes(b"hello")
    with pytest.raises(NotARecording, match="holds no images"):
        read_frames(tmp_path / "a.png")
    with pytest.raises(RecordingFileError, match="no such file"):
        read_frames(tmp_path / "none.png")


@pytest.fixture
def folder(tmp_path):
    """Three numbered pictures."""
    source = tmp_path / "pictures"
    source.mkdir()
    for k, picture in enumerate(pictures(3)):
        cv2.imwrite(str(source / f"{k:03d}.png"), picture)
    (source / "notes.txt").write_text("no picture")
    return source


def test_a_folder_hands_on_its_pictures_one_by_one(folder, tmp_path):
    camera = FolderFrameCamera.open(folder, clock=SystemClock())
    for k, picture in enumerate(pictures(3)):
        facts = camera.capture(tmp_path / f"{k}.tiff", 1)
        assert np.array_equal(read_frames(tmp_path / f"{k}.tiff")[0], picture)
        assert (facts.width, facts.height, facts.bits, facts.frames, facts.complete) == (64, 48, 8, 1, True)
    with pytest.raises(RecordingFailed, match="All 3 images"):
        camera.capture(tmp_path / "3.tiff", 1)


def test_saturation_is_told(tmp_path):
    picture = np.zeros((10, 10), np.uint8)
    picture[:2] = 255
    (tmp_path / "in").mkdir()
    cv2.imwrite(str(tmp_path / "in" / "a.png"), picture)
    facts = FolderFrameCamera.open(tmp_path / "in", clock=SystemClock()).capture(tmp_path / "a.tiff", 1)
    assert facts.saturated_share == pytest.approx(0.2)


def test_pictures_of_two_sizes_are_refused(folder, tmp_path):
    cv2.imwrite(str(folder / "000a.png"), np.zeros((10, 10), np.uint8))
    with pytest.raises(RecordingFailed, match="all must have 64 x 48"):
        FolderFrameCamera.open(folder, clock=SystemClock()).capture(tmp_path / "a.tiff", 2)
    assert not (tmp_path / "a.tiff").exists()


def test_an_empty_folder_is_told(tmp_path):
    with pytest.raises(CameraNotFound, match="holds no images"):
        FolderFrameCamera.open(tmp_path, clock=SystemClock())


def test_stop_ends_a_capture_early(folder, tmp_path):
    class StoppingClock(SystemClock):
        def sleep(self, seconds):
            camera.stop()

    camera = FolderFrameCamera.open(folder, clock=StoppingClock())
    facts = camera.capture(tmp_path / "a.tiff", 3)
    assert (facts.frames, facts.complete) == (1, False)


def test_a_video_source_is_read_to_its_end(folder, tmp_path):
    camera = OpenCvFrameCamera.open(str(folder / "%03d.png"), clock=SystemClock())
    assert (camera.identify().width, camera.identify().height) == (64, 48)
    camera.capture(tmp_path / "a.tiff", 3)
    assert np.array_equal(read_frames(tmp_path / "a.tiff"), pictures(3))
    with pytest.raises(CameraLost, match="no more frames"):
        camera.capture(tmp_path / "b.tiff", 1)
    camera.close()


class Live:
    """A video device as OpenCV shows it: counts its pictures in their grey value."""

    def __init__(self, shown=0):
        self.shown = shown
        self.frozen = False
        self.pictures = 10**9
        self.values = {cv2.CAP_PROP_FRAME_WIDTH: 64.0, cv2.CAP_PROP_FRAME_HEIGHT: 48.0}
        self.deaf_to = set()
        self.released = 0

    def isOpened(self):  # noqa: N802 - OpenCV's name
        return True

    def get(self, what):
        return self.values.get(what, 0.0)

    def set(self, what, value):
        if what not in self.deaf_to:
            self.values[what] = value
        return True

    def grab(self):
        self.shown += 1
        return True

    def read(self):
        self.shown += 1
        if self.shown > self.pictures:
            return False, None
        return True, np.full((48, 64, 3), 7 if self.frozen else self.shown, np.uint8)

    def release(self):
        self.released += 1


@pytest.fixture
def video(tmp_path, monkeypatch):
    """A video device that OpenCV opens, with a serial number on USB, and where the system tells it."""
    live = Live()
    monkeypatch.setattr(frame_cameras.cv2, "VideoCapture", lambda *_: live)
    usb = tmp_path / "usb"
    (usb / "1-2:1.0").mkdir(parents=True)
    (usb / "idVendor").write_text("046d")
    (usb / "serial").write_text("8A0A3C5F")
    (tmp_path / "sys" / "video7").mkdir(parents=True)
    (tmp_path / "sys" / "video7" / "device").symlink_to(usb / "1-2:1.0")
    return live, tmp_path / "sys"


@pytest.fixture
def webcam(video):
    camera = OpenCvFrameCamera.open("/dev/video7", serial="8A0A3C5F", clock=SystemClock(), system=video[1])
    yield camera
    camera.close()


def test_pictures_that_a_video_device_still_holds_are_dropped(webcam, tmp_path):
    webcam.capture(tmp_path / "a.tiff", 1)
    assert (read_frames(tmp_path / "a.tiff") == STALE_FRAMES + 1).all()


def test_another_camera_under_that_name_is_refused_and_never_opened(video, monkeypatch):
    monkeypatch.setattr(frame_cameras.cv2, "VideoCapture", lambda *_: pytest.fail("it was opened"))
    with pytest.raises(WrongDevice, match="This is camera 8A0A3C5F, not 12345"):
        OpenCvFrameCamera.open("7", serial="12345", clock=SystemClock(), system=video[1])


def test_another_camera_plugged_in_meanwhile_takes_no_picture(webcam, tmp_path):
    (tmp_path / "usb" / "serial").write_text("FFFF")
    with pytest.raises(WrongDevice, match="camera FFFF, not 8A0A3C5F"):
        webcam.capture(tmp_path / "a.tiff", 1)
    assert not (tmp_path / "a.tiff").exists()


def test_a_serial_number_that_nothing_can_tell_is_refused(monkeypatch):
    monkeypatch.setattr(frame_cameras.cv2, "VideoCapture", lambda *_: Live())
    with pytest.raises(WrongDevice, match="serial number, not 12345"):
        OpenCvFrameCamera.open("rtsp://camera/1", serial="12345", clock=SystemClock())


def test_a_second_opener_of_a_video_device_is_refused_until_it_is_given_back(video, webcam):
    with pytest.raises(CameraBusy, match="Another program holds it"):
        OpenCvFrameCamera.open("7", clock=SystemClock(), system=video[1])
    webcam.close()
    OpenCvFrameCamera.open("7", clock=SystemClock(), system=video[1]).close()


def test_settings_are_made_and_read_back_and_the_focus_is_held(video, webcam):
    live, _ = video
    live.values[cv2.CAP_PROP_AUTOFOCUS] = 1.0
    assert webcam.apply(FrameSettings(exposure=100.0, gain=2.0)) == FrameSettings(100.0, 2.0)
    assert live.values[cv2.CAP_PROP_AUTOFOCUS] == 0.0
    assert (live.values[cv2.CAP_PROP_EXPOSURE], live.values[cv2.CAP_PROP_GAIN]) == (100.0, 2.0)


def test_a_camera_that_goes_on_focusing_by_itself_is_refused(video, webcam):
    live, _ = video
    live.values[cv2.CAP_PROP_AUTOFOCUS] = 1.0
    live.deaf_to.add(cv2.CAP_PROP_AUTOFOCUS)
    with pytest.raises(CameraSettingRefused, match="another focal length"):
        webcam.apply(FrameSettings())


def test_an_exposure_that_reads_back_otherwise_is_refused(video, webcam):
    live, _ = video
    live.deaf_to.add(cv2.CAP_PROP_EXPOSURE)
    live.values[cv2.CAP_PROP_EXPOSURE] = 33.0
    with pytest.raises(CameraSettingRefused, match=r"Exposure .* 100, .* 33"):
        webcam.apply(FrameSettings(exposure=100.0))


def test_an_unplugged_video_device_is_told_and_leaves_no_file(video, webcam, tmp_path):
    live, _ = video
    live.pictures = STALE_FRAMES + 2
    with pytest.raises(CameraLost, match="sends no more frames"):
        webcam.capture(tmp_path / "a.tiff", 8)
    assert not list(tmp_path.glob("a*"))


def test_a_video_device_that_is_gone_is_lost_and_not_taken_for_another_one(video, webcam, tmp_path):
    _, system = video
    (system / "video7").rename(system / "video8")
    with pytest.raises(CameraLost, match="no such video device"):
        webcam.capture(tmp_path / "a.tiff", 1)
    webcam.close()
    with pytest.raises(CameraNotFound, match="no such video device"):
        OpenCvFrameCamera.open("/dev/video7", serial="8A0A3C5F", clock=SystemClock(), system=system)


def test_a_video_device_that_has_stalled_is_waited_for_once(video, clock, tmp_path):
    """OpenCV waits ten seconds for each picture."""
    live, system = video

    def stall():
        clock.now_s += 10.0
        return False

    live.grab, live.read = stall, lambda: (stall(), None)
    camera = OpenCvFrameCamera.open("/dev/video7", clock=clock, system=system)
    with pytest.raises(CameraLost, match="sends no more frames"):
        camera.capture(tmp_path / "a.tiff", 4)
    camera.close()
    assert clock.now_s == 10.0


def network_camera(monkeypatch, lives):
    """A network camera whose connections are these, one after the other; the first is that of opening."""
    coming = iter(lives)
    monkeypatch.setattr(frame_cameras.cv2, "VideoCapture", lambda *_: next(coming))
    return OpenCvFrameCamera.open("rtsp://camera/1", clock=SystemClock())


def test_every_capture_of_a_network_camera_is_a_new_connection(monkeypatch, tmp_path):
    lives = [Live(10 * n) for n in range(3)]
    camera = network_camera(monkeypatch, lives)
    camera.capture(tmp_path / "a.tiff", 1)
    camera.capture(tmp_path / "b.tiff", 1)
    camera.close()
    assert [life.released for life in lives] == [1, 1, 1]
    assert (read_frames(tmp_path / "b.tiff") == 21).all()


def test_a_camera_that_sends_an_old_picture_is_noticed(monkeypatch, tmp_path):
    camera = network_camera(monkeypatch, [Live(), Live(10), Live(9)])
    camera.capture(tmp_path / "a.tiff", 1)
    with pytest.raises(RecordingFailed, match="previous capture"):
        camera.capture(tmp_path / "b.tiff", 2)
    assert not (tmp_path / "b.tiff").exists()


def test_a_camera_that_has_frozen_is_noticed(monkeypatch, tmp_path):
    frozen = Live(10)
    frozen.frozen = True
    camera = network_camera(monkeypatch, [Live(), frozen])
    with pytest.raises(RecordingFailed, match="identical"):
        camera.capture(tmp_path / "a.tiff", 3)
    assert not (tmp_path / "a.tiff").exists()


@pytest.mark.usefixtures("folder")
def test_pictures_of_files_may_repeat_themselves(tmp_path):
    for k in range(2):
        cv2.imwrite(str(tmp_path / f"{k}.png"), pictures(1)[0])
    camera = OpenCvFrameCamera.open(str(tmp_path / "%d.png"), clock=SystemClock())
    assert camera.capture(tmp_path / "a.tiff", 2).complete
    camera.close()


def test_pictures_of_a_folder_cannot_be_exposed_again(folder):
    with pytest.raises(CameraSettingRefused, match="cannot be changed after"):
        FolderFrameCamera.open(folder, clock=SystemClock()).apply(FrameSettings(gain=2.0))


def test_a_closed_camera_opens_nothing_again(monkeypatch, tmp_path):
    lives = [Live(10 * n) for n in range(3)]
    camera = network_camera(monkeypatch, lives)
    camera.close()
    for act in (
        camera.identify,
        lambda: camera.apply(FrameSettings()),
        lambda: camera.capture(tmp_path / "a.tiff", 1),
    ):
        with pytest.raises(CameraError, match="is closed"):
            act()
    assert not (tmp_path / "a.tiff").exists()


def test_the_clock_is_used_while_frames_are_written(folder, tmp_path, monkeypatch):
    clock = Mock(wraps=SystemClock())

    def write_slowly(path, taken):
        time.sleep(0.35)
        return write_frames(path, taken)

    monkeypatch.setattr(frames_module, "write_frames", write_slowly)
    camera = FolderFrameCamera.open(folder, clock=clock)
    clock.reset_mock()
    assert camera.capture(tmp_path / "a.tiff", 2).complete
    assert clock.monotonic.call_count >= 3


def test_every_page_of_a_file_is_a_picture(clock, tmp_path):
    """A capture of ours is one file of many pages: the pages of a pose are not those of the next one."""
    folder = tmp_path / "poses"
    folder.mkdir()
    for pose in range(2):
        write_frames(
            folder / f"pose-{pose}.tiff", [np.full((4, 6), 10 * pose + page, "u1") for page in range(3)]
        )
    camera = FolderFrameCamera.open(folder, clock=clock)
    for pose in range(2):
        camera.capture(tmp_path / f"{pose}.tiff", 3)
        assert [int(page[0, 0]) for page in read_frames(tmp_path / f"{pose}.tiff")] == [
            10 * pose + page for page in range(3)
        ]
    with pytest.raises(RecordingFailed, match="All 6 images"):
        camera.capture(tmp_path / "more.tiff", 1)
