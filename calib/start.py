"""Where refinements begin: every closed form tried, and the best of them chosen by a short race.

Knows how to turn closed forms into states, and that noise can defeat any one of them; so none is trusted alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from calib.bundle import Bundle, Observations, State
from calib.camera import CameraModel
from calib.collimator import Collimator
from calib.errors import DegenerateViews
from calib.planar import poses, zhang_matrix
from calib.refine import Loss, Refined, refine
from calib.spherical import linear_start, rotations_about
from calib.view import View

Array = NDArray[np.float64]

#: Focal lengths tried last, as shares of the image's diagonal: from a wide lens to a long one.
_FOCAL_SHARES = (0.5, 1.0, 2.0, 4.0, 8.0)
_RACE_STARS = 40
_RACE_STEPS = 30
_SAME_COST = 1.01


def spherical_states(
    homographies: Array, image_size: tuple[int, int], distortion: Sequence[str]
) -> Iterator[State]:
    """Yield starts of the spherical model, the most trusted first; distortion zero.

    The linear solutions with the principal point free and at the image's centre; Zhang's camera, and a range
    of focal lengths, each with the mean of the centres it gives.
    """
    for free in (True, False):
        start = linear_start(homographies, image_size, free_principal_point=free)
        if start is not None:
            rotations = rotations_about(homographies, start.matrix, start.collimator)
            camera = _camera(start.matrix, image_size, distortion)
            yield State(camera, start.collimator, rotations, np.zeros((len(rotations), 3)))
    for state in planar_states(homographies, image_size, distortion):
        x, y, z = np.median(state.centres, axis=0)
        collimator = Collimator(float(x), float(y), float(-z))
        rotations = rotations_about(homographies, state.camera.matrix, collimator)
        yield State(state.camera, collimator, rotations, np.zeros((len(rotations), 3)))


def planar_states(
    homographies: Array, image_size: tuple[int, int], distortion: Sequence[str]
) -> Iterator[State]:
    """Yield starts of the planar model, the most trusted first: Zhang's, then a range of focal lengths."""
    matrices = [
        zhang_matrix(homographies, image_size, free_principal_point=True),
        zhang_matrix(homographies, image_size, free_principal_point=False),
    ]
    middle = ((image_size[0] - 1) / 2, (image_size[1] - 1) / 2)
    for share in _FOCAL_SHARES:
        f = share * float(np.hypot(*image_size))
        matrices.append(np.array([[f, 0.0, middle[0]], [0.0, f, middle[1]], [0.0, 0.0, 1.0]]))
    for matrix in matrices:
        if matrix is not None:
            rotations, centres = poses(homographies, matrix)
            yield State(
                _camera(matrix, image_size, distortion), Collimator(0.0, 0.0, 0.0), rotations, centres
            )


def winner(views: Sequence[View], bundle: Bundle, states: Sequence[State]) -> State:
    """Refine every start a little on a share of the stars, and return the best.

    Raises
    ------
    DegenerateViews
        When no start leads anywhere.
    """
    thinned = Bundle(
        Observations.from_views([_thin(view) for view in views]), bundle.names, bundle.free_centres
    )
    raced = [refine(thinned, state, Loss("l2"), _RACE_STEPS) for state in states]
    finished = [r for r in raced if np.isfinite(r.cost) and _is_camera(r)]
    if not finished:
        raise DegenerateViews(
            "No camera explains these views.",
            remedy="Check that the stars' ids belong to this target, and add views that look at it aslant.",
        )
    return min(finished, key=lambda r: r.cost).state


def _is_camera(refined: Refined) -> bool:
    """Tell whether focal lengths and radius are positive."""
    camera = refined.state.camera
    return camera.fx > 0 and camera.fy > 0 and refined.state.collimator.r >= 0


def _thin(view: View) -> View:
    """Keep some tens of the view's stars, evenly."""
    keep = slice(None, None, max(1, len(view) // _RACE_STARS))
    return View(
        view.name,
        view.image_size,
        view.ids[keep],
        view.points_px[keep],
        view.target_mm[keep],
        view.covariances_px2[keep],
    )


def _camera(matrix: Array, image_size: tuple[int, int], distortion: Sequence[str]) -> CameraModel:
    """Return the camera of a matrix, with its distortion zero."""
    fx, fy, cx, cy = (float(matrix[i, j]) for i, j in ((0, 0), (1, 1), (0, 2), (1, 2)))
    return CameraModel(fx, fy, cx, cy, image_size, dict.fromkeys(distortion, 0.0))
