"""The relative rotation of two cameras."""

from dataclasses import replace

import numpy as np
import pytest

from calib.engine import CalibrationOptions, calibrate
from calib.errors import DegenerateViews
from calib.model.rotation import exp_map, log_map
from calib.studies.rig import relative_rotation

TURN = exp_map(np.deg2rad([0.5, -1.0, 3.0]))


def two_cameras(bench, seed):
    rng = np.random.default_rng(seed)
    first = bench.views(rng, 0.05)
    second = [bench.view(v.name, TURN @ r, rng, 0.05) for v, r in zip(first, bench.rotations, strict=True)]
    return tuple(calibrate(views, CalibrationOptions("spherical")) for views in (first, second))


def test_the_relative_rotation_is_found_within_its_uncertainty(bench):
    runs = [relative_rotation(*two_cameras(bench, i)) for i in range(12)]
    z = np.array([log_map(run.rotation @ TURN.T) / np.sqrt(np.diag(run.covariance)) for run in runs])
    assert np.sqrt((z**2).mean()) == pytest.approx(1.0, abs=0.3)
    assert runs[0].views == ("pose-001", "pose-002", "pose-003")
    assert sum(run.rigid for run in runs) >= 11
    assert runs[0].sigma_arcsec.max() < 60


def test_a_rig_that_flexed_is_recognised(bench):
    first, second = two_cameras(bench, 3)
    bent = second.rotations.copy()
    bent[1] = exp_map(np.deg2rad([0.0, 0.0, 0.05])) @ bent[1]
    found = relative_rotation(first, replace(second, rotations=bent))
    assert not found.rigid
    assert np.linalg.norm(found.residuals_arcsec, axis=1).argmax() == 1


def test_cameras_that_share_no_pose_have_no_relative_rotation(bench):
    first, second = two_cameras(bench, 4)
    renamed = tuple(replace(view, name=f"other {view.name}") for view in second.views)
    with pytest.raises(DegenerateViews, match="share no pose"):
        relative_rotation(first, replace(second, views=renamed))
