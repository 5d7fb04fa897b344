"""The parallax test on event images of simulated benches: the place of the pupil, compared with the truth."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

import sequences
from calib import Collimator, detect_view
from calib.model.homography import fit_homography
from calib.stars.rim import find_rim
from calib.studies.parallax import pupil_walk
from simulators.optics.picture import TARGET, pose_rotation, star_centres
from simulators.world.truth_config import truth_from_config
from tests.support.short_recordings import images_of, record

SHIPPED = yaml.safe_load((Path(sequences.__file__).parent / "parallax_test.yaml").read_text())["poses"]
POSES = [{"pan": pose["pan_deg"], "tilt": pose["tilt_deg"], "roll": 10.0} for pose in SHIPPED["far"]]


def view_of(truth, rotation, seed):
    """Return stars and rim of one recording; the stars are identified from their true places."""
    image = images_of(truth, *record(truth, rotation, "square", seed)).best().image
    ids, points = star_centres(truth, rotation)
    expected = fit_homography(TARGET.node_of(ids).astype(float), points)
    view = detect_view(image, TARGET, name=str(seed), expected=expected)
    return replace(view, rim=find_rim(image, view, TARGET))


def measured(collimator, seed):
    """Return the walk that the shipped poses show, and the truth of the bench."""
    truth = truth_from_config({"collimator": {"profile": collimator, "glass_seed": seed}})
    rotations = np.array([pose_rotation(pose, truth.optics) for pose in POSES])
    views = [view_of(truth, rotation, 100 * seed + i) for i, rotation in enumerate(rotations)]
    c = truth.collimator
    return pupil_walk(views, rotations, Collimator(c.x, c.y, c.r)), np.array(c.disc_walk)


@pytest.mark.slow
@pytest.mark.parametrize(("collimator", "largest_sigma"), [("like-bench", 1.2), ("S2", 12.0), ("S3", 12.0)])
def test_the_pupil_is_found_within_its_uncertainty(collimator, largest_sigma):
    walk_found, walk = measured(collimator, 2)
    off = walk_found.walk_mm - walk
    assert off @ np.linalg.solve(walk_found.covariance_mm2, off) / 2 < 4.0
    assert walk_found.walk_sigma_mm.max() < largest_sigma
    assert walk_found.without_rim == ()
    in_front = -walk_found.walk_mm[0] > 4.0 * walk_found.walk_sigma_mm[0]
    assert in_front == (collimator != "S3")
