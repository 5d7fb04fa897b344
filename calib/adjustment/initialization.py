"""Starting values of the adjustment: noise can make any closed form fail, so all are tried and compared."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calib.adjustment.bundle import RADIAL_TERM, Bundle, Observations
from calib.adjustment.levenberg_marquardt import Refinement, refine
from calib.adjustment.loss import Loss
from calib.adjustment.parameters import AdjustmentParameters
from calib.arrays import Array
from calib.errors import DegenerateViews
from calib.model.camera import PINHOLE, CameraModel
from calib.model.closed_forms import (
    camera_matrix_from_centre,
    central_matrix,
    linear_solution,
    poses_from_homographies,
    rotations_from_centre,
    zhang_matrix,
)
from calib.model.collimator import CENTRE, Collimator
from calib.model.homography import view_homography
from calib.model.passport import Passport
from calib.model.rotation import exp_map
from calib.view import View

#: Focal lengths tried last, as shares of the diagonal of the image: from a wide-angle lens to a telephoto lens.
FOCAL_SHARES = (0.5, 1.0, 2.0, 4.0, 8.0)
#: The comparison: all starts take a few steps on this number of stars per view; the best few take more steps. Fewer
#: cost less time, and may miss the start that is best in the end.
_COMPARISON_STARS = 40
_FIRST_STEPS = 4
_FINALISTS = 3
_FINAL_STEPS = 30
#: The comparison ends when no step lowers the cost by this share; the best start is refined on all stars later.
_COMPARISON_TOLERANCE = 1e-6
#: Radial distortion of a collimator from which a start is looked for, beside none; a single lens has up to 1.4.
_DISTORTIONS = (0.0, 1.0, -1.0)
#: It is taken if it lowers the cost to this share, and if it is no more than this, twice that of a single lens.
_FITS_BETTER, _LARGEST_DISTORTION = 0.5, 3.0
#: Fewest points for a pose before a known camera, and their least spread across a line, as a share of that along it.
_LEAST_POINTS, _IN_A_LINE = 6, 1e-6


def initialized(
    views: Sequence[View], distortion: Sequence[str], passport: Passport | None, *, planar: bool = False
) -> tuple[Bundle, AdjustmentParameters]:
    """Return the ideal bundle, and its start; ``planar`` frees each view's centre, else all share one."""
    size, held = views[0].image_size, passport.names if passport else ()
    centre = [] if planar else [name for name in CENTRE if name not in held]
    bundle = Bundle(Observations.from_views(views), (*PINHOLE, *distortion, *centre), free_centres=planar)
    h = np.array([view_homography(view) for view in views])
    if passport:
        starts = passport_starts(h, size, distortion, passport)
    else:
        starts = (planar_starts if planar else spherical_starts)(h, size, distortion)
    return bundle, best_start(bundle, starts)


def spherical_starts(
    homographies: Array, image_size: tuple[int, int], distortion: Sequence[str]
) -> list[AdjustmentParameters]:
    """Return starting values of the spherical model, the most reliable first.

    They are the linear solutions with a free and with a central principal point; then Zhang's camera and a range of
    focal lengths, each with the median of its centres. Distortion starts at zero.
    Sources: arXiv:2512.16092, eq. 5, for the spherical solutions; Zhang (2000), section 3.1, for Zhang's camera.
    ``homographies`` are (n, 3, 3), from `calib.model.homography.view_homography`.
    """
    solutions = [
        linear_solution(homographies, image_size, free_principal_point=free) for free in (True, False)
    ]
    known = [solution for solution in solutions if solution is not None]
    cameras = [CameraModel.of_matrix(matrix, image_size, distortion) for matrix, _ in known]
    centres = [collimator for _, collimator in known]
    planar = planar_starts(homographies, image_size, distortion)
    medians = np.median([start.centres for start in planar], axis=1).tolist()
    centres += [Collimator(x, y, -z) for x, y, z in medians]
    return _about(homographies, centres, [*cameras, *(start.camera for start in planar)])


def planar_starts(
    homographies: Array, image_size: tuple[int, int], distortion: Sequence[str]
) -> list[AdjustmentParameters]:
    """Return starting values of the planar model, the most reliable first: Zhang's, then a range of focal lengths.

    Camera and poses: Zhang (2000), 3.1. ``homographies``: (n, 3, 3) of `calib.model.homography.view_homography`.
    """
    matrices = [zhang_matrix(homographies, image_size, free_principal_point=free) for free in (True, False)]
    diagonal = float(np.hypot(*image_size))
    matrices += [central_matrix(share * diagonal, image_size) for share in FOCAL_SHARES]
    known = np.array([matrix for matrix in matrices if matrix is not None])
    nowhere, poses = Collimator(0.0, 0.0, 0.0), poses_from_homographies(homographies, known)
    return [
        AdjustmentParameters(CameraModel.of_matrix(matrix, image_size, distortion), nowhere, *pose)
        for matrix, *pose in zip(known, *poses, strict=True)
    ]


def passport_starts(
    homographies: Array, image_size: tuple[int, int], distortion: Sequence[str], passport: Passport
) -> list[AdjustmentParameters]:
    """Return starting values for a known collimator: from its centre alone, then those of the spherical model.

    The camera follows from the known centre by arXiv:2512.16092, eq. 5, from one homography or more.
    """
    spherical = spherical_starts(homographies, image_size, distortion)
    middle = spherical[0].collimator if len(homographies) > 1 else _looked_at(homographies, image_size)
    collimator = passport.collimator(middle)
    matrix = camera_matrix_from_centre(homographies, collimator)
    cameras = [] if matrix is None else [CameraModel.of_matrix(matrix, image_size, distortion)]
    centres = [collimator] * len(cameras) + [passport.collimator(start.collimator) for start in spherical]
    return _about(homographies, centres, [*cameras, *(start.camera for start in spherical)])


def pose_start(camera: CameraModel, view: View) -> AdjustmentParameters | None:
    """Return the pose of a plane before a known camera, in closed form (Collins and Bartoli, 2014; by OpenCV).

    None if the points, of which some may have no ray, lie on a line.
    """
    import cv2

    rays = camera.rays(view.points_px)
    seen = np.isfinite(rays).all(axis=1)
    flat = np.column_stack([view.target_mm, np.zeros(len(view))])[seen]
    if len(flat) < _LEAST_POINTS:
        return None
    spread = np.linalg.svd(flat - flat.mean(axis=0), compute_uv=False)
    if not spread[1] > _IN_A_LINE * spread[0]:
        return None
    plane = np.ascontiguousarray(rays[seen, :2] / rays[seen, 2:])
    done, vector, place = cv2.solvePnP(flat, plane, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
    if not done:
        return None
    rotation = exp_map(np.asarray(vector, np.float64).reshape(1, 3))
    centre = -np.asarray(place, np.float64).reshape(1, 3) @ rotation[0]
    return AdjustmentParameters(camera, Collimator(0.0, 0.0, 0.0), rotation, centre)


def best_start(bundle: Bundle, starts: Sequence[AdjustmentParameters]) -> AdjustmentParameters:
    """Return the best starting values; `DegenerateViews` if none leads to a real camera.

    All are refined a little on a share of the stars; the best few are refined further. Own procedure.
    """
    thinned = bundle.thinned(_COMPARISON_STARS)

    first = _refined_starts(thinned, starts, _FIRST_STEPS)
    last = _refined_starts(thinned, [start.parameters for start in first[:_FINALISTS]], _FINAL_STEPS)
    if not last or not _is_camera(last[0]):
        raise DegenerateViews(
            "No camera fits these views.",
            remedy="Check that the ids belong to this target, and add views that see it at an angle.",
        )
    return last[0].parameters


def with_distorted_glass(bundle: Bundle, start: AdjustmentParameters) -> AdjustmentParameters:
    """Return a start that has the collimator's radial distortion, where that fits far better; else the same start.

    Where the glass bends the field, camera and centre would take it up, up to 8 degrees away. Own procedure.
    """
    plain = bundle.thinned(_COMPARISON_STARS)
    distorted = replace(plain, names=(*plain.names, RADIAL_TERM))
    starts = [
        replace(start, collimator=replace(start.collimator, aberrations={RADIAL_TERM: size}))
        for size in _DISTORTIONS
    ]
    best = next(iter(_refined_starts(distorted, starts, _FINAL_STEPS)), None)
    if best is None or not _is_camera(best):
        return start
    size = abs(best.parameters.collimator.aberrations[RADIAL_TERM])
    is_better = best.cost < _FITS_BETTER * plain.costs(start, Loss("l2")).sum()
    return best.parameters if is_better and size < _LARGEST_DISTORTION else start


def _refined_starts(
    bundle: Bundle, starts: Sequence[AdjustmentParameters], steps: int
) -> list[Refinement[AdjustmentParameters]]:
    """Refine all starts by some steps; return those with finite cost, real cameras first, then by cost."""
    ends = (refine(bundle, start, Loss("l2"), steps, _COMPARISON_TOLERANCE) for start in starts)
    finite = (end for end in ends if np.isfinite(end.cost))
    return sorted(finite, key=lambda start: (not _is_camera(start), start.cost))


def _is_camera(refined: Refinement[AdjustmentParameters]) -> bool:
    """Tell whether the focal lengths are positive and the radius is not negative."""
    camera = refined.parameters.camera
    return camera.fx > 0 and camera.fy > 0 and refined.parameters.collimator.r >= 0


def _about(
    homographies: Array, collimators: Sequence[Collimator], cameras: Sequence[CameraModel]
) -> list[AdjustmentParameters]:
    """Return the parameters of cameras, each with a known centre."""
    centres = np.array([collimator.centre for collimator in collimators])
    turns = rotations_from_centre(homographies, np.array([each.matrix for each in cameras]), centres)
    offsets = np.zeros((len(homographies), 3))
    return [
        AdjustmentParameters(camera, Collimator(collimator.x, collimator.y, collimator.r), rotations, offsets)
        for collimator, camera, rotations in zip(collimators, cameras, turns, strict=True)
    ]


def _looked_at(homographies: Array, image_size: tuple[int, int]) -> Collimator:
    """Return a centre above the point of the target at the middle of the first image.

    Own guess: the point H^-1 [u v 1], scaled to third coordinate 1, where (u, v) is the middle of the image.
    """
    middle = np.linalg.inv(homographies[0]) @ [(image_size[0] - 1) / 2, (image_size[1] - 1) / 2, 1.0]
    return Collimator(float(middle[0] / middle[2]), float(middle[1] / middle[2]), 1.0)
