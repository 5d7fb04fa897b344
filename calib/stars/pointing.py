"""Where the grid of stars should lie at a gimbal's reading, by earlier views of which the tag told the names.

Knows homographies of views and the gimbal's readings beside them; no image and no star. It serves to name stars where
the tag is out of view, and nothing else: no estimate of a camera comes from it.

With K of one focal length and the principal point in the middle of the image, A the mounting of the camera on the
gimbal, G the gimbal's rotation and B how it stands before the collimator, a view's grid lies at

    H = K [r1 r2 -R c] diag(p, p, 1),   R = A G B.

Focal length, centre c, A and B are fitted to the earlier views; how surely they tell the new one follows from the fit's
covariance. A single view, an axis that has not moved yet, or readings that contradict the views make that large, and
then nothing is expected.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from calib.errors import DegenerateViews
from calib.model.homography import apply_homography
from calib.model.rotation import euler_zxy, exp_map, log_map, nearest_rotation
from calib.stars.labelling import grid_homography

Array = NDArray[np.float64]

#: What lens, gimbal and homographies leave unsaid of a place in the image, px, 1 sigma, unless the earlier views show
#: more. Places of a view share most of it, so that each view counts as some places only.
MODEL_PX, PLACES_A_VIEW = 1.0, 4
#: How far the camera may be turned on the gimbal against the axes as they are defined, degrees, 1 sigma about each.
MOUNTING_SIGMA_DEG = 5.0
#: Sigma of the expected places, in pitches, up to which they name stars: the next naming is a pitch away.
MAX_SIGMA_PITCHES = 0.15
#: Focal lengths to begin with, in widths of the image.
FIRST_FOCAL = (0.6, 1.0, 1.7, 2.9, 5.0)
#: Places looked at: so many along each side of the image's inner part.
SIDE, INNER = 5, 0.8
_STEPS, _LONGEST_STEP = 60, 0.5
_LOG_F, _CENTRE, _LOG_R, _MOUNTING, _STANDING = 0, slice(1, 3), 3, slice(4, 7), slice(7, 10)
_UNKNOWNS = 10


class LabelledView(NamedTuple):
    """An earlier view whose stars the tag named.

    Attributes
    ----------
    grid
        (3, 3) homography from [column row 1] of the target's grid to [u v 1] px.
    reading_deg
        The gimbal's angles then: ``pan``, ``tilt``, ``roll``; missing is 0.
    """

    grid: Array
    reading_deg: Mapping[str, float]


class PredictedGrid(NamedTuple):
    """Where the grid should lie.

    Attributes
    ----------
    grid
        (3, 3) homography from [column row 1] to [u v 1] px.
    sigma_pitches
        1-sigma of its places, in pitches, the largest over the image.
    """

    grid: Array
    sigma_pitches: float


class _Scene(NamedTuple):
    """Earlier views: the gimbal's readings, and for each (25, 2) nodes that lie at the places looked at."""

    image_size: tuple[int, int]
    pitch_mm: float
    places: Array
    readings: Sequence[Mapping[str, float]]
    nodes: Sequence[Array]

    def grid(self, values: Array, reading_deg: Mapping[str, float]) -> Array:
        """(3, 3) homography of a view by the unknowns."""
        rotation = exp_map(values[_MOUNTING]) @ _gimbal(reading_deg) @ exp_map(values[_STANDING])
        centre = np.array([*values[_CENTRE], -np.exp(values[_LOG_R])])
        matrix = _matrix(float(np.exp(values[_LOG_F])), self.image_size)
        return grid_homography(matrix, rotation, centre, self.pitch_mm)

    def off(self, values: Array) -> Array:
        """Residuals of all places of all views, and the mounting, in sigmas."""
        sigma_px = MODEL_PX * np.sqrt(len(self.places) / PLACES_A_VIEW)
        views = [
            (apply_homography(self.grid(values, reading), nodes) - self.places).ravel() / sigma_px
            for reading, nodes in zip(self.readings, self.nodes, strict=True)
        ]
        return np.concatenate([*views, values[_MOUNTING] / np.radians(MOUNTING_SIGMA_DEG)])


class _Fit(NamedTuple):
    """Unknowns, their covariance, the cost, and by how much it is larger than the model's errors explain."""

    values: Array
    covariance: Array
    cost: float
    excess: float


def predict_grid(
    seen: Sequence[LabelledView],
    reading_deg: Mapping[str, float],
    image_size: tuple[int, int],
    pitch_mm: float,
) -> PredictedGrid:
    """Expect the grid of stars at a reading of the gimbal.

    Parameters
    ----------
    seen
        Earlier views, in two directions at least.
    reading_deg
        The gimbal's angles now.
    image_size
        Width and height, px.
    pitch_mm
        Distance of neighbouring stars, mm.

    Raises
    ------
    DegenerateViews
        Without earlier views, or when they do not tell it to `MAX_SIGMA_PITCHES`.
    """
    if not seen:
        raise DegenerateViews("No earlier view tells where the stars are.", where="gimbal", remedy=_REMEDY)
    places = _places(image_size)
    nodes = [apply_homography(np.asarray(np.linalg.inv(s.grid)), places) for s in seen]
    scene = _Scene(image_size, pitch_mm, places, [s.reading_deg for s in seen], nodes)
    starts = (_start(seen[0], scene, ratio * image_size[0]) for ratio in FIRST_FOCAL)
    fit = min((_fitted(scene, start) for start in starts), key=lambda f: f.cost)
    expectation = _foretold(scene, fit, reading_deg)
    if not expectation.sigma_pitches <= MAX_SIGMA_PITCHES:
        raise DegenerateViews(
            f"{len(seen)} earlier views with the tag and the gimbal's readings tell where the stars are to "
            f"{expectation.sigma_pitches:.2g} squares (1 sigma); {MAX_SIGMA_PITCHES:g} are needed.",
            where="gimbal",
            remedy=_REMEDY,
        )
    return expectation


_REMEDY = "Begin with poses that have the tag in view, in two directions or more along each axis that moves."


def _places(image_size: tuple[int, int]) -> Array:
    """(25, 2) px: places over the inner part of the image."""
    steps = np.linspace(-0.5, 0.5, SIDE) * INNER + 0.5
    u, v = np.meshgrid(steps * (image_size[0] - 1), steps * (image_size[1] - 1))
    return np.column_stack([u.ravel(), v.ravel()])


def _matrix(focal_px: float, image_size: tuple[int, int]) -> Array:
    """(3, 3) K."""
    cx, cy = (image_size[0] - 1) / 2, (image_size[1] - 1) / 2
    return np.array([[focal_px, 0.0, cx], [0.0, focal_px, cy], [0.0, 0.0, 1.0]])


def _gimbal(reading_deg: Mapping[str, float]) -> Array:
    """(3, 3) G."""
    return euler_zxy(*(reading_deg.get(axis, 0.0) for axis in ("pan", "tilt", "roll")))


def _start(first: LabelledView, scene: _Scene, focal_px: float) -> Array:
    """Unknowns by the first view and a focal length: K^-1 H is s [r1 r2 -R c]."""
    per_mm = np.diag([1.0 / scene.pitch_mm, 1.0 / scene.pitch_mm, 1.0])
    scaled = np.linalg.inv(_matrix(focal_px, scene.image_size)) @ first.grid @ per_mm
    middle_mm = scene.nodes[0][len(scene.places) // 2] * scene.pitch_mm
    in_front = np.sign(scaled[2] @ np.append(middle_mm, 1.0))
    scaled *= in_front / np.linalg.norm(scaled[:, :2], axis=0).mean()
    rotation = nearest_rotation(np.column_stack([scaled[:, :2], np.cross(scaled[:, 0], scaled[:, 1])]))
    centre = -rotation.T @ scaled[:, 2]
    values = np.zeros(_UNKNOWNS)
    values[_LOG_F], values[_CENTRE], values[_LOG_R] = (
        np.log(focal_px),
        centre[:2],
        np.log(max(-centre[2], 1.0)),
    )
    values[_STANDING] = log_map(_gimbal(first.reading_deg).T @ rotation)
    return values


def _fitted(scene: _Scene, values: Array) -> _Fit:
    """Minimise the squares by Levenberg's and Marquardt's steps."""
    off = scene.off(values)
    cost, damping = float(off @ off), 1e-3
    for _ in range(_STEPS):
        slopes = _slopes(scene.off, values)
        normal = slopes.T @ slopes
        step = np.linalg.solve(normal + damping * np.diag(np.diag(normal) + 1e-12), -slopes.T @ off)
        step *= min(1.0, _LONGEST_STEP / float(np.abs(step[_LOG_R:]).max() + abs(step[_LOG_F])))
        tried = scene.off(values + step)
        gain = cost - float(tried @ tried)
        damping = damping / 10.0 if gain > 0 else damping * 10.0
        if gain > 0:
            values, off, cost = values + step, tried, cost - gain
        if 0 < gain < 1e-9 * cost or damping > 1e9:
            break
    slopes = _slopes(scene.off, values)
    spare = max(2 * PLACES_A_VIEW * len(scene.nodes) - _UNKNOWNS, 1)
    excess = max(cost / spare, 1.0)
    return _Fit(values, excess * np.asarray(np.linalg.pinv(slopes.T @ slopes, hermitian=True)), cost, excess)


def _foretold(scene: _Scene, fit: _Fit, reading_deg: Mapping[str, float]) -> PredictedGrid:
    """The grid at a reading, and how surely the fit tells it."""
    grid = scene.grid(fit.values, reading_deg)
    nodes = apply_homography(np.asarray(np.linalg.inv(grid)), scene.places)
    slopes = _slopes(lambda v: apply_homography(scene.grid(v, reading_deg), nodes).ravel(), fit.values)
    variance = np.einsum("ij,jk,ik->i", slopes, fit.covariance, slopes) + fit.excess * MODEL_PX**2
    pitch = np.linalg.norm(apply_homography(grid, nodes + np.array([1.0, 0.0])) - scene.places, axis=1)
    return PredictedGrid(grid, float(np.sqrt(variance.max()) / np.median(pitch)))


def _slopes(function: Callable[[Array], Array], values: Array) -> Array:
    """Derivatives of a function of the unknowns, by differences."""
    here = function(values)
    return np.column_stack([(function(values + 1e-6 * e) - here) / 1e-6 for e in np.eye(len(values))])
