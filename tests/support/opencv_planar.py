"""The planar calibration of OpenCV, from the same points."""

import cv2
import numpy as np

STOP = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 500, 1e-16)
#: Flags of coefficients that are held at zero.
RADIAL_2, NO_TANGENTIAL = cv2.CALIB_FIX_K3, cv2.CALIB_ZERO_TANGENT_DIST


def by_opencv(views, flags):
    """Return rms, camera matrix, coefficients and 1-sigma of fx, fy, cx, cy and the coefficients."""
    objects = [np.column_stack([v.target_mm, np.zeros(len(v))]).astype(np.float32)[:, None] for v in views]
    images = [v.points_px.astype(np.float32)[:, None] for v in views]
    rms, matrix, bent, _, _, sigma, _, _ = cv2.calibrateCameraExtended(
        objects, images, views[0].image_size, None, None, flags=flags, criteria=STOP
    )
    return rms, matrix, bent.ravel(), sigma.ravel()
