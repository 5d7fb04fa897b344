"""Our rigs and those of OpenCV 5 (`calibrateMultiview`) from the same points agree, and with the truth."""

import cv2
import numpy as np
import pytest
from drawn_rig import BOARD, Drawn

from calib.model.camera import CameraModel
from calib.model.rotation import log_map
from calib.studies.rig import stated_cameras
from calib.studies.rig_boards import with_boards

pytestmark = pytest.mark.skipif(
    not hasattr(cv2, "calibrateMultiview"), reason="OpenCV has calibrateMultiview from version 5 on"
)
LENS = cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST


def by_opencv(drawn, cameras=None):
    """Cameras, rotation, translation in mm and rms in px; the cameras are held if they are given."""
    count = len(drawn.views[0])
    # In mm it says that the points were collinear.
    board = np.column_stack([BOARD / 1000.0, np.zeros(len(BOARD))]).astype(np.float32)
    images = [[view.points_px.astype(np.float32) for view in views] for views in drawn.views]
    sizes = [camera.image_size for camera in drawn.cameras]
    held = cv2.CALIB_USE_INTRINSIC_GUESS if cameras else 0
    rms, matrices, lenses, turns, places = cv2.calibrateMultiview(
        [board] * count, images, sizes, np.ones((2, count), np.uint8), np.zeros(2, np.uint8),
        [camera.matrix for camera in cameras or ()] or None,
        [camera.coefficients[None, :5].copy() for camera in cameras or ()] or None,
        None, None, flagsForIntrinsics=np.full((2, 1), held | LENS, np.int32), flags=held,
        criteria=(cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 300, 1e-14),
    )  # fmt: skip
    calibrated = [
        CameraModel(
            k[0, 0], k[1, 1], k[0, 2], k[1, 2], size, dict(zip(("k1", "k2"), lens.ravel(), strict=False))
        )
        for k, lens, size in zip(matrices, lenses, sizes, strict=True)
    ]
    return calibrated, cv2.Rodrigues(turns[1])[0], 1000.0 * places[1].ravel(), rms


def rms_px(rig):
    return float(np.sqrt((rig.boards_rms_px**2).mean()))


def test_with_the_same_intrinsics_it_is_the_same_rig():
    drawn = Drawn(0, boards=14)
    _, rotation, translation, rms = by_opencv(drawn, drawn.cameras)
    rig = with_boards(stated_cameras(*drawn.cameras), *drawn.views)
    assert 206265 * np.abs(log_map(rig.rotation @ rotation.T)).max() < 0.2  # arc seconds, of 3 of U
    assert rig.translation_mm == pytest.approx(translation, abs=5e-4)
    assert rms_px(rig) == pytest.approx(rms, abs=1e-4)


def test_adjusted_with_the_rig_the_intrinsics_fit_better_and_the_rig_is_nearer_the_truth():
    ours, theirs = [], []
    for seed in range(2):
        drawn = Drawn(seed, boards=14)
        cameras, rotation, translation, rms = by_opencv(drawn)
        rig = with_boards(stated_cameras(*drawn.stated), *drawn.views, free=True)
        assert rms_px(rig) < rms  # it calibrates each camera alone, and then holds it
        same = with_boards(stated_cameras(*cameras), *drawn.views)
        assert same.translation_mm == pytest.approx(translation, abs=5e-3)
        assert 206265 * np.abs(log_map(same.rotation @ rotation.T)).max() < 2.0
        ours.append(np.linalg.norm(rig.translation_mm - drawn.translation))
        theirs.append(np.linalg.norm(translation - drawn.translation))
    assert np.mean(ours) < 0.5 * np.mean(theirs), (ours, theirs)
