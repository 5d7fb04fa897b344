"""Normal equations of symmetry, compared with SciPy's cubic B-spline and matrix products."""

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from calib.stars.centring import symmetry_samples
from calib.stars.grid_map import LocalMap
from calib.stars.symmetry_loops import normal_equations

random = np.random.default_rng(5)
IMAGE = random.normal(100.0, 30.0, (60, 70)).astype(np.float32)
LINEAR = np.array([[17.0, -9.0], [8.0, 18.0]])
QUADRATIC = 0.05 * random.normal(size=(2, 3))
SAMPLES = np.ascontiguousarray(symmetry_samples(20.0).T).astype(np.float32)
SLOPES = np.array([0.02, -0.03, 0.4, 0.1])


def equations(centre, used_to=0.5):
    """Return the mean square, J^T J and J^T r of the loop."""
    star = np.array([centre]), LocalMap(LINEAR[None], QUADRATIC[None])
    normal, right, square = normal_equations(IMAGE, *star, SAMPLES, np.full((1, 2), used_to), SLOPES[None])
    return square[0], normal[0], right[0]


def spline(x, y):
    """Return value and derivatives; those by differences of a piecewise cubic are right to the square of the step."""
    image, step = IMAGE.astype(float), 1e-5

    def at(x, y):
        return map_coordinates(image, [y, x], order=3, prefilter=False)

    along = [(at(x + dx, y + dy) - at(x - dx, y - dy)) / (2 * step) for dx, dy in ((step, 0), (0, step))]
    return at(x, y), *along


def expected_equations(centre, used_to=0.5):
    """Return the mean square, J^T J and J^T r by the equations at the head of `calib.stars.centring`."""
    used = np.abs(SAMPLES).max(axis=0) <= used_to
    u, v = SAMPLES[:, used].astype(float)
    a = LINEAR @ [u, v]
    middle = np.array(centre)[:, None] + QUADRATIC @ [u * u, u * v, v * v]
    last = np.array(IMAGE.shape[::-1])[:, None] - 2
    inside = np.all([(p >= 1) & (p < last) for p in (middle + a, middle - a)], axis=(0, 1))
    if inside.mean() < 0.8:
        return None
    u, v, a, middle = u[inside], v[inside], a[:, inside], middle[:, inside]
    (there, there_x, there_y), (here, here_x, here_y) = spline(*(middle + a)), spline(*(middle - a))
    both = there + here
    j = np.array([there_x - here_x, there_y - here_y, -u * both, -v * both, -u, -v])
    r = there - here + SLOPES @ j[2:]
    return (r**2).mean(), j @ j.T, j @ r


@pytest.mark.parametrize(
    "centre", [(35.3, 29.7), (35.0, 29.0), (12.2, 29.4), (57.4, 29.4), (35.1, 46.3), (35.1, 13.0)]
)
@pytest.mark.parametrize("used_to", [0.5, 0.3])
def test_equations_are_those_of_scipy(centre, used_to):
    square, normal, right = equations(centre, used_to)
    expected_square, expected_normal, expected_right = expected_equations(centre, used_to)
    assert square == pytest.approx(expected_square, rel=1e-4)
    size = np.sqrt(np.diag(expected_normal))
    sizes = np.outer(size, size)
    np.testing.assert_allclose(normal / sizes, expected_normal / sizes, atol=2e-5)
    scale = size * np.sqrt(expected_square * SAMPLES.shape[1])
    np.testing.assert_allclose(right / scale, expected_right / scale, atol=2e-5)
    np.testing.assert_array_equal(normal, normal.T)


@pytest.mark.parametrize("centre", [(2.0, 2.0), (-40.0, 29.0), (1e6, 29.0), (np.nan, 29.0)])
def test_a_star_that_lies_outside_is_refused(centre):
    """The loop does not test its samples, so it may only get those that lie in the image."""
    assert np.isnan(equations(centre)[0])
