"""Images that state more than their file can hold are refused before a decoder allocates memory."""

import struct

import cv2
import numpy as np
import pytest
from hostile_files import png, tiff

from drivers.camera.frames import image_sizes, read_frames, write_frames
from drivers.errors import DriverError, NotARecording


@pytest.mark.parametrize("ending", [".png", ".jpg", ".bmp", ".pgm", ".tif"])
@pytest.mark.parametrize(("width", "height"), [(640, 480), (31, 7)])
def test_the_size_is_that_of_the_decoder(tmp_path, ending, width, height):
    path = tmp_path / f"a{ending}"
    cv2.imwrite(str(path), np.random.default_rng(1).integers(0, 255, (height, width)).astype(np.uint8))
    with path.open("rb") as file:
        assert image_sizes(file) == [(width, height)]


def test_every_page_counts(tmp_path):
    write_frames(tmp_path / "a.tiff", [np.zeros((20, 30), np.uint16)] * 3)
    with (tmp_path / "a.tiff").open("rb") as file:
        assert image_sizes(file) == [(30, 20)] * 3
    assert read_frames(tmp_path / "a.tiff").shape == (3, 20, 30)


@pytest.mark.parametrize(
    ("name", "data", "message"),
    [
        ("a.png", png(100_000, 100_000), "100000 x 100000 px; at most"),
        ("a.png", png(8000, 8000, rows=8000), "64000000 px in [0-9]+ bytes; photographs cannot"),
        ("a.tif", tiff(3, 16, loop=True), "its list of images does not end"),
        ("a.tif", tiff(9, 60_000), "60000 x 60000 px; at most"),
        ("a.tif", tiff(2000, 4000), "px in [0-9]+ bytes; photographs cannot"),
        ("a.tif", tiff(2, 16)[:50], "The picture is damaged"),
        ("a.jpg", b"\xff\xd8" + b"\xff\xe0\0\2" * 20_000, "its list of segments does not end"),
        ("a.jpg", b"\xff\xd8\xff\xc0\0\x11\x08\xff\xff\xff\xff" + bytes(200), "65535 x 65535 px; at most"),
        ("a.bmp", b"BM" + bytes(16) + struct.pack("<ii", 1 << 20, -(1 << 20)), "1048576 x 1048576 px"),
        ("a.pgm", b"P5 # wide\n90000 90000\n255\n", "90000 x 90000 px"),
    ],
)  # fmt: skip
def test_images_that_no_file_of_this_size_can_hold_are_refused(tmp_path, name, data, message):
    (tmp_path / name).write_bytes(data)
    with pytest.raises(NotARecording, match=message):
        read_frames(tmp_path / name)


@pytest.mark.parametrize("length", [0, 3, 20, 40])
def test_a_cut_image_of_any_kind_is_one_error(tmp_path, length):
    for ending, data in (
        (".png", png(640, 480, rows=480)),
        (".tif", tiff(3, 16)),
        (".jpg", b"\xff\xd8\xff\xe0\0\x10JFIF"),
    ):
        path = tmp_path / f"a{ending}"
        path.write_bytes(data[:length])
        with pytest.raises(DriverError):
            read_frames(path)
