"""Pictures and videos that are not read: the message says what they are and how they become ones that are."""

import cv2
import numpy as np
import pytest

from bench.base.errors import BenchError, UsageError
from bench.solve.offline_options import OfflineOptions
from bench.solve.view_sources import left_beside, picture_of, view_sources
from calib.boards.board import Board
from calib.errors import TargetNotFound

#: First bytes by the formats' own documents: ISO 14496-12 and 23008-12, RIFF, GIF89a, Matroska, ISO 15444-1.
STARTS = {
    "IMG_1.HEIC": (b"\0\0\0\x18ftypheic", "a HEIC picture", "Convert it to PNG"),
    "a.webp": (b"RIFF\x10\0\0\0WEBP", "a WebP picture", "Convert it to PNG"),
    "a.jp2": (b"\0\0\0\x0cjP  \r\n", "a JPEG 2000 picture", "Convert it to PNG"),
    "DSC_1.NEF": (b"MM\0*", "a raw picture of a photo camera", "nor correct the lens"),
    "I.cr2": (b"II*\0\x10\0\0\0CR\2\0", "a raw picture of a photo camera", "nor correct the lens"),
    "a.mp4": (b"\0\0\0\x18ftypmp42", "a video", "ffmpeg"),
    "a.avi": (b"RIFF\x10\0\0\0AVI LIST", "a video", "ffmpeg"),
    "a.mkv": (b"\x1aE\xdf\xa3", "a video", "ffmpeg"),
}
CHOICES = OfflineOptions(board=Board("checkerboard", 9, 6, 25.0))


@pytest.mark.parametrize("name", STARTS)
def test_a_picture_that_is_not_read_is_named_with_the_way_out(tmp_path, name):
    start, what, remedy = STARTS[name]
    (tmp_path / name).write_bytes(start + bytes(200))
    with pytest.raises(UsageError, match=what) as alone:
        next(view_sources(tmp_path / name, CHOICES))
    assert remedy in alone.value.remedy
    with pytest.raises(UsageError, match="point file") as folder:
        next(view_sources(tmp_path, CHOICES))
    assert f"{name} is {what}" in folder.value.remedy
    assert remedy in folder.value.remedy
    (line,) = left_beside(tmp_path)
    assert f"{name} is {what}" in line


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (b"\0\0\0\x18ftypheic" + bytes(200), "a HEIC picture"),
        (b"", "empty"),
        (b"<html>not found</html>", "a web page"),
    ],
)
def test_a_file_with_the_ending_of_another_format_is_named_as_what_it_is(tmp_path, content, why):
    (tmp_path / "a.jpg").write_bytes(content)
    with pytest.raises(BenchError, match=f"The file is {why}"):
        picture_of(tmp_path / "a.jpg")


def test_a_folder_of_folders_names_them(tmp_path):
    (tmp_path / "left").mkdir()
    with pytest.raises(UsageError) as error:
        next(view_sources(tmp_path, CHOICES))
    assert "left" in error.value.remedy


def test_pages_of_one_file_that_show_no_board_together_are_named(tmp_path):
    drawn = np.full((240, 320), 200, np.uint8)
    pages = [
        np.roll(cv2.rectangle(drawn.copy(), (60, 60), (120, 120), 20, -1), shift, axis=1) for shift in (0, 50)
    ]
    cv2.imwritemulti(str(tmp_path / "all.tiff"), pages)
    (source,) = view_sources(tmp_path / "all.tiff", CHOICES)
    with pytest.raises(TargetNotFound) as error:
        source.read()
    assert "the mean of 2 pages" in error.value.remedy


def test_a_small_preview_beside_a_picture_is_left_out(tmp_path):
    drawn = np.random.default_rng(1).integers(0, 255, (240, 320), dtype=np.uint8)
    cv2.imwritemulti(str(tmp_path / "a.tiff"), [drawn, cv2.resize(drawn, (80, 60))])
    np.testing.assert_array_equal(picture_of(tmp_path / "a.tiff"), drawn)


@pytest.mark.parametrize("ending", [".jfif", ".ppm"])
def test_other_endings_of_pictures_are_read(tmp_path, ending):
    drawn = np.full((60, 80, 3), 90, np.uint8)
    _, coded = cv2.imencode(".jpg" if ending == ".jfif" else ending, drawn)
    (tmp_path / f"a{ending}").write_bytes(coded.tobytes())
    np.testing.assert_allclose(picture_of(tmp_path / f"a{ending}"), 90, atol=1)
