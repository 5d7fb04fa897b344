"""Few of the published views state their uncertainty correctly: stated sigmas against the scatter over random sets.

A hundred sets of three to ten of the twenty views are drawn. Without replacement, sets of n of 20 views scatter less
than sets of n of infinitely many, by the factor sqrt(1 - n / 20). The sigmas must match the scatter divided by this
factor.
"""

import numpy as np
import pytest

from calib.engine import CalibrationOptions, calibrate
from calib.errors import DegenerateViews
from tests.validation.test_collimator_real import read

FIELD = CalibrationOptions(model="field")
SETS = 100


@pytest.fixture(scope="module")
def views(collimator_recordings):
    return [read(collimator_recordings / f"image{i}.txt") for i in range(1, 21)]


def random_sets(views, size):
    """Values (sets, parameters), sigmas and coverage factors of random sets of views.

    At most a tenth of the sets may be refused, because most of their views do not show the rim of the beam.
    """
    rng = np.random.default_rng(202600 + size)
    results = []
    for _ in range(SETS):
        chosen = sorted(rng.choice(20, size, replace=False))
        try:
            results.append(calibrate([views[i] for i in chosen], FIELD))
        except DegenerateViews as error:
            if "The rim of the beam is out of view" not in error.what:
                raise
    assert len(results) >= 0.9 * SETS
    values = np.array([one.values for one in results])
    sigmas = np.array([list(one.sigma.values()) for one in results])
    return values, sigmas, np.array([one.coverage_factor for one in results])


def over_scatter(values, sigmas, size):
    """Root mean square of the stated sigmas over the scatter, for each parameter."""
    scatter = values.std(axis=0, ddof=1) / np.sqrt(1 - size / 20)
    return np.sqrt((sigmas**2).mean(axis=0)) / scatter


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_sigmas_of_three_views_are_their_scatter_for_every_parameter(views):
    values, sigmas, k = random_sets(views, 3)
    ratio = over_scatter(values, sigmas, 3)
    assert ((ratio > 1 / 1.3) & (ratio < 1.3)).all()
    covered = np.abs(values - values.mean(axis=0)) <= k[:, None] * sigmas
    assert (covered.mean(axis=0) > 0.93).all()
    assert values[:, 0].std(ddof=1) < 22
    # Half the sigmas, or twice, would not do for any parameter.
    assert (ratio / 2 < 1 / 1.3).all()
    assert (ratio * 2 > 1.3).all()


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("size", [4, 5, 7, 10])
def test_sigmas_of_more_views_are_their_scatter_as_well_as_twenty_views_can_tell(views, size):
    values, sigmas, k = random_sets(views, size)
    ratio = over_scatter(values, sigmas, size)
    assert 1 / 1.2 < np.exp(np.log(ratio).mean()) < 1.2
    assert ((ratio > 1 / 1.4) & (ratio < 1.4)).all()
    assert ((ratio > 1 / 1.3) & (ratio < 1.3)).sum() >= 14
    # Deviations grow by what drawing without replacement takes from them.
    off = np.abs(values - values.mean(axis=0)) / np.sqrt(1 - size / 20)
    assert (off <= k[:, None] * sigmas).mean() > 0.92
