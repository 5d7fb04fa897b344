"""Views that do not constrain a camera are refused, and the reason named."""

import numpy as np
import pytest

from calib.engine import CalibrationOptions, calibrate
from calib.errors import DegenerateViews


@pytest.mark.parametrize("noise_px", [0.0, 0.05])
@pytest.mark.parametrize(
    ("poses", "reason"),
    [
        ((), "0 views"),
        (((0, 0),), "1 view given; at least 2"),
        (((1, 1), (1, 1)), "All 2 views show the same pose"),
        (((1, 1), (1, 1.1), (1.1, 1)), "All 3 views show the same pose"),
        (((0, 0, 0), (0, 0, 30)), "roll about the optical axis"),
        (((0, 0, 0), (0, 0, 30), (0, 0, -50)), "roll about the optical axis"),
    ],
)
def test_views_that_do_not_constrain_are_named(bench, poses, reason, noise_px):
    views = bench.views(np.random.default_rng(31), noise_px, poses=poses)
    with pytest.raises(DegenerateViews, match=reason):
        calibrate(views)


def test_a_beam_too_narrow_is_named(make_bench):
    bench = make_bench(
        centre=(60.0, 60.0, -255.0), half_angle_deg=1.9, poses=((0, 0), (1, 0.5, 20), (-0.5, 1))
    )
    with pytest.raises(DegenerateViews, match="beam is too narrow"):
        calibrate(bench.views(np.random.default_rng(32), 0.2))


def test_square_on_views_are_not_enough_for_the_planar_model(bench):
    views = bench.views(np.random.default_rng(33), 0.05, poses=((0, 0), (0, 0, 40)))
    with pytest.raises(DegenerateViews, match="roll about the optical axis"):
        calibrate(views, CalibrationOptions(model="planar"))


def test_a_turntable_is_enough(bench):
    views = bench.views(np.random.default_rng(34), 0.05, poses=((-4, 1), (0, 1), (4, 1)))
    result = calibrate(views)
    assert result.camera.fx == pytest.approx(bench.fx, abs=4 * result.sigma["fx"])
    assert result.sigma["fx"] < 12
