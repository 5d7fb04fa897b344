"""Discs of simulated benches from the event images of their poses, compared with the truth."""

from dataclasses import replace

import numpy as np
import pytest

from calib.model.beam import visible_discs
from calib.stars.detect import detect_view
from calib.stars.rim import find_rim
from simulators.optics.collimator_errors import disc_of
from simulators.optics.picture import TARGET, pose_rotation
from simulators.world.truth_config import truth_from_config
from tests.support.short_recordings import images_of, record

POSES = [(pan, tilt) for pan in (-6, 0, 6) for tilt in (-2.5, 0, 2.5)]


def view_of(truth, pose, waveform, seed):
    """Return stars and rim of one recording, and the true centre of the disc."""
    rotation = pose_rotation({"pan": pose[0], "tilt": pose[1], "roll": 10.0}, truth.optics)
    image = images_of(truth, *record(truth, rotation, waveform, seed)).best().image
    view = detect_view(image, TARGET, name=f"{pose}")
    disc = disc_of(truth.collimator, rotation)
    return replace(view, rim=find_rim(image, view, TARGET)), np.array([disc.x, disc.y])


def errors_and_score(collimator, waveform):
    """Return errors of the discs' centres along the axes, mm, and the root mean square of errors over sigmas."""
    truth = truth_from_config({"collimator": collimator})
    seen = [view_of(truth, pose, waveform, 100 + i) for i, pose in enumerate(POSES)]
    discs = visible_discs([view for view, _ in seen])
    errors = np.array([disc.centre_mm - true for disc, (_, true) in zip(discs, seen, strict=True)])
    squares = [e @ np.linalg.solve(d.covariance_mm2, e) / 2 for e, d in zip(errors, discs, strict=True)]
    return errors, float(np.sqrt(np.mean(squares)))


ROUND = {"profile": "like-real", "disc_wander_mm": 0.0, "disc_breathing": 0.0, "disc_unevenness": 0.0}


@pytest.mark.slow
@pytest.mark.parametrize("waveform", ["square", "sine"])
@pytest.mark.parametrize("collimator", ["ideal", ROUND])
def test_discs_of_round_rims_are_known_to_half_a_millimetre(collimator, waveform):
    errors, score = errors_and_score(collimator, waveform)
    assert np.sqrt((errors**2).mean()) < 0.3
    assert np.abs(errors).max() < 0.5
    assert score < 1.5
