"""Homographies of single views."""

from dataclasses import replace

import numpy as np
import pytest

from calib.errors import DegenerateViews, InputMismatch, TooFewStars
from calib.model.homography import apply_homography, view_homography
from calib.view import View

RNG = np.random.default_rng(5)
TRUE = np.array([[12.0, -3.0, 100.0], [2.5, 11.0, 50.0], [1e-3, -2e-3, 1.0]])


def view_of(target, pixels):
    n = len(target)
    return View("one", (1280, 720), np.arange(n), pixels, target, np.tile(np.eye(2), (n, 1, 1)))


@pytest.mark.parametrize("stars", [4, 5, 40])
def test_exact_points_give_the_homography_back_with_determinant_one(stars):
    target = np.random.default_rng(stars).uniform(0, 60, (stars, 2))
    h = view_homography(view_of(target, apply_homography(TRUE, target)))
    assert np.linalg.det(h) == pytest.approx(1.0)
    assert np.allclose(h / h[2, 2], TRUE, rtol=1e-9)


def test_stars_far_off_hardly_count():
    target = RNG.uniform(0, 60, (60, 2))
    pixels = apply_homography(TRUE, target) + 0.02 * RNG.standard_normal((60, 2))
    pixels[:5] += 200.0
    h = view_homography(view_of(target, pixels))
    assert np.abs(apply_homography(h, target[5:]) - apply_homography(TRUE, target[5:])).max() < 1.0


def test_a_mirrored_target_is_refused():
    target = RNG.uniform(0, 60, (40, 2))
    with pytest.raises(InputMismatch, match="mirrored"):
        view_homography(view_of(target * [-1, 1], apply_homography(TRUE, target)))


def test_too_few_stars_are_refused():
    target = RNG.uniform(0, 60, (3, 2))
    with pytest.raises(TooFewStars, match="view one"):
        view_homography(view_of(target, target))


@pytest.mark.parametrize("which", ["target_mm", "points_px"])
def test_stars_on_a_line_are_refused(which):
    target = RNG.uniform(0, 60, (40, 2))
    view = view_of(target, apply_homography(TRUE, target))
    line = RNG.uniform(0, 60, (40, 1)) * [1.0, 2.0] + [3.0, 4.0]
    with pytest.raises(DegenerateViews, match="line"):
        view_homography(replace(view, **{which: line}))
