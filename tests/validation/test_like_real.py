"""The collimator "like-real" against the recordings it is to resemble: the statistics of their residuals, side by side.

The figures, and how views are simulated, stand in ``tests/support/like_real.py``, which prints them as a table. What the
joint adjustment leaves is not compared: it follows the simulated errors more closely than the real ones.
"""

import like_real
import pytest

GLASSES = range(1, 5)

#: Least and most of each figure, as a share of that of the recordings; through the recordings' own discs.
BANDS = {
    "spherical_rms": (0.92, 1.1),
    "planar_rms": (0.92, 1.15),
    "spherical_left_out": (0.92, 1.12),
    "planar_left_out": (0.87, 1.1),
    "spherical_outer_tenth": (0.95, 1.1),
    "planar_outer_tenth": (0.85, 1.05),
    "drift_x": (0.85, 1.25),
    "drift_y": (0.88, 1.12),
    "drift_z": (0.85, 1.1),
    "disc_x": (0.85, 1.04),
    "disc_y": (0.9, 1.15),
    "stars": (0.96, 1.04),
    "beyond": (0.8, 1.3),
    "planar_focal_gap": (0.8, 1.25),
}


@pytest.fixture(scope="module")
def recorded(collimator_recordings):
    return like_real.recordings(collimator_recordings)


@pytest.fixture(scope="module")
def real(recorded):
    return like_real.figures(recorded.views)


@pytest.fixture(scope="module")
def drawn(recorded):
    return like_real.mean_and_scatter(
        [like_real.figures(like_real.simulated(recorded, glass)) for glass in GLASSES]
    )[0]


@pytest.mark.slow
@pytest.mark.parametrize("name", BANDS)
def test_residuals_are_those_of_the_recordings(real, drawn, name):
    least, most = BANDS[name]
    assert least < drawn[name] / real[name] < most


@pytest.mark.slow
def test_the_spherical_model_makes_the_focal_length_long_as_on_the_recordings(real, drawn):
    assert real["spherical_focal_gap"] > 0.2
    assert drawn["spherical_focal_gap"] > 0.0


@pytest.mark.slow
def test_glass_that_errs_nowhere_leaves_none_of_it(recorded, real):
    """The statistics tell a perfect collimator from a real one: they are not those of the recordings' discs."""
    ideal = like_real.figures(like_real.simulated(recorded, 1, profile=like_real.IDEAL))
    assert ideal["spherical_rms"] < 0.05 * real["spherical_rms"]
    assert ideal["drift_x"] < 0.05 * real["drift_x"]
