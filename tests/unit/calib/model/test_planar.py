"""Zhang's closed form."""

import numpy as np
import pytest

from calib.model.closed_forms import poses_from_homographies, zhang_matrix
from calib.model.homography import view_homography

SIZE = (1280, 720)


@pytest.fixture
def ideal(make_bench):
    bench = make_bench(k=(0.0, 0.0), cx=639.5, cy=359.5, poses=((-20, 5), (15, -12), (3, 21, 40)))
    return bench, np.array([view_homography(view) for view in bench.views()])


@pytest.mark.parametrize("free", [True, False])
def test_ideal_views_give_the_exact_camera(ideal, free):
    bench, h = ideal
    matrix = zhang_matrix(h, SIZE, free_principal_point=free)
    assert np.allclose(matrix, [[bench.fx, 0, bench.cx], [0, bench.fy, bench.cy], [0, 0, 1]], rtol=1e-6)


def test_poses_follow_from_the_camera(ideal):
    bench, h = ideal
    matrix = np.array([[bench.fx, 0, bench.cx], [0, bench.fy, bench.cy], [0, 0, 1]])
    turns, centres = poses_from_homographies(h, matrix)
    assert np.allclose(centres, bench.centre, atol=1e-5)
    assert np.allclose(turns @ turns.transpose(0, 2, 1), np.eye(3))


def test_frontal_views_give_no_camera(make_bench):
    # Three views square to the target say nothing about the focal length without the shared centre.
    flat = np.array([[10.0, 0, 600], [0, 10.0, 300], [0, 0, 1.0]])
    assert zhang_matrix(np.stack([flat, flat, flat]), SIZE, free_principal_point=True) is None
