"""Frame cameras and their files."""

import cv2
import numpy as np
import pytest

from drivers.camera.frame_cameras import STALE_FRAMES, FolderFrameCamera, OpenCvFrameCamera
from drivers.camera.frames import grey, mean_frame, read_frames, write_frames
from drivers.clock import SystemClock
from drivers.errors import CameraLost, CameraNotFound, NotARecording, RecordingFailed, RecordingFileError


def pictures(n, dtype=np.uint8, size=(48, 64)):
    rng = np.random.default_rng(n)
    return [rng.integers(0, np.iinfo(dtype).max, size, dtype) for _ in range(n)]


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("n", [1, 3])
def test_pictures_come_back_bit_for_bit(tmp_path, dtype, n):
    taken = pictures(n, dtype)
    length = write_frames(tmp_path / "pose.tiff", taken)
    found = read_frames(tmp_path / "pose.tiff")
    assert found.dtype == dtype
    assert np.array_equal(found, taken)
    assert length == (tmp_path / "pose.tiff").stat().st_size
    assert [file.name for file in tmp_path.iterdir()] == ["pose.tiff"]


def test_the_mean_is_that_of_the_grey_values(tmp_path):
    taken = pictures(4, np.uint16)
    write_frames(tmp_path / "pose.tiff", taken)
    assert mean_frame(tmp_path / "pose.tiff") == pytest.approx(np.mean(taken, axis=0), rel=1e-6)


def test_pictures_are_never_overwritten(tmp_path):
    (tmp_path / "pose.tiff").write_bytes(b"precious")
    with pytest.raises(RecordingFailed, match="such a file already"):
        write_frames(tmp_path / "pose.tiff", pictures(1))
    assert (tmp_path / "pose.tiff").read_bytes() == b"precious"


def test_a_missing_folder_is_told(tmp_path):
    with pytest.raises(RecordingFailed, match="no such folder"):
        write_frames(tmp_path / "none" / "pose.tiff", pictures(1))


def test_colours_become_grey():
    red = np.zeros((2, 2, 3), np.uint8)
    red[..., 2] = 255
    assert grey(red, where="x").tolist() == [[76, 76], [76, 76]]
    assert grey(np.full((2, 2, 1), 7, np.uint16), where="x").tolist() == [[7, 7], [7, 7]]


def test_pixels_of_another_kind_are_refused():
    with pytest.raises(RecordingFileError, match="float64"):
        grey(np.zeros((2, 2)), where="x")


def test_what_is_no_picture_is_told(tmp_path):
    (tmp_path / "a.png").write_bytes(b"hello")
    with pytest.raises(NotARecording, match="no pictures"):
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
    with pytest.raises(RecordingFailed, match="All 3 pictures have been taken"):
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
    with pytest.raises(RecordingFailed, match="not all of 64 x 48"):
        FolderFrameCamera.open(folder, clock=SystemClock()).capture(tmp_path / "a.tiff", 2)
    assert not (tmp_path / "a.tiff").exists()


def test_an_empty_folder_is_told(tmp_path):
    with pytest.raises(CameraNotFound, match="No pictures"):
        FolderFrameCamera.open(tmp_path, clock=SystemClock())


def test_no_pictures_at_all_is_refused(folder, tmp_path):
    with pytest.raises(RecordingFailed, match="0 of 0 pictures"):
        FolderFrameCamera.open(folder, clock=SystemClock()).capture(tmp_path / "a.tiff", 0)


def test_stop_ends_a_capture_early(folder, tmp_path):
    class StoppingClock(SystemClock):
        def sleep(self, seconds):
            camera.stop()

    camera = FolderFrameCamera.open(folder, clock=StoppingClock())
    facts = camera.capture(tmp_path / "a.tiff", 3)
    assert (facts.frames, facts.complete) == (1, False)


def test_an_interrupt_leaves_no_file(folder, tmp_path):
    class InterruptingClock(SystemClock):
        def sleep(self, seconds):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        FolderFrameCamera.open(folder, clock=InterruptingClock()).capture(tmp_path / "a.tiff", 2)
    assert not (tmp_path / "a.tiff").exists()


def test_a_video_source_is_read_to_its_end(folder, tmp_path):
    camera = OpenCvFrameCamera.open(str(folder / "%03d.png"), clock=SystemClock())
    assert (camera.identify().width, camera.identify().height) == (64, 48)
    camera.capture(tmp_path / "a.tiff", 3)
    assert np.array_equal(read_frames(tmp_path / "a.tiff"), pictures(3))
    with pytest.raises(CameraLost, match="no more pictures"):
        camera.capture(tmp_path / "b.tiff", 1)
    camera.close()


def test_a_source_that_cannot_be_opened_is_told(tmp_path):
    with pytest.raises(CameraNotFound, match="cannot open"):
        OpenCvFrameCamera.open(str(tmp_path / "none_%03d.png"), clock=SystemClock())


def test_pictures_that_a_live_source_still_holds_are_dropped(tmp_path):
    class Live:
        """Counts its pictures in their grey value."""

        def __init__(self):
            self.shown = 0

        def get(self, what):
            return {cv2.CAP_PROP_FRAME_WIDTH: 64.0, cv2.CAP_PROP_FRAME_HEIGHT: 48.0}[what]

        def grab(self):
            self.shown += 1
            return True

        def read(self):
            self.shown += 1
            return True, np.full((48, 64, 3), self.shown, np.uint8)

    OpenCvFrameCamera(Live(), "0", clock=SystemClock(), live=True).capture(tmp_path / "a.tiff", 1)
    assert (read_frames(tmp_path / "a.tiff") == STALE_FRAMES + 1).all()
