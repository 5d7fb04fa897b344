"""The shift of stars between the halves of a recording: of drawn pictures, and where the halves do not show one."""

import cv2
import numpy as np
import pytest
from scipy.ndimage import fourier_shift

from calib import StarTarget, View
from calib.errors import TooFewStars
from calib.stars.motion import MAX_SHIFT_PITCHES, shift_between_halves

TARGET, PITCH_PX = StarTarget(), 40.0


def picture(seed=1):
    """Return a smooth picture without a period, (400, 640) float32."""
    noise = np.random.default_rng(seed).normal(size=(400, 640)).astype(np.float32)
    return cv2.GaussianBlur(noise, (0, 0), 3.0)


def moved(image, shift_px):
    """Shift a picture by its Fourier transform, which is exact; what leaves it comes in on the other side."""
    return np.fft.ifft2(fourier_shift(np.fft.fft2(image), shift_px[::-1])).real.astype(np.float32)


def view(stars=40):
    columns, rows = np.indices((12, 8)).reshape(2, -1)
    nodes = np.column_stack([columns, rows])[TARGET.id_at(columns, rows) >= 0]
    nodes = np.random.default_rng(3).permutation(nodes)[:stars]
    ids = TARGET.id_at(*nodes.T)
    order = np.argsort(ids)
    points = (np.array([90.0, 70.0]) + PITCH_PX * nodes)[order]
    covariances = np.tile(1e-4 * np.eye(2), (len(ids), 1, 1))
    return View("v", (640, 400), ids[order], points, TARGET.positions_mm(ids[order]), covariances)


@pytest.mark.parametrize("shift_px", [(0.0, 0.0), (0.3, -0.1), (-3.0, 4.0)])
def test_a_shifted_picture_has_its_shift_whatever_its_brightness(shift_px):
    first = picture()
    second = 0.8 * moved(first, shift_px) + 0.1
    assert shift_between_halves(first, second, view(), TARGET) == pytest.approx(shift_px, abs=0.005)


def test_pixels_without_a_value_do_not_matter():
    first = picture()
    second = moved(first, (0.2, 0.2))
    first[5, 7] = second[200, 300] = np.nan
    assert shift_between_halves(first, second, view(), TARGET) == pytest.approx((0.2, 0.2), abs=0.005)


@pytest.mark.parametrize(
    ("second", "stars"),
    [
        (np.zeros((400, 640), np.float32), 40),
        (picture(2), 40),
        (moved(picture(), (MAX_SHIFT_PITCHES * PITCH_PX + 2.0, 0.0)), 40),
        (picture(), 7),
    ],
    ids=["dark", "another picture", "too far", "few stars"],
)
def test_halves_that_do_not_share_enough_stars_give_no_shift(second, stars):
    with pytest.raises(TooFewStars, match="8 are needed"):
        shift_between_halves(picture(), second, view(stars), TARGET)
