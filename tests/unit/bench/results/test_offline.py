"""Calibrating from files alone: what is not one camera's whole pictures is refused."""

import cv2
import numpy as np
import pytest

from bench.base.errors import BenchError, UsageError
from bench.results.offline import views_of_one_size
from bench.results.offline_options import OfflineOptions
from bench.results.view_sources import refuse_truncated_jpeg
from calib.view import View
from drivers.errors import RecordingCorrupt


def view(name, size):
    flat = np.zeros((1, 2))
    return View(name, size, np.zeros(1, np.int64), flat, flat, np.eye(2)[None])


def test_views_of_different_image_sizes_are_refused_with_their_names():
    views = [view("lying", (1280, 720)), view("on end", (720, 1280))]
    with pytest.raises(BenchError, match=r"720 x 1280 px \(on end\), 1280 x 720 px \(lying\)"):
        views_of_one_size(views, [True, True])


def test_point_files_take_the_size_of_the_pictures_beside_them_and_else_the_largest():
    views = [view("picture", (1280, 720)), view("points", (900, 600))]
    assert [one.image_size for one in views_of_one_size(views, [True, False])] == [(1280, 720)] * 2
    views = [view("a", (1200, 600)), view("b", (900, 700))]
    assert [one.image_size for one in views_of_one_size(views, [False, False])] == [(1200, 700)] * 2


def test_points_beyond_the_pictures_are_of_another_camera():
    with pytest.raises(BenchError, match="different image sizes"):
        views_of_one_size([view("picture", (640, 480)), view("points", (900, 400))], [True, False])


@pytest.mark.parametrize("word", ["0x0", "0x720", "1280x0", "1280", "-1280x720"])
def test_an_image_without_pixels_is_no_size(word):
    def parsed(image_size):
        return OfflineOptions.from_command_line(
            model=None, distortion=None, image_size=image_size, views=None, origin="corner", station=None
        )

    with pytest.raises(UsageError, match="not an image size"):
        parsed(word)
    assert parsed("1280x720").image_size == (1280, 720)
    assert OfflineOptions().image_size is None


@pytest.mark.parametrize("share", [0.5, 0.9, 0.999])
def test_a_jpeg_that_is_cut_off_is_no_picture(tmp_path, share):
    noise = np.random.default_rng(1).integers(0, 256, (120, 160), np.uint8)
    whole = cv2.imencode(".jpg", noise)[1].tobytes()
    (tmp_path / "a.jpg").write_bytes(whole)
    refuse_truncated_jpeg(tmp_path / "a.jpg")
    (tmp_path / "a.jpg").write_bytes(whole + b"what cameras put behind it")
    refuse_truncated_jpeg(tmp_path / "a.jpg")
    (tmp_path / "a.jpg").write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(RecordingCorrupt, match="incomplete"):
        refuse_truncated_jpeg(tmp_path / "a.jpg")
