"""The closed forms of the spherical model."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calib.model.closed_forms import (
    camera_matrix_from_centre,
    linear_solution,
    rotations_from_centre,
)
from calib.model.collimator import Collimator
from calib.model.homography import view_homography

SIZE = (1280, 720)


def homographies(views):
    return np.array([view_homography(view) for view in views])


def test_three_ideal_views_give_the_exact_camera_and_centre(make_bench):
    bench = make_bench(k=(0.0, 0.0))
    start = linear_solution(homographies(bench.views()), SIZE, free_principal_point=True)
    expected = [[bench.fx, 0, bench.cx], [0, bench.fy, bench.cy], [0, 0, 1]]
    assert np.allclose(start.matrix, expected, rtol=1e-5)
    assert start.collimator.values == pytest.approx([97.0, 140.1, 255.0], rel=1e-5)


def test_two_ideal_views_do_when_the_principal_point_is_the_images_centre(make_bench):
    bench = make_bench(k=(0.0, 0.0), cx=639.5, cy=359.5)
    start = linear_solution(
        homographies(bench.views(poses=bench.poses[:2])), SIZE, free_principal_point=False
    )
    assert np.diag(start.matrix) == pytest.approx([bench.fx, bench.fy, 1.0], rel=1e-6)
    assert start.collimator.values == pytest.approx([97.0, 140.1, 255.0], rel=1e-6)


def test_a_known_centre_gives_the_camera_from_one_view(make_bench):
    bench = make_bench(k=(0.0, 0.0))
    h = homographies(bench.views()[:1])
    matrix = camera_matrix_from_centre(h, Collimator(97.0, 140.1, 255.0))
    assert np.allclose(matrix, [[bench.fx, 0, bench.cx], [0, bench.fy, bench.cy], [0, 0, 1]], rtol=1e-6)


def test_too_few_views_give_no_start(bench):
    h = homographies(bench.views())
    assert linear_solution(h[:1], SIZE, free_principal_point=False) is None
    assert linear_solution(h[:2], SIZE, free_principal_point=True) is None


def test_rotations_follow_from_camera_and_centre(make_bench):
    bench = make_bench(k=(0.0, 0.0))
    h = homographies(bench.views())
    start = linear_solution(h, SIZE, free_principal_point=True)
    turns = rotations_from_centre(h, start.matrix, start.collimator.centre)
    assert np.allclose(turns, bench.rotations, atol=1e-5)


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**31), noise=st.floats(1e-6, 1.0), n=st.integers(2, 6), free=st.booleans())
def test_any_homographies_give_a_real_camera_or_none(seed, noise, n, free):
    rng = np.random.default_rng(seed)
    h = np.array([[10.0, 0, 600], [0, 10.0, 300], [0, 0, 1.0]]) * (1 + noise * rng.standard_normal((n, 3, 3)))
    h = h / np.cbrt(np.linalg.det(h))[:, None, None]
    start = linear_solution(h, SIZE, free_principal_point=free)
    if start is not None:
        numbers = np.append(start.matrix, start.collimator.values)
        assert np.isrealobj(numbers)
        assert np.isfinite(numbers).all()
        assert start.matrix[0, 0] > 0
        assert start.matrix[1, 1] > 0
        assert start.collimator.r > 0
