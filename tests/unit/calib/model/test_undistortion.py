"""Images without distortion: the tables agree with OpenCV's, for Brown's and for fisheye lenses."""

import cv2
import numpy as np
import pytest

from calib.errors import InputMismatch
from calib.model.camera import CameraModel, straightness_px, undistort

SIZE = (320, 180)
LENSES = {
    "brown": {"k1": -0.3, "k2": 0.1, "p1": 1e-3, "p2": -5e-4, "k3": 0.02},
    "rational": {
        "k1": -0.3,
        "k2": 0.1,
        "p1": 1e-3,
        "p2": -5e-4,
        "k3": 0.02,
        "k4": 0.01,
        "k5": 0.02,
        "k6": -0.01,
    },
    "fisheye": {"kb1": 0.03, "kb2": -0.02, "kb3": 1e-4, "kb4": 4e-4},
}
#: OpenCV 4 has a function of its own for more than five iterations.
ITERATED = getattr(cv2, "undistortPointsIter", cv2.undistortPoints)
EVERY_PIXEL = np.stack(np.meshgrid(np.arange(320.0), np.arange(180.0)), axis=-1)


def camera(lens, focal=225.0):
    return CameraModel(focal, 1.01 * focal, 160.5, 90.8, SIZE, LENSES[lens])


def opencvs_maps(one, matrix):
    k, size = one.matrix, SIZE
    if one.is_fisheye:
        return cv2.fisheye.initUndistortRectifyMap(
            k, one.fisheye_coefficients, np.eye(3), matrix, size, cv2.CV_32FC1
        )
    return cv2.initUndistortRectifyMap(k, one.coefficients, np.eye(3), matrix, size, cv2.CV_32FC1)


def opencvs_points(one, matrix):
    pixels, k = EVERY_PIXEL.reshape(-1, 1, 2), one.matrix
    often = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 200, 1e-9)
    if one.is_fisheye:
        found = cv2.fisheye.undistortPoints(pixels, k, one.fisheye_coefficients, None, None, matrix, often)
    else:
        found = ITERATED(pixels, k, one.coefficients, R=np.eye(3), P=matrix, criteria=often)
    return found.reshape(EVERY_PIXEL.shape)


@pytest.mark.parametrize(
    ("lens", "keep"), [("brown", 0.0), ("rational", 1.0), ("fisheye", 0.0), ("fisheye", 1.0)]
)
def test_the_tables_are_those_of_opencv(lens, keep):
    one = camera(lens)
    found = undistort(one, keep)
    assert (found.rays.dtype, found.map_px.dtype) == (np.float32, np.float32)
    seen = found.map_px[..., 0] != -1.0
    assert seen.mean() > (0.9 if keep else 0.9999)
    theirs = np.dstack(opencvs_maps(one, found.camera.matrix))
    assert found.map_px[seen] == pytest.approx(theirs[seen], abs=1e-3)
    assert found.rectified_px == pytest.approx(opencvs_points(one, found.camera.matrix), abs=2e-3)
    again = one.project(found.rays.reshape(-1, 3).astype(float)).reshape(EVERY_PIXEL.shape)
    assert again == pytest.approx(EVERY_PIXEL, abs=1e-3)


@pytest.mark.parametrize("keep", [0.0, 0.4, 1.0])
def test_the_new_matrix_is_that_of_opencv(keep):
    one = camera("brown")
    theirs, _ = cv2.getOptimalNewCameraMatrix(one.matrix, one.coefficients[:5], SIZE, keep)
    assert undistort(one, keep).camera.matrix == pytest.approx(theirs, rel=1e-3)


@pytest.mark.parametrize("lens", LENSES)
def test_keep_says_which_pixels_stay(lens):
    inner, outer = (undistort(camera(lens), keep) for keep in (0.0, 1.0))
    last = np.array(SIZE) - 1
    assert (inner.map_px >= -1e-3).all(axis=2).mean() > 0.9999  # no empty pixel
    assert (inner.map_px <= last + 1e-3).all()
    assert (outer.rectified_px >= -1e-3).all()  # every pixel is in
    assert (outer.rectified_px <= last + 1e-3).all()


def test_a_lens_that_folds_back_has_pixels_without_a_ray_and_no_ghosts():
    folded = CameraModel(240.0, 240.0, 160.0, 90.0, SIZE, {"k1": -0.3})
    found = undistort(folded)
    assert 0.0 < found.without_ray < 0.5
    assert np.isnan(found.rectified_px[0, 0]).all()
    taken = found.map_px[found.map_px[..., 0] != -1.0].astype(float)
    assert np.isfinite(folded.rays(taken)).all(axis=1).mean() > 0.999


def test_a_lens_without_rays_along_a_side_is_refused():
    with pytest.raises(InputMismatch, match="along a side of the image have no ray"):
        undistort(CameraModel(60.0, 60.0, 160.0, 90.0, SIZE, {"k1": -0.3}))


def test_straightness_is_the_rms_distance_from_the_lines():
    x = np.arange(8.0)
    bent = np.column_stack([x, 0.25 * (-1.0) ** x])
    assert straightness_px(bent, [np.arange(8)]) == pytest.approx(0.25, rel=0.05)
    assert straightness_px(np.column_stack([x, 3 * x]), [np.arange(8), np.arange(2)]) == pytest.approx(
        0, abs=1e-9
    )
