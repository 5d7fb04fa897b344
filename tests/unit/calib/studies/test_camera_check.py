"""Whether a stated camera is still right: rates of false alarms and misses, the place, the cause."""

import numpy as np
import pytest

from calib.errors import InputMismatch
from calib.model.camera import CameraModel
from calib.studies.camera_check import check_camera

SIZE = (1280, 720)
LENS = {"k1": 0.06, "k2": -0.9, "p1": 3e-4, "p2": -2e-4}
CAMERA = CameraModel(3345.0, 3345.5, 643.2, 364.8, SIZE, LENS)
SIGMA = np.array([1.0, 1.0, 1.2, 1.4, 6e-3, 0.15, 2e-4, 2e-4])


def drawn_covariance(rng):
    """Sigmas as those of a run, with drawn correlations."""
    factor = rng.normal(size=(8, 12))
    shape = factor @ factor.T
    scale = SIGMA / np.sqrt(np.diag(shape))
    return shape * np.outer(scale, scale)


def with_values(values):
    return CameraModel(*values[:4], SIZE, dict(zip(LENS, values[4:].tolist(), strict=True)))


def share_not_right(change, n):
    """Share of checks that find the camera not right, where its focal length changed by ``change`` times U."""
    wrong = 0
    for seed in range(n):
        rng = np.random.default_rng([7, seed])
        covariance = drawn_covariance(rng)
        moved = 2.0 * change * np.sqrt(2.0) * SIGMA * np.array([1, 1, 0, 0, 0, 0, 0, 0])
        old, new = (rng.multivariate_normal(np.zeros(8), covariance) for _ in range(2))
        stated, found = with_values(CAMERA.values + old), with_values(CAMERA.values + moved + new)
        wrong += not check_camera(stated, covariance, found, covariance, rng).right
    return wrong / n


def test_a_camera_that_did_not_change_is_called_wrong_in_about_one_case_of_twenty():
    assert 0.01 <= share_not_right(0.0, 150) <= 0.10


def test_the_larger_the_change_the_more_often_it_is_found():
    half, one, three = (share_not_right(change, 50) for change in (0.5, 1.0, 3.0))
    assert half <= one <= three
    assert half < 0.35
    assert three > 0.9


@pytest.mark.parametrize(
    ("change", "cause"),
    [
        ({"fx": 12.0, "fy": 12.0}, "scale"),
        ({"cx": 60.0, "cy": -40.0}, "principal point"),
        ({"k1": 0.05}, "lens"),
    ],
)
def test_one_kind_of_change_is_named(change, cause):
    values = dict(zip(CAMERA.parameter_names, CAMERA.values, strict=True))
    moved = with_values(np.array([values[name] + change.get(name, 0.0) for name in values]))
    checked = check_camera(CAMERA, None, moved, np.diag((SIGMA / 20.0) ** 2), np.random.default_rng(1))
    assert not checked.right
    assert checked.cause == cause


def test_a_change_of_scale_is_largest_in_a_corner():
    longer = with_values(CAMERA.values + np.array([9.0, 9.0, 0, 0, 0, 0, 0, 0]))
    checked = check_camera(CAMERA, None, longer, np.diag(SIGMA**2), np.random.default_rng(1))
    offsets = {one.name: one.offset_px for one in checked.regions}
    assert len(offsets) == 9
    corners = [offsets[f"{row} {column}"] for row in ("top", "bottom") for column in ("left", "right")]
    assert min(corners) > 1.5 * offsets["middle centre"]
    # By the definition of the focal length: a point moves by its distance from the centre, times the change.
    assert checked.rms_px == pytest.approx(9.0 / 3345.0 * np.sqrt((1280**2 + 720**2) / 12.0), rel=0.1)


def test_a_fisheye_and_another_lens_are_compared_by_what_they_project():
    fisheye = CameraModel(400.0, 400.0, 640.0, 360.0, SIZE, {"kb1": 0.0, "kb2": 0.0, "kb3": 0.0, "kb4": 0.0})
    pinhole = CameraModel(400.0, 400.0, 640.0, 360.0, SIZE, {})
    checked = check_camera(fisheye, None, pinhole, np.diag([0.1] * 4), np.random.default_rng(1))
    assert not checked.right
    assert checked.worst.offset_px > 50.0


def test_a_camera_of_another_size_is_refused():
    other = CameraModel(3345.0, 3345.5, 320.0, 240.0, (640, 480), {})
    with pytest.raises(InputMismatch, match="640 x 480 px, these views have 1280 x 720 px"):
        check_camera(other, None, CAMERA, np.diag(SIGMA**2), np.random.default_rng(1))
