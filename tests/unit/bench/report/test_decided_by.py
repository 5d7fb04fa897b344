"""What somebody decides by stands on the page of a report; the rest stands behind one fold, and on paper."""

import numpy as np
import pytest
from report_sample import SMALL, sample

from bench.measure.view_picture import ViewPicture
from bench.report.pose_scene import pose_scene
from bench.report.residual_words import direction_text, rim_text
from bench.wording.target_words import STARS


def residuals(*, rim_px, middle_px=0.1, stars=400):
    rng = np.random.default_rng(4)
    points = rng.uniform([0, 0], [1280, 720], (stars, 2))
    far = np.linalg.norm(points - [640, 360], axis=1) > 560
    sigma = np.where(far, rim_px, middle_px)[:, None]
    errors = rng.normal(0.0, 1.0, (stars, 2)) * sigma
    return [ViewPicture("one", None, points, points - errors, np.arange(stars))]


@pytest.mark.parametrize(("rim_px", "stands_out"), [(0.1, False), (0.12, False), (0.25, True)])
def test_residuals_at_the_rim_are_told_only_if_they_stand_out(rim_px, stands_out):
    text = rim_text(residuals(rim_px=rim_px), {"cx": 640.0, "cy": 360.0}, STARS)
    assert bool(text) == stands_out
    if stands_out:
        assert "px RMS, and 0.14 px in the middle" in text  # two numbers each


def test_residuals_of_one_direction_are_told_with_their_part_of_the_image():
    (noise,) = residuals(rim_px=0.1)
    assert direction_text([noise], (1280, 720)) == ""
    corner = (noise.detected < [400, 230]).all(axis=1)[:, None]
    shifted = ViewPicture("one", None, noise.detected, noise.reprojected + 0.3 * corner, noise.ids)
    assert "upper left" in direction_text([shifted], (1280, 720))
    assert direction_text([], (1280, 720)) == ""


def test_the_scene_shows_each_pose_from_the_camera_to_the_target():
    calibration = dict(sample(size=SMALL).results["calibration"])
    svg = pose_scene(calibration)
    assert "Poses: 3 of 3" in svg
    assert svg.count("<circle") == 3
    assert svg.count("<path") == 1 + 3 * 5  # the target; the image and four edges of each pose
    calibration["views"] = calibration["views"][:1]
    assert "Poses: 1 of 1" in pose_scene(calibration)
    calibration["views"] = []
    assert pose_scene(calibration) == ""
