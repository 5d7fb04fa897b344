"""The simulated optics and lens: poses, distortion as in OpenCV, where and how bright the target appears."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simulators.errors import ConfigError
from simulators.optics import picture as optics
from simulators.optics.lens import distort, image_point, ray_grid, undistort
from simulators.world.truth import CAMERAS, CameraTruth, CollimatorTruth, OpticsTruth, Truth
from simulators.world.truth_config import truth_from_config

SMALL = CameraTruth(fx=330.0, fy=331.0, cx=65.0, cy=34.0, k1=0.06, k2=-0.9, width=128, height=72)

ANGLES = st.floats(-12.0, 12.0)


def reference_projection(points_mm, rotation, truth):
    """Project the same points with OpenCV."""
    c, col = truth.camera, truth.collimator
    matrix = np.array([[c.fx, 0, c.cx], [0, c.fy, c.cy], [0, 0, 1.0]])
    pose = cv2.Rodrigues(rotation)[0], -rotation @ np.array([col.x, col.y, -col.r])
    points = np.column_stack([points_mm, np.zeros(len(points_mm))])
    if c.projection == "fisheye":
        image, _ = cv2.fisheye.projectPoints(points[None], *pose, matrix, np.array([c.k1, c.k2, c.k3, c.k4]))
    else:
        image, _ = cv2.projectPoints(points, *pose, matrix, np.array([c.k1, c.k2, c.p1, c.p2, c.k3]))
    return image.reshape(-1, 2)


@pytest.mark.parametrize(
    ("camera", "least"),
    [({"p1": 1e-3, "p2": -2e-3, "k3": 0.5}, 0), ({"projection": "fisheye", "k4": 2e-3}, 81)],
)
@given(pan=ANGLES, tilt=ANGLES, roll=st.floats(-180.0, 180.0))
def test_stars_lie_where_opencv_projects_them(camera, least, pan, tilt, roll):
    truth = truth_from_config({"camera": camera})
    rotation = optics.pose_rotation({"pan": pan, "tilt": tilt, "roll": roll}, truth.optics)
    ids, points = optics.star_centres(truth, rotation)
    assert len(ids) >= least
    expected = reference_projection(optics.TARGET.positions_mm(ids), rotation, truth)
    np.testing.assert_allclose(points, expected, atol=1e-6)


def test_a_pixel_of_a_fisheye_sees_the_print_that_is_projected_onto_it():
    camera = replace(CAMERAS["fisheye"], fx=190.0, fy=190.0, cx=65.0, cy=34.0, width=128, height=72)
    truth = Truth(
        camera=camera,
        optics=OpticsTruth(psf_px=0.0, gradient_x=0.0, gradient_y=0.0, black=0.0),
        collimator=CollimatorTruth(half_angle_deg=8.0, rim=0.0),
    )
    rotation = optics.pose_rotation({"pan": 9.0, "roll": 20.0}, truth.optics)
    image = optics.render(truth, rotation)
    lit = image > 0.0
    _, points = optics.star_centres(truth, rotation)
    v, u = np.nonzero(lit)
    assert np.abs([u.mean(), v.mean()] - points.mean(axis=0)).max() < 0.5
    assert image[lit].mean() == pytest.approx(0.5, abs=0.03)


def test_a_pixel_shows_the_share_of_white_print_that_opencv_projects_onto_it():
    truth = Truth(
        camera=SMALL,
        optics=OpticsTruth(psf_px=0.0, gradient_x=0.0, gradient_y=0.0, black=0.0),
        collimator=CollimatorTruth(half_angle_deg=30.0),
    )
    rotation = optics.pose_rotation({"pan": 2.0, "tilt": -1.0, "roll": 30.0}, truth.optics)
    image = optics.render(truth, rotation)
    # The other way round: print -> image, some 560 points a pixel, the same on all of the print.
    x, y = np.meshgrid(np.arange(70.0, 120.0, 0.033), np.arange(120.0, 160.0, 0.033))
    points = np.column_stack([x.ravel(), y.ravel()])
    u, v = np.round(reference_projection(points, rotation, truth)).astype(int).T
    shown = (u >= 0) & (u < 128) & (v >= 0) & (v < 72)
    cell = v[shown] * 128 + u[shown]
    count = np.bincount(cell, minlength=128 * 72)
    white = np.bincount(cell, optics.TARGET.reflectance(*points[shown].T), 128 * 72)
    whole = count > 0.95 * np.median(count[count > 0])
    difference = white[whole] / count[whole] - image.ravel()[whole]
    assert whole.sum() > 3000
    assert np.abs(difference).max() < 0.06  # the points' own, of which there are not that many
    assert difference.std() < 0.012
    assert abs(difference.mean()) < 2e-4


def test_nothing_is_seen_outside_the_disc_and_the_rim_is_soft():
    truth = Truth(camera=SMALL, collimator=CollimatorTruth(half_angle_deg=4.0, rim=0.2))
    rotation = optics.pose_rotation({}, OpticsTruth(mounting_deg=(0.0, 0.0, 0.0)))
    image = optics.render(truth, rotation)
    v, u = np.mgrid[:72, :128]
    radius = np.hypot(u - SMALL.cx, v - SMALL.cy) / (330.0 * math.tan(math.radians(4.0)))
    assert image[radius > 1.2].max() < 1e-6
    assert image[radius < 0.8].max() > 0.9
    assert image[(radius > 0.93) & (radius < 1.0)].max() < 0.3


# ---------------------------------------------------------------- the lens

FISHEYE = CameraTruth(
    fx=612.0, fy=610.0, cx=643.0, cy=358.0, k1=-0.02, k2=0.006, k3=-0.003, k4=0.0004, projection="fisheye"
)


@pytest.mark.parametrize("camera", [CameraTruth(p1=2e-3, p2=-1e-3), FISHEYE], ids=["pinhole", "fisheye"])
def test_undistortion_inverts_distortion(camera):
    xd, yd = np.meshgrid(np.linspace(-0.2, 0.2, 9), np.linspace(-0.12, 0.12, 7))
    xn, yn = undistort(xd, yd, camera)
    back_x, back_y = distort(xn, yn, camera)
    np.testing.assert_allclose(back_x, xd, atol=1e-12)
    np.testing.assert_allclose(back_y, yd, atol=1e-12)
    assert np.abs(xn - xd).max() > 1e-4


def test_points_behind_the_camera_have_no_image():
    assert np.isnan(image_point(0.1, 0.2, -1.0, CameraTruth())).all()


@pytest.mark.parametrize("camera", [CameraTruth(), FISHEYE], ids=["pinhole", "fisheye"])
def test_rays_of_the_grid_project_to_its_image_points(camera):
    rays = ray_grid(camera, 4)
    u, v = np.linspace(-4.5, 1283.5, rays.shape[1]), np.linspace(-4.5, 723.5, rays.shape[0])
    seen = image_point(*rays[7, 11], 1.0, camera)
    np.testing.assert_allclose(seen, [u[11], v[7]], atol=1e-9)


@pytest.mark.parametrize(
    "camera",
    [CameraTruth(k1=-5.0, k2=0.0), CameraTruth(k1=-2.0, k2=0.0, projection="fisheye")],
    ids=["pinhole", "fisheye"],
)
def test_distortion_that_folds_back_is_refused(camera):
    with pytest.raises(ConfigError, match="camera"):
        undistort(np.array([0.9]), np.array([0.5]), camera)
