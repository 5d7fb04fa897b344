"""Recordings whose stars have correlated errors; the stored image."""

import numpy as np
import pytest

from bench.views.measure import StoredImage, aligned_poses
from calib.events.grey_image import to_uint8


def facts(roll_deg: float, kind: str) -> dict:
    turn = np.radians(roll_deg)
    grid = [
        [50 * np.cos(turn), -50 * np.sin(turn), 300],
        [50 * np.sin(turn), 50 * np.cos(turn), 200],
        [1e-5, 0, 1],
    ]
    return {"grid": grid, "image": {"kind": kind}}


@pytest.mark.parametrize("roll_deg", [0.4, -2, 44, 46.5, 90, 181, -135])
def test_edges_along_rows_or_diagonals_are_counted(roll_deg):
    assert aligned_poses([facts(roll_deg, "fired-per-edge"), facts(10, "fired-per-edge")]) == 1


@pytest.mark.parametrize("roll_deg", [10, -10, 22.5, 35, 100, 170])
def test_a_rolled_camera_is_not_counted(roll_deg):
    assert aligned_poses([facts(roll_deg, "fired-per-edge")]) == 0


def test_images_with_levels_of_grey_may_be_aligned():
    assert aligned_poses([facts(0, "lock-in"), facts(0, "picture")]) == 0


def test_recordings_without_stars_are_left_out():
    assert aligned_poses([{"image": {"kind": "last-polarity"}}, {}]) == 0
    blinking_dots = {"grid": facts(0, "lock-in")["grid"]}  # they have no event image
    assert aligned_poses([blinking_dots]) == 0


def test_a_stored_image_is_small_and_lossless():
    image = np.zeros((720, 1280), np.float32)
    image[::9, ::7] = np.random.default_rng(1).uniform(0, 40, image[::9, ::7].shape)
    picture = StoredImage.from_image(image)
    assert np.array_equal(picture.decoded(), to_uint8(image))
    assert len(picture.png) < image.nbytes / 20
