"""Where refinements begin: every closed form tried, and the best of them chosen by a short race.

Knows how to turn closed forms into states, and that noise can defeat any one of them; so none is trusted alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from calib.adjustment.bundle import Bundle
from calib.adjustment.levenberg_marquardt import Loss, Refinement, refine
from calib.adjustment.parameters import AdjustmentParameters
from calib.errors import DegenerateViews
from calib.model.camera import CameraModel
from calib.model.collimator import Collimator
from calib.model.passport import Passport
from calib.model.planar import poses_from_homographies, zhang_matrix
from calib.model.spherical import (
    camera_matrix_from_centre,
    linear_solution,
    rotations_from_centre,
    two_view_solutions,
)

Array = NDArray[np.float64]

#: Focal lengths tried last, as shares of the image's diagonal: from a wide lens to a long one.
_FOCAL_SHARES = (0.5, 1.0, 2.0, 4.0, 8.0)
#: The race: on so many stars a view all starts take a few steps, and the best few run on.
_RACE_STARS = 40
_HEAT_STEPS = 4
_FINALISTS = 3
_FINAL_STEPS = 30
#: The winner is refined on all stars anyway; the race is decided when no step lowers the cost by this share.
_RACE_TOLERANCE = 1e-6


def spherical_starts(
    homographies: Array, image_size: tuple[int, int], distortion: Sequence[str]
) -> Iterator[AdjustmentParameters]:
    """Yield starts of the spherical model, the most trusted first; distortion zero.

    The linear solutions with the principal point free and at the image's centre; of two views, every real root;
    Zhang's camera, and a range
    of focal lengths, each with the mean of the centres it gives.
    """
    solutions = [
        linear_solution(homographies, image_size, free_principal_point=free) for free in (True, False)
    ]
    if len(homographies) == 2:
        solutions += two_view_solutions(homographies, image_size)
    for solution in solutions:
        if solution is not None:
            yield _about(homographies, solution.collimator, _camera(solution.matrix, image_size, distortion))
    for start in planar_starts(homographies, image_size, distortion):
        x, y, z = np.median(start.centres, axis=0)
        yield _about(homographies, Collimator(float(x), float(y), float(-z)), start.camera)


def planar_starts(
    homographies: Array, image_size: tuple[int, int], distortion: Sequence[str]
) -> Iterator[AdjustmentParameters]:
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
            rotations, centres = poses_from_homographies(homographies, matrix)
            yield AdjustmentParameters(
                _camera(matrix, image_size, distortion), Collimator(0.0, 0.0, 0.0), rotations, centres
            )


def passport_starts(
    homographies: Array, image_size: tuple[int, int], distortion: Sequence[str], passport: Passport
) -> Iterator[AdjustmentParameters]:
    """Yield starts with a collimator known beforehand: from its centre alone, then as without it."""
    spherical = list(spherical_starts(homographies, image_size, distortion))
    middle = spherical[0].collimator if len(homographies) > 1 else _looked_at(homographies, image_size)
    collimator = passport.collimator(middle)
    matrix = camera_matrix_from_centre(homographies, collimator)
    if matrix is not None:
        yield _about(homographies, collimator, _camera(matrix, image_size, distortion))
    for start in spherical:
        yield _about(homographies, passport.collimator(start.collimator), start.camera)


def best_start(bundle: Bundle, starts: Sequence[AdjustmentParameters]) -> AdjustmentParameters:
    """Refine every start a little on a share of the stars, the best of them further, and return the best.

    Raises
    ------
    DegenerateViews
        When no start leads anywhere.
    """
    thinned = bundle.thinned(_RACE_STARS)

    heat = _raced(thinned, starts, _HEAT_STEPS)
    final = _raced(thinned, [one.parameters for one in heat[:_FINALISTS]], _FINAL_STEPS)
    if not final or not _is_camera(final[0]):
        raise DegenerateViews(
            "No camera fits these views.",
            remedy="Check that the star ids belong to this target, and add views that see it at an angle.",
        )
    return final[0].parameters


def _raced(bundle: Bundle, starts: Sequence[AdjustmentParameters], steps: int) -> list[Refinement]:
    """Refine every start by some steps; those that are cameras come first, and of these the best."""
    ends = (refine(bundle, start, Loss("l2"), steps, _RACE_TOLERANCE) for start in starts)
    finite = (one for one in ends if np.isfinite(one.cost))
    return sorted(finite, key=lambda one: (not _is_camera(one), one.cost))


def _is_camera(refined: Refinement) -> bool:
    """Tell whether focal lengths and radius are positive."""
    camera = refined.parameters.camera
    return camera.fx > 0 and camera.fy > 0 and refined.parameters.collimator.r >= 0


def _about(homographies: Array, collimator: Collimator, camera: CameraModel) -> AdjustmentParameters:
    """Return the start of a camera about a known centre."""
    ideal = Collimator(collimator.x, collimator.y, collimator.r)
    rotations = rotations_from_centre(homographies, camera.matrix, ideal)
    return AdjustmentParameters(camera, ideal, rotations, np.zeros((len(rotations), 3)))


def _looked_at(homographies: Array, image_size: tuple[int, int]) -> Collimator:
    """Return a centre above the point of the target that the middle of the image shows."""
    middle = np.linalg.inv(homographies[0]) @ [(image_size[0] - 1) / 2, (image_size[1] - 1) / 2, 1.0]
    return Collimator(float(middle[0] / middle[2]), float(middle[1] / middle[2]), 1.0)


def _camera(matrix: Array, image_size: tuple[int, int], distortion: Sequence[str]) -> CameraModel:
    """Return the camera of a matrix, with its distortion zero."""
    fx, fy, cx, cy = (float(matrix[i, j]) for i, j in ((0, 0), (1, 1), (0, 2), (1, 2)))
    return CameraModel(fx, fy, cx, cy, image_size, dict.fromkeys(distortion, 0.0))
