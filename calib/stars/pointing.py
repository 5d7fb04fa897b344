"""Prediction of the grid of stars from a reading of the gimbal, by earlier views whose stars the tag labelled.

The prediction serves to label stars if the tag is out of view: no estimate of a camera depends on it. The module uses
homographies and readings, no image and no stars. The grid is at

    H = K [r1 r2 -R c] diag(p, p, 1),   R = A G B,

the homography of arXiv:2512.16092, eqs. 1 to 3, for the pitch p. K has one focal length and the principal point at the
image centre. A is the mounting of the camera on the gimbal, G the gimbal's rotation, and B the rotation from the
collimator to the gimbal's base; A and B are unknown as in robot-world and hand-eye calibration (Dornaika and Horaud
1998). Focal length, centre c, A and B are fitted to the earlier views. The covariance of the fit gives the uncertainty
of the prediction. It is large after a single view, if an axis has not moved yet, or if the readings contradict the
views; then the prediction is refused.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from calib.arrays import Array
from calib.errors import DegenerateViews
from calib.model.closed_forms import central_matrix, poses_from_homographies
from calib.model.homography import apply_homography
from calib.model.rotation import euler_zxy, exp_map, log_map

#: Standard deviation of what the model neglects (lens, gimbal, homographies) at an image point, px. It is enlarged if
#: the earlier views disagree more. Points of a view share most of this error, so a view counts as a few points only.
MODEL_SIGMA_PX, POINTS_PER_VIEW = 1.0, 4
#: Prior standard deviation of the camera's rotation on the gimbal about each axis, degrees: a camera is mounted by eye.
MOUNTING_SIGMA_DEG = 5.0
#: Largest standard uncertainty of a prediction, pitches. The next labelling is a pitch away.
MAX_SIGMA_PITCHES = 0.15
#: Focal lengths at which the fit starts, widths of the image: each is 1.7 times the one before, from wide to long
#: lenses.
FIRST_FOCAL_LENGTHS = (0.6, 1.0, 1.7, 2.9, 5.0)
#: Number of points along each side of the inner part of the image, and the size of that part as a share of the image:
#: the distortion that the model neglects is largest at the border.
SIDE, INNER = 5, 0.8
_LOG_F, _CENTRE, _LOG_R, _MOUNTING, _BASE = 0, slice(1, 3), 3, slice(4, 7), slice(7, 10)
_UNKNOWNS = _BASE.stop
_REMEDY = "Begin with poses that have the tag in view, in two directions or more along each axis that moves."


def grid_homography(matrix: Array, rotation: Array, centre_mm: Array, pitch_mm: float) -> Array:
    """Return where a collimator's grid is in a camera's image, (3, 3) from [column row 1] to [u v 1] px.

    H = K [r1 r2 -R c] diag(p, p, 1), by arXiv:2512.16092, eqs. 1 to 3, with pitch p, mm, rotation R, camera <- target,
    and centre c = (x, y, -r) of the spherical motion, mm. Distortion, a few pixels at most, is neglected.
    """
    columns = np.column_stack([rotation[:, 0], rotation[:, 1], -rotation @ centre_mm])
    return np.asarray(matrix @ columns @ np.diag([pitch_mm, pitch_mm, 1.0]), np.float64)


class LabelledView(NamedTuple):
    """An earlier view whose stars the tag labelled."""

    grid: Array  # (3, 3) float64, homography from [column row 1] of the target's grid to [u v 1] px
    # Angles of the gimbal at that view, degrees: ``pan``, ``tilt``, ``roll``; a missing axis is at 0.
    reading_deg: Mapping[str, float]


class PredictedGrid(NamedTuple):
    """Predicted grid of stars in the image."""

    grid: Array  # (3, 3) float64, homography from [column row 1] of the target's grid to [u v 1] px
    sigma_pitches: float  # Standard uncertainty of its points, pitches, the largest over the image


class _Observations(NamedTuple):
    """Earlier views: gimbal rotations, and the (25, 2) grid positions that each view shows at the image points."""

    image_size: tuple[int, int]
    pitch_mm: float
    points: Array
    turns: Sequence[Array]
    nodes: Sequence[Array]

    def grid(self, values: Array, turn: Array) -> Array:
        """Return H of the head of the module, (3, 3), for values of the unknowns (arXiv:2512.16092, eqs. 1 to 3)."""
        rotation = exp_map(values[_MOUNTING]) @ turn @ exp_map(values[_BASE])
        centre = np.array([*values[_CENTRE], -np.exp(values[_LOG_R])])
        matrix = central_matrix(float(np.exp(values[_LOG_F])), self.image_size)
        return grid_homography(matrix, rotation, centre, self.pitch_mm)

    def residuals(self, values: Array) -> Array:
        """Return the weighted residuals of all points of all views, and of the prior of the mounting.

        Own weights: a view counts as `POINTS_PER_VIEW` points of standard deviation `MODEL_SIGMA_PX`.
        """
        sigma_px = MODEL_SIGMA_PX * np.sqrt(len(self.points) / POINTS_PER_VIEW)
        views = [
            (apply_homography(self.grid(values, turn), nodes) - self.points).ravel() / sigma_px
            for turn, nodes in zip(self.turns, self.nodes, strict=True)
        ]
        return np.concatenate([*views, values[_MOUNTING] / np.radians(MOUNTING_SIGMA_DEG)])


def predict_grid(
    seen: Sequence[LabelledView],
    reading_deg: Mapping[str, float],
    image_size: tuple[int, int],
    pitch_mm: float,
) -> PredictedGrid:
    """Predict the grid of stars from a reading of the gimbal, degrees, where a missing axis is at 0.

    Robot-world and hand-eye calibration: Dornaika and Horaud (1998). The parametrisation is this project's own; the
    head of the module gives the equations. The earlier views look in at least two directions.
    Raises DegenerateViews: Without earlier views, or if the uncertainty is larger than `MAX_SIGMA_PITCHES`.
    """
    if not seen:
        raise DegenerateViews(
            "No earlier view shows the tag, so the stars cannot be predicted.", where="gimbal", remedy=_REMEDY
        )
    steps = np.linspace(-0.5, 0.5, SIDE) * INNER + 0.5
    places = np.meshgrid(*(steps * (side - 1) for side in image_size))
    points = np.stack(places, axis=-1).reshape(-1, 2)
    nodes = [apply_homography(np.asarray(np.linalg.inv(s.grid)), points) for s in seen]
    turns = [_gimbal_rotation(s.reading_deg) for s in seen]
    observed = _Observations(image_size, pitch_mm, points, turns, nodes)
    starts = [_first_values(seen[0].grid, observed, ratio * image_size[0]) for ratio in FIRST_FOCAL_LENGTHS]
    prediction = _predicted(observed, starts, _gimbal_rotation(reading_deg))
    if not prediction.sigma_pitches <= MAX_SIGMA_PITCHES:
        raise DegenerateViews(
            f"Earlier views with the tag, {len(seen)} so far, do not tell yet which star is where at this reading.",
            where="gimbal",
            remedy=_REMEDY,
        )
    return prediction


def _gimbal_rotation(reading_deg: Mapping[str, float]) -> Array:
    """Return the (3, 3) rotation G of the gimbal."""
    return euler_zxy(*(reading_deg.get(axis, 0.0) for axis in ("pan", "tilt", "roll")))


def _first_values(grid: Array, observed: _Observations, focal_px: float) -> Array:
    """Return start values of the unknowns from the grid of the first view and a focal length.

    Zhang (2000), section 3.1, with the centre c of arXiv:2512.16092, eq. 3: K^-1 H is proportional to [r1 r2 -R c].
    """
    per_mm = np.diag([1.0 / observed.pitch_mm, 1.0 / observed.pitch_mm, 1.0])
    grid, middle_mm = grid @ per_mm, observed.nodes[0][len(observed.points) // 2] * observed.pitch_mm
    in_front = np.sign(grid[2] @ np.append(middle_mm, 1.0))
    poses = poses_from_homographies(in_front * grid[None], central_matrix(focal_px, observed.image_size))
    rotation, centre = poses[0][0], poses[1][0]
    values = np.zeros(_UNKNOWNS)
    values[_LOG_F] = np.log(focal_px)
    values[_CENTRE] = centre[:2]
    values[_LOG_R] = np.log(max(-centre[2], 1.0))
    values[_BASE] = log_map(observed.turns[0].T @ rotation)
    return values


def _predicted(observed: _Observations, starts: Sequence[Array], turn: Array) -> PredictedGrid:
    """Return the grid at a rotation of the gimbal, with the uncertainty by the fit (JCGM 100:2008, section 5.2).

    The least sum of squares by steps within a trusted region (Branch, Coleman and Li, 1999), of all starts. Its
    covariance is the inverse of J^T J, times the mean square of the residuals if it exceeds 1 (Birge, 1932).
    """
    from scipy.optimize import least_squares

    fits = (least_squares(observed.residuals, start, x_scale="jac") for start in starts)
    fit = min(fits, key=lambda candidate: float(candidate.cost))
    redundancy = max(2 * POINTS_PER_VIEW * len(observed.nodes) - _UNKNOWNS, 1)
    factor = max(2.0 * float(fit.cost) / redundancy, 1.0)
    values, slopes = np.asarray(fit.x), np.asarray(fit.jac)
    covariance = factor * np.linalg.pinv(slopes.T @ slopes, hermitian=True)
    grid = observed.grid(values, turn)
    nodes = apply_homography(np.asarray(np.linalg.inv(grid)), observed.points)
    # By forward differences (Abramowitz and Stegun, 1972, section 25.3).
    ends = [observed.grid(values + step, turn) for step in 1e-6 * np.eye(_UNKNOWNS)]
    moved = [apply_homography(end, nodes) - apply_homography(grid, nodes) for end in ends]
    jacobian = np.array(moved).reshape(_UNKNOWNS, -1).T / 1e-6
    propagated = np.einsum("ij,jk,ik->i", jacobian, covariance, jacobian)
    variance = propagated + factor * MODEL_SIGMA_PX**2
    pitch = np.linalg.norm(apply_homography(grid, nodes + np.array([1.0, 0.0])) - observed.points, axis=1)
    return PredictedGrid(grid, float(np.sqrt(variance.max()) / np.median(pitch)))
