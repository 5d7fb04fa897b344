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


@pytest.mark.parametrize("profile", ["ideal", "S1", "S3"])
@pytest.mark.parametrize(
    "options", [{"model": "radial"}, {"model": "auto", "passport": Passport.of_radius(255.0, 0.05)}]
)
def test_the_same_views_four_times_are_worth_as_much_as_once(profile, options):
    bench = draw_bench(profile, NINE, 21)
    once, often = (
        calibrate(views, CalibrationOptions(**options))
        for views in (bench.views, with_repeats(bench.views, 4))
    )
    assert often.poses == tuple(range(9)) * 4
    assert often.sigma["fx"] * often.coverage_factor == pytest.approx(
        once.sigma["fx"] * once.coverage_factor, rel=0.15
    )
    assert often.camera.fx == pytest.approx(once.camera.fx, abs=0.2 * once.sigma["fx"])


def test_new_noise_in_repeats_counts_as_far_as_it_is_new():
    bench = draw_bench("ideal", THREE, 22, star_sigma_px=0.02)
    again = [draw_bench("ideal", THREE, 22, star_sigma_px=0.02, noise_seed=k).views for k in range(4)]
    views = [replace(view, name=f"{view.name} ({k})") for k, some in enumerate(again) for view in some]
    once, often = (calibrate(some, CalibrationOptions(model="radial")) for some in (bench.views, views))
    # Independent noise: four times as many views halve the uncertainty.
    assert often.sigma["fx"] == pytest.approx(0.5 * once.sigma["fx"], rel=0.25)
