"""Views of one pose are one cluster: repeating a pose does not make the uncertainty small."""

from dataclasses import replace

import numpy as np
import pytest

from calib.adjustment.poses import poses_of
from calib.engine import CalibrationOptions, calibrate
from calib.model.passport import Passport
from calib.model.rotation import euler_zxy
from tests.support.drawn_benches import NINE, THREE, draw_bench


def with_repeats(views, times):
    return [replace(view, name=f"{view.name} ({k})") for k in range(times) for view in views]


def test_views_turned_by_less_than_a_fifth_of_a_degree_are_one_pose():
    turns = [(0, 0), (6, 0), (0.1, 0.1), (6.15, 0), (6.5, 0), (0, 0)]
    assert poses_of(np.array([euler_zxy(pan, tilt) for pan, tilt in turns])) == (0, 1, 0, 1, 2, 0)


@pytest.mark.parametrize("options", [{}, {"passport": Passport.of_radius(255.0, 0.05)}])
def test_repeats_of_a_pose_do_not_average_out_what_differs_from_pose_to_pose(options):
    """A board that is moved by hand: noise is new in each repeat, the errors of the collimator are not."""
    again = [draw_bench("S3", NINE, 21, noise_seed=k).views for k in range(4)]
    views = [replace(view, name=f"{view.name} ({k})") for k, some in enumerate(again) for view in some]
    once, often = (calibrate(some, CalibrationOptions(**options)) for some in (again[0], views))
    assert often.poses == tuple(range(9)) * 4
    assert often.sigma["fx"] * often.coverage_factor > 0.85 * once.sigma["fx"] * once.coverage_factor


def test_new_noise_in_repeats_counts_as_far_as_it_is_new():
    again = [draw_bench("ideal", THREE, 22, star_sigma_px=0.02, noise_seed=k).views for k in range(4)]
    views = [replace(view, name=f"{view.name} ({k})") for k, some in enumerate(again) for view in some]
    once, often = (calibrate(some, CalibrationOptions()) for some in (again[0], views))
    # Independent noise: four times as many views halve the uncertainty, if nothing else limits it.
    assert 0.4 * once.sigma["fx"] < often.sigma["fx"] < 0.75 * once.sigma["fx"]
