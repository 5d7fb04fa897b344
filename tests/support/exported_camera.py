"""A calibration with each kind of lens, for those who read its exports."""

import cv2
import numpy as np

from calib import CameraModel, Collimator
from calib.calibration import Calibration, ViewSummary

RADIAL = {"k1": 0.06, "k2": -0.9}
BROWN = {**RADIAL, "p1": 1e-5, "p2": -0.0002}
LENSES = {
    "none": {},
    "k1k2": RADIAL,
    "k1k2p1p2": BROWN,
    "k1k2k3p1p2": {**BROWN, "k3": 0.3},
    "rational": {**BROWN, "k3": 0.3, "k4": 0.01, "k5": 0.02, "k6": -0.1},
}
FISHEYES = {
    "fisheye": {"kb1": 0.03, "kb2": -0.02, "kb3": 1e-5, "kb4": 0.004},
    "fisheye, kb1 and kb2": {"kb1": 0.03, "kb2": -0.02},
}


def calibration(lens):
    distortion = {**LENSES, **FISHEYES}[lens]
    camera = CameraModel(3345.06, 3345.27, 642.1, 363.32, (1280, 720), distortion)
    rotations = np.stack([cv2.Rodrigues(np.array(v))[0] for v in ([0.0, 0.1, 0.0], [0.05, 0.0, -0.2])])
    names = (*camera.parameter_names, "x", "y", "r")
    place = [96.0, 144.0, 255.0]
    views = (ViewSummary("left", 300, 0.08, 0.07), ViewSummary("right", 310, 0.082, 0.07))
    fit = {"rms_px": 0.081, "mean_px": 0.07, "variance_factor": 1.0, "degrees_of_freedom": 100}
    return Calibration(
        model="spherical",
        camera=camera,
        collimator=Collimator(*place),
        rotations=rotations,
        centres=np.array([[96.0, 144.0, -255.0]] * 2),
        parameter_names=names,
        estimates=np.array([*camera.values, *place]),
        covariance=np.diag(np.arange(1.0, len(names) + 1)),
        residuals_px=[], weights=[], views=views, converged=True, iterations=5, **fit,
    )  # fmt: skip
