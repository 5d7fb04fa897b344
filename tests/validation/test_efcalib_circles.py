"""A grid of circles seen by a real event camera: the planar calibration agrees with OpenCV's, and halves agree.

Data of EF-Calib (MIT, Shaoan Wang, 2024): detections of a 6 x 3 grid of circles, 40 mm apart. There is no truth.
"""

import os
from pathlib import Path

import numpy as np
import pytest
from opencv_planar import RADIAL_2, by_opencv

from calib import CalibrationOptions, View, calibrate

SIZE = (346, 260)
PLANAR = CalibrationOptions(model="planar", distortion="k1k2p1p2")


@pytest.fixture(scope="module")
def views():
    shared_data = Path(__file__).resolve().parents[3] / "shared" / "data"
    folder = Path(os.environ.get("STARBENCH_REFERENCE_DATA", shared_data))
    file = folder / "efcalib_circles" / "event_camera_circles.csv"
    if not file.is_file():
        pytest.skip("the detections of EF-Calib are not here; STARBENCH_REFERENCE_DATA names their folder")
    table = np.genfromtxt(file, delimiter=",", skip_header=1)
    made = []
    for number in np.unique(table[:, 1])[::22]:
        own = table[table[:, 1] == number]
        ids = (6 * own[:, 5] + own[:, 4]).astype(np.int64)
        unit = np.tile(np.eye(2), (len(own), 1, 1))
        made.append(View(f"view {number:.0f}", SIZE, ids, own[:, 2:4], 40.0 * own[:, 4:6], unit))
    return made


def test_the_planar_calibration_is_that_of_opencv(views):
    rms, matrix, _, sigma = by_opencv(views, RADIAL_2)
    ours = calibrate(views, PLANAR)
    assert len(views) == 61
    assert ours.rms_px == pytest.approx(rms, rel=0.03)
    assert abs(ours.camera.fx - matrix[0, 0]) < 0.5 * sigma[0]
    assert abs(ours.camera.cx - matrix[0, 2]) < 0.5 * sigma[2]
    assert ours.sigma["fx"] == pytest.approx(sigma[0], rel=0.25)


def test_halves_agree_within_their_uncertainty(views):
    first, other = calibrate(views[::2], PLANAR), calibrate(views[1::2], PLANAR)
    for name in ("fx", "fy", "cx", "cy", "k1"):
        apart = first.camera.to_dict()[name] - other.camera.to_dict()[name]
        assert abs(apart) < 2.5 * np.hypot(first.sigma[name], other.sigma[name])


def test_a_view_left_out_is_predicted_as_well_as_the_others_are_fitted(views):
    # A board stands elsewhere in each view, so a view that is left out has a pose of its own.
    left_out = calibrate(views[:12], CalibrationOptions(model="planar", distortion="k1k2p1p2", loss="l2"))
    predicted = left_out.left_out_rms_px
    if predicted is None:
        from calib.fit import fit_model

        predicted = fit_model(views[:12], PLANAR, "planar", leave_out=True).left_out_rms_px
    assert left_out.rms_px < predicted < 1.5 * left_out.rms_px
