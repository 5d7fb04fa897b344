"""Projection, distortion and their derivatives, against OpenCV and finite differences."""

import cv2
import numpy as np
import pytest

from calib.errors import InputMismatch
from calib.model.camera import CameraModel, distortion_names
from calib.model.lens import BROWN

RNG = np.random.default_rng(4)
POINTS = np.column_stack([RNG.uniform(-0.4, 0.4, (60, 2)), np.ones(60)]) * RNG.uniform(0.5, 300, (60, 1))
COEFFICIENTS = dict(zip(BROWN, [-0.2, 0.1, 1e-3, -2e-3, 0.05, 0.02, -0.01, 0.03], strict=True))


def camera(**distortion):
    return CameraModel(810.0, 790.0, 641.0, 355.0, (1280, 720), distortion)


@pytest.mark.parametrize("names", [(), ("k1", "k2"), ("k1", "k2", "p1", "p2", "k3"), BROWN])
def test_projection_is_that_of_opencv(names):
    model = camera(**{name: COEFFICIENTS[name] for name in names})
    expected = cv2.projectPoints(POINTS, np.zeros(3), np.zeros(3), model.matrix, model.coefficients)[0][:, 0]
    assert np.allclose(model.project(POINTS), expected, atol=1e-9)
    assert np.allclose(model.project_with_jacobians(POINTS)[0], expected, atol=1e-9)


WIDE = np.column_stack([RNG.uniform(-2.5, 2.5, (60, 2)), np.ones(60)]) * RNG.uniform(0.5, 300, (60, 1))
FISHEYE = dict(zip(("kb1", "kb2", "kb3", "kb4"), [-0.02, 0.01, -0.004, 0.0007], strict=True))


@pytest.mark.parametrize(
    ("lens", "points"),
    [(COEFFICIENTS, POINTS), ({**COEFFICIENTS, "skew": 2.5}, POINTS), (FISHEYE, WIDE)],
    ids=["Brown", "skewed", "fisheye"],
)
def test_derivatives_agree_with_finite_differences(lens, points):
    model = camera(**lens)
    _, by_points, by_parameters = model.project_with_jacobians(points)
    for i in range(3):
        step = np.eye(3)[i] * 1e-6 * points[:, 2:]
        slope = (model.project(points + step) - model.project(points - step)) / (2e-6 * points[:, 2:])
        assert np.allclose(by_points[:, :, i], slope, rtol=1e-6, atol=1e-6 * np.abs(slope).max())
    loose = 10.0 if lens is FISHEYE else 1.0
    for i, step in enumerate(1e-5 * np.eye(len(model.values))):
        slope = model.with_values(model.values + step).project(points)
        slope = (slope - model.with_values(model.values - step).project(points)) / 2e-5
        assert np.allclose(by_parameters[:, :, i], slope, rtol=1e-6 * loose, atol=1e-5 * loose)


def test_rays_invert_the_projection():
    model = camera(k1=-0.2, k2=0.1, p1=1e-3, p2=-2e-3, k3=0.01, skew=3.0)
    unit = POINTS / np.linalg.norm(POINTS, axis=1, keepdims=True)
    assert np.allclose(model.rays(model.project(POINTS)), unit, atol=1e-12)


def test_rays_beyond_the_fold_of_the_distortion_are_nan():
    # r (1 - r^2) is at most 0.385: no ray arrives at the image's rim.
    model = camera(k1=-1.0)
    assert np.isnan(model.rays(np.array([[641.0 + 0.5 * 810.0, 355.0]]))).all()
    assert np.isfinite(model.rays(np.array([[700.0, 355.0]]))).all()


def test_a_point_behind_the_camera_has_no_image():
    assert np.isnan(camera().project(np.array([[0.1, 0.1, -1.0], [0.1, 0.1, 0.0]]))).all()


def test_a_camera_made_of_its_own_values_is_the_same():
    model = camera(k1=0.1, k2=0.2)
    assert model.parameter_names == ("fx", "fy", "cx", "cy", "k1", "k2")
    assert model.with_values(model.values) == model
    assert model.to_dict()["k2"] == 0.2


def test_distortion_sets_keep_opencvs_order_and_refuse_the_unknown():
    assert distortion_names("k1k2k3p1p2") == ("k1", "k2", "p1", "p2", "k3")
    assert distortion_names(["k3", "k1"]) == ("k1", "k3")
    with pytest.raises(InputMismatch, match="Known: "):
        distortion_names("k1k9")
    with pytest.raises(InputMismatch, match="k9"):
        distortion_names(["k9"])
    with pytest.raises(InputMismatch, match="k1 kb1"):
        distortion_names(["k1", "kb1"])


def test_a_fisheye_projects_as_opencvs_does():
    model = camera(**FISHEYE)
    bent = np.array(list(FISHEYE.values()))
    expected = cv2.fisheye.projectPoints(WIDE[:, None], np.zeros(3), np.zeros(3), model.matrix, bent)[0][:, 0]
    assert np.allclose(model.project(WIDE), expected, atol=1e-9)
    unit = WIDE / np.linalg.norm(WIDE, axis=1, keepdims=True)
    assert np.allclose(model.rays(model.project(WIDE)), unit, atol=1e-10)
    with pytest.raises(InputMismatch, match="fisheye"):
        _ = model.coefficients
