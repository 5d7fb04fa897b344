"""Point files of other programs: read with their convention, refused with file and line."""

import numpy as np
import pytest

from bench.base.errors import BenchError, StorageError
from bench.results.offline_options import read_point_file

GOOD = "10.5 20.5 4.0 8.0 7\n# a remark\n\n30.5, 40.5, 12.0, 16.0, 9\n"


def write(tmp_path, text):
    path = tmp_path / "image1.txt"
    path.write_text(text)
    return path


def test_corner_coordinates_become_opencv_ones(tmp_path):
    view = read_point_file(write(tmp_path, GOOD), image_size=(64, 48))
    np.testing.assert_array_equal(view.points_px, [[10.0, 20.0], [30.0, 40.0]])
    np.testing.assert_array_equal(view.target_mm, [[4.0, 8.0], [12.0, 16.0]])
    assert view.ids.tolist() == [7, 9]
    assert (view.name, view.image_size) == ("image1", (64, 48))


def test_coordinates_with_pixel_centres_at_integers_are_not_shifted(tmp_path):
    view = read_point_file(write(tmp_path, GOOD), image_size=None, origin="centre")
    assert view.points_px[0].tolist() == [10.5, 20.5]
    assert view.image_size == (32, 42)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("1 2 3 4 5\n1 2 3\n", r"image1\.txt:2: The line has 3 columns instead of 5"),
        ("1 2 x 4 5\n", r"image1\.txt:1: Not a number"),
        ("1 2 nan 4 5\n", r"image1\.txt:1: A number is not finite"),
        ("1 2 3 4 5.5\n", r"image1\.txt:1: .*integer"),
        ("1 2 3 4 5\n6 7 8 9 5\n", "a star twice"),
        ("\n# nothing\n", "has no points"),
        ("1 2 3 4 1e300\n", r"image1\.txt:1: .*integer"),
        ("5 5 3 4 1\n-1.5 2 3 4 5\n", r"1 of 2 points are outside .* at \(-1\.5, 2\)"),
    ],
)
def test_bad_lines_are_refused_with_their_place(tmp_path, text, words):
    with pytest.raises(BenchError, match=words):
        read_point_file(write(tmp_path, text), image_size=None)


def test_points_beside_the_image_are_refused_as_of_sides_told_in_the_other_order(tmp_path):
    path = write(tmp_path, GOOD)
    with pytest.raises(BenchError, match=r"1 of 2 points are outside an image of 48 x 32 px; .*30\.5, 40\.5"):
        read_point_file(path, image_size=(48, 32))
    assert len(read_point_file(path, image_size=(30, 40))) == 2


def test_a_byte_order_mark_is_no_part_of_the_first_number(tmp_path):
    view = read_point_file(write(tmp_path, "\ufeff" + GOOD), image_size=(64, 48))
    assert view.points_px[0].tolist() == [10.0, 20.0]


def test_a_file_that_is_not_text_or_not_there_is_refused(tmp_path):
    (tmp_path / "b.txt").write_bytes(b"\xff\xfe\x00\x01")
    with pytest.raises(BenchError, match="not UTF-8 text"):
        read_point_file(tmp_path / "b.txt", image_size=None)
    with pytest.raises(StorageError, match="cannot be read"):
        read_point_file(tmp_path / "none.txt", image_size=None)
