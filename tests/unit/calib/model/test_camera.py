"""Projection, distortion and their derivatives, against OpenCV and finite differences."""

import cv2
import numpy as np
import pytest
from slow_cases import first_quick

from calib.errors import InputMismatch
from calib.model.camera import CameraModel, distortion_names, undistort
from calib.model.lens import BROWN, OPENCV

RNG = np.random.default_rng(4)
POINTS = np.column_stack([RNG.uniform(-0.4, 0.4, (60, 2)), np.ones(60)]) * RNG.uniform(0.5, 300, (60, 1))
COEFFICIENTS = dict(zip(BROWN, [-0.2, 0.1, 1e-3, -2e-3, 0.05, 0.02, -0.01, 0.03], strict=True))


def camera(**distortion):
    return CameraModel(810.0, 790.0, 641.0, 355.0, (1280, 720), distortion)


EVERY = {**COEFFICIENTS, **dict(zip(OPENCV[8:], [0.004, -0.003, 0.006, 0.002, 0.03, -0.05], strict=True))}


@pytest.mark.parametrize(
    "names",
    [(), ("k1", "k2"), BROWN[:5], BROWN, ("k1", "s1", "s4"), ("tauX",), OPENCV[:12], OPENCV],
)
def test_projection_is_that_of_opencv(names):
    model = camera(**{name: EVERY[name] for name in names})
    lens = np.array([EVERY[name] if name in names else 0.0 for name in OPENCV])
    expected = cv2.projectPoints(POINTS, np.zeros(3), np.zeros(3), model.matrix, lens)[0][:, 0]
    assert np.array_equal(model.coefficients, lens[: len(model.coefficients)])
    assert np.allclose(model.project(POINTS), expected, atol=1e-9)
    assert np.allclose(model.project_with_jacobians(POINTS)[0], expected, atol=1e-9)


def test_skew_shifts_u_by_the_height_over_the_centre():
    skewed = camera(**COEFFICIENTS, skew=2.5)
    u, v = camera(**COEFFICIENTS).project(POINTS).T
    assert np.allclose(skewed.project(POINTS), np.column_stack([u + 2.5 * (v - 355.0) / 790.0, v]), atol=1e-9)


WIDE = np.column_stack([RNG.uniform(-2.5, 2.5, (60, 2)), np.ones(60)]) * RNG.uniform(0.5, 300, (60, 1))
FISHEYE = dict(zip(("kb1", "kb2", "kb3", "kb4"), [-0.02, 0.01, -0.004, 0.0007], strict=True))


@pytest.mark.parametrize(
    ("lens", "points"),
    [
        (COEFFICIENTS, POINTS),
        ({**COEFFICIENTS, "skew": 2.5}, POINTS),
        ({**EVERY, "skew": 2.5}, POINTS),
        ({"tauY": 0.1, "k1": -0.1, "s3": 0.01}, POINTS),
        (FISHEYE, WIDE),
    ],
    ids=["Brown", "skewed", "all of OpenCV", "tilted", "fisheye"],
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
    model = camera(
        k1=-0.2, k2=0.1, p1=1e-3, p2=-2e-3, k3=0.01, skew=3.0, s1=0.004, s4=-0.002, tauX=0.03, tauY=-0.05
    )
    unit = POINTS / np.linalg.norm(POINTS, axis=1, keepdims=True)
    assert np.allclose(model.rays(model.project(POINTS)), unit, atol=1e-12)


def test_rays_beyond_the_fold_of_the_distortion_are_nan():
    # r (1 - r^2) is at most 0.385: no ray arrives at the image's rim.
    model = camera(k1=-1.0)
    assert np.isnan(model.rays(np.array([[641.0 + 0.5 * 810.0, 355.0]]))).all()
    assert np.isfinite(model.rays(np.array([[700.0, 355.0]]))).all()


def test_a_point_that_a_lens_reaches_again_far_beyond_its_fold_has_no_ray():
    """The lens folds at a tangent of 1.05; at 2.4 it comes back to this point."""
    model = CameraModel(476.0, 476.0, 639.5, 359.5, (1280, 720), {"k1": -0.386, "k2": 0.045})
    near, far = model.rays(np.array([[639.5 + 250.0, 359.5], [639.5 + 346.0, 359.5]]))
    assert model.project(near[None])[0] == pytest.approx([889.5, 359.5])
    assert np.isnan(far).all()


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
    assert set(distortion_names("skewk2k1")) == {"k1", "k2", "skew"}
    for unknown in ("", "k1k1", "kb1skew", "k1k9", "k1,k2", "k1k2 skew", "tangential", ["k9"], ["k1", "kb1"]):
        with pytest.raises(InputMismatch):
            distortion_names(unknown)


def test_a_fisheye_projects_as_opencvs_does():
    model = camera(**FISHEYE)
    bent = np.array(list(FISHEYE.values()))
    expected = cv2.fisheye.projectPoints(WIDE[:, None], np.zeros(3), np.zeros(3), model.matrix, bent)[0][:, 0]
    assert np.allclose(model.project(WIDE), expected, atol=1e-9)
    unit = WIDE / np.linalg.norm(WIDE, axis=1, keepdims=True)
    assert np.allclose(model.rays(model.project(WIDE)), unit, atol=1e-10)
    with pytest.raises(InputMismatch, match="fisheye"):
        _ = model.coefficients


# ---------------------------------------------------------------- images without distortion: the tables agree with OpenCV's, for Brown's and for fisheye lenses


SMALL = (320, 180)
BROWN_LENS = {"k1": -0.3, "k2": 0.1, "p1": 1e-3, "p2": -5e-4, "k3": 0.02}
LENSES = {
    "brown": BROWN_LENS,
    "rational": {**BROWN_LENS, "k4": 0.01, "k5": 0.02, "k6": -0.01},
    "fisheye": {"kb1": 0.03, "kb2": -0.02, "kb3": 1e-4, "kb4": 4e-4},
}
#: OpenCV 4 has a function of its own for more than five iterations.
ITERATED = getattr(cv2, "undistortPointsIter", cv2.undistortPoints)
EVERY_PIXEL = np.stack(np.meshgrid(np.arange(320.0), np.arange(180.0)), axis=-1)


def small_camera(lens, focal=225.0):
    return CameraModel(focal, 1.01 * focal, 160.5, 90.8, SMALL, LENSES[lens])


def opencvs_maps(camera, matrix):
    k, size = camera.matrix, SMALL
    if camera.is_fisheye:
        return cv2.fisheye.initUndistortRectifyMap(
            k, camera.fisheye_coefficients, np.eye(3), matrix, size, cv2.CV_32FC1
        )
    return cv2.initUndistortRectifyMap(k, camera.coefficients, np.eye(3), matrix, size, cv2.CV_32FC1)


def opencvs_points(camera, matrix):
    pixels, k = EVERY_PIXEL.reshape(-1, 1, 2), camera.matrix
    often = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 200, 1e-9)
    if camera.is_fisheye:
        points = cv2.fisheye.undistortPoints(
            pixels, k, camera.fisheye_coefficients, None, None, matrix, often
        )
    else:
        points = ITERATED(pixels, k, camera.coefficients, R=np.eye(3), P=matrix, criteria=often)
    return points.reshape(EVERY_PIXEL.shape)


@pytest.mark.parametrize(
    ("lens", "keep"), first_quick([("brown", 0.0), ("fisheye", 1.0), ("rational", 1.0), ("fisheye", 0.0)], 2)
)
def test_the_tables_are_those_of_opencv(lens, keep):
    camera = small_camera(lens)
    tables = undistort(camera, keep)
    assert (tables.rays.dtype, tables.map_px.dtype) == (np.float32, np.float32)
    seen = tables.map_px[..., 0] != -1.0
    assert seen.mean() > (0.9 if keep else 0.9999)
    theirs = np.dstack(opencvs_maps(camera, tables.camera.matrix))
    np.testing.assert_allclose(tables.map_px[seen], theirs[seen], rtol=0, atol=1e-3)
    points = opencvs_points(camera, tables.camera.matrix)
    np.testing.assert_allclose(tables.rectified_px, points, rtol=0, atol=2e-3)
    again = camera.project(tables.rays.reshape(-1, 3).astype(float)).reshape(EVERY_PIXEL.shape)
    np.testing.assert_allclose(again, EVERY_PIXEL, rtol=0, atol=1e-3)


@pytest.mark.parametrize("keep", [0.0, 0.4, 1.0])
def test_the_new_matrix_is_that_of_opencv(keep):
    camera = small_camera("brown")
    theirs, _ = cv2.getOptimalNewCameraMatrix(camera.matrix, camera.coefficients[:5], SMALL, keep)
    assert undistort(camera, keep).camera.matrix == pytest.approx(theirs, rel=1e-3)


@pytest.mark.parametrize("lens", LENSES)
def test_keep_says_which_pixels_stay(lens):
    inner, outer = (undistort(small_camera(lens), keep) for keep in (0.0, 1.0))
    last = np.array(SMALL) - 1
    assert (inner.map_px >= -1e-3).all(axis=2).mean() > 0.9999  # no empty pixel
    assert (inner.map_px <= last + 1e-3).all()
    assert (outer.rectified_px >= -1e-3).all()  # every pixel is in
    assert (outer.rectified_px <= last + 1e-3).all()


def test_the_tables_tell_how_many_blocks_of_pixels_are_done():
    reached: list[tuple[int, int]] = []
    undistort(small_camera("brown"), 0.0, lambda *done: reached.append(done))
    assert reached == [(1, 2), (2, 2)]  # rays, and places


def test_a_lens_that_folds_back_has_pixels_without_a_ray_and_no_ghosts():
    folded = CameraModel(240.0, 240.0, 160.0, 90.0, SMALL, {"k1": -0.3})
    tables = undistort(folded)
    assert 0.0 < tables.without_ray < 0.5
    assert np.isnan(tables.rectified_px[0, 0]).all()
    taken = tables.map_px[tables.map_px[..., 0] != -1.0].astype(float)
    assert np.isfinite(folded.rays(taken)).all(axis=1).mean() > 0.999


def test_a_lens_without_rays_along_a_side_is_refused():
    with pytest.raises(InputMismatch, match=r"side .* no ray"):
        undistort(CameraModel(60.0, 60.0, 160.0, 90.0, SMALL, {"k1": -0.3}))
