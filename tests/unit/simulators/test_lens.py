"""The lens: both models agree with OpenCV, and so do their inverses."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simulators.errors import ConfigError
from simulators.optics.lens_focus import distort, image_point, lens_of, ray_grid, undistort
from simulators.world.truth import CameraTruth

K = ("k1", "k2", "k3", "k4")
FISHEYE = CameraTruth(
    fx=612.0, fy=610.0, cx=643.0, cy=358.0, k1=-0.02, k2=0.006, k3=-0.003, k4=0.0004, projection="fisheye"
)


@pytest.mark.parametrize("camera", [CameraTruth(p1=2e-3, p2=-1e-3), FISHEYE], ids=["pinhole", "fisheye"])
def test_undistortion_inverts_distortion(camera):
    xd, yd = np.meshgrid(np.linspace(-0.2, 0.2, 9), np.linspace(-0.12, 0.12, 7))
    xn, yn = undistort(xd, yd, camera)
    back_x, back_y = distort(xn, yn, lens_of(camera))
    np.testing.assert_allclose(back_x, xd, atol=1e-12)
    np.testing.assert_allclose(back_y, yd, atol=1e-12)
    assert np.abs(xn - xd).max() > 1e-4


@given(x=st.floats(-0.9, 0.9), y=st.floats(-0.6, 0.6), k=st.tuples(*[st.floats(-0.03, 0.03)] * 4))
def test_the_fisheye_model_agrees_with_opencv(x, y, k):
    camera = CameraTruth(
        fx=612.0, fy=610.0, cx=643.0, cy=358.0, projection="fisheye", **dict(zip(K, k, strict=True))
    )
    matrix = np.array([[612.0, 0.0, 643.0], [0.0, 610.0, 358.0], [0.0, 0.0, 1.0]])
    nothing = np.zeros(3)
    expected, _ = cv2.fisheye.projectPoints(np.array([[[x, y, 1.0]]]), nothing, nothing, matrix, np.array(k))
    np.testing.assert_allclose(image_point(3 * x, 3 * y, 3.0, lens_of(camera)), expected.ravel(), atol=1e-9)


def test_points_behind_the_camera_have_no_image():
    assert np.isnan(image_point(0.1, 0.2, -1.0, lens_of(CameraTruth()))).all()


@pytest.mark.parametrize("camera", [CameraTruth(), FISHEYE], ids=["pinhole", "fisheye"])
def test_rays_of_the_grid_project_to_its_image_points(camera):
    rays = ray_grid(camera, 4)
    u, v = np.linspace(-4.5, 1283.5, rays.shape[1]), np.linspace(-4.5, 723.5, rays.shape[0])
    seen = image_point(*rays[7, 11], 1.0, lens_of(camera))
    np.testing.assert_allclose(seen, [u[11], v[7]], atol=1e-9)


@pytest.mark.parametrize(
    "camera",
    [CameraTruth(k1=-5.0, k2=0.0), CameraTruth(k1=-2.0, k2=0.0, projection="fisheye")],
    ids=["pinhole", "fisheye"],
)
def test_distortion_that_folds_back_is_refused(camera):
    with pytest.raises(ConfigError, match="camera"):
        undistort(np.array([0.9]), np.array([0.5]), camera)
