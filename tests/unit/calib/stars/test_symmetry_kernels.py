"""Normal equations of symmetry: the loop for samples inside of the image, and the one that tests each sample."""

import numpy as np
import pytest

from calib.stars.centring import symmetry_samples
from calib.stars.symmetry_kernels import SYMMETRY_UNKNOWNS, _sums_anywhere, _sums_inside, normal_equations

random = np.random.default_rng(5)
IMAGE = random.normal(100.0, 30.0, (60, 70)).astype(np.float32)
LINEAR = np.array([[17.0, -9.0], [8.0, 18.0]])
QUADRATIC = 0.05 * random.normal(size=(2, 3))
SAMPLES = np.ascontiguousarray(symmetry_samples(20.0).T)
SLOPES = np.array([0.02, -0.03, 0.4, 0.1])


def equations(function, centre, *, rows):
    normal, right = np.empty((SYMMETRY_UNKNOWNS, SYMMETRY_UNKNOWNS)), np.empty(SYMMETRY_UNKNOWNS)
    space = (np.empty((SYMMETRY_UNKNOWNS + 1, SAMPLES.shape[1])),) if rows else ()
    samples = (SAMPLES,) if rows else tuple(SAMPLES)
    image = (IMAGE.ravel(), IMAGE.shape[1])
    squares = function(*image, *centre, LINEAR, QUADRATIC, *samples, SLOPES, *space, normal, right)
    return squares, normal, right


def test_both_loops_give_the_same_equations():
    squares, normal, right = equations(_sums_inside, (35.3, 29.7), rows=False)
    mean_square, slow_normal, slow_right = equations(_sums_anywhere, (35.3, 29.7), rows=True)
    assert squares / SAMPLES.shape[1] == pytest.approx(mean_square, rel=1e-12)
    np.testing.assert_allclose(normal, slow_normal, rtol=1e-11, atol=1e-9)
    np.testing.assert_allclose(right, slow_right, rtol=1e-11, atol=1e-9)
    np.testing.assert_array_equal(normal, normal.T)


@pytest.mark.parametrize("centre", [(35.0, 29.0), (14.0, 29.0), (35.0, 46.0), (2.0, 2.0), (-40.0, 29.0)])
def test_samples_outside_are_not_read(centre):
    """The quick loop does not test its samples, so it may only get stars that lie in the image."""
    normal, right = np.empty((SYMMETRY_UNKNOWNS, SYMMETRY_UNKNOWNS)), np.empty(SYMMETRY_UNKNOWNS)
    rows = np.empty((SYMMETRY_UNKNOWNS + 1, SAMPLES.shape[1]))
    found = normal_equations(
        IMAGE.ravel(), 70, np.array(centre), LINEAR, QUADRATIC, SAMPLES, SLOPES, rows, normal, right
    )
    expected, slow, _ = equations(_sums_anywhere, centre, rows=True)
    np.testing.assert_allclose(found, expected, rtol=1e-11)
    if np.isfinite(expected):
        np.testing.assert_allclose(normal, slow, rtol=1e-11, atol=1e-9)
    else:
        assert centre[0] < 10
