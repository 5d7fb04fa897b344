"""A camera from the edges of a sheet (Liu et al., Measurement 235, 2024, 114900; arXiv:2512.22441).

The closed form of `line_geometry` starts the camera and the poses; the sum of squared distances of the edges' points to the
projected edges is then least over intrinsics, distortion and poses. A point's distance is taken in the image without
distortion: between its ray and the plane through the camera and the edge.

Events come at the middle of an edge's logarithmic brightness, which lies towards its dark side, so a bright sheet looks
larger. By how much is one more unknown if it is asked for, the same for all edges (own extension).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from calib.arrays import Array, Bools
from calib.calibration import rms_and_mean
from calib.errors import DegenerateViews, NotConverged
from calib.model.camera import CameraModel, distortion_names
from calib.model.closed_forms import poses_from_homographies, zhang_matrix
from calib.model.rotation import exp_map
from tests.benchmarks.compared.reference_methods import MethodResult

from .line_events import EdgePoints
from .line_geometry import homography_of_lines

_FEWEST_VIEWS, _FEWEST_EDGES = 2, 4
_STEP = 1e-6
#: An edge whose residuals are larger than the typical ones of an edge by this factor was taken for another.
_MISTAKEN, _ROUNDS = 4.0, 3


@dataclass(frozen=True)
class SeenEdges:
    """The edges of a sheet in one image."""

    name: str
    ends_mm: Array  # (E, 2, 3) ends of the edges, in the frame of the sheet; its origin is in the middle
    edges: tuple[EdgePoints, ...]  # of each edge


def calibrate_by_lines(
    views: Sequence[SeenEdges],
    image_size: tuple[int, int],
    distortion: str = "k1k2",
    *,
    widened: bool = False,
) -> MethodResult:
    """Calibrate a camera from the edges of a sheet in two views or more.

    Raises DegenerateViews: If the closed form gives no camera. Raises NotConverged: If the adjustment does not converge.
    """
    if len(views) < _FEWEST_VIEWS:
        raise DegenerateViews(f"{len(views)} views; {_FEWEST_VIEWS} are needed.", remedy="Take more views.")
    start, poses = _start(views, image_size)
    names = distortion_names(distortion)
    camera = replace(start, distortion=dict.fromkeys(names, 0.0))
    adjustment = _Adjustment(views, camera, poses, widened=widened)
    # The closed form knows no distortion, so the focal length and the poses come first.
    values = adjustment.solved(np.zeros(adjustment.size), adjustment.focal_and_poses, "linear")
    everything = np.ones(adjustment.size, np.bool_)
    values = adjustment.solved(values, everything, "linear")
    for _ in range(_ROUNDS):
        adjustment.leave_out_mistaken_edges(values)
        values = adjustment.solved(values, everything, "huber")
    residuals, jacobian = adjustment.residuals(values), adjustment.jacobian(values)
    freedom = len(residuals) - np.count_nonzero(jacobian.any(axis=0))
    if freedom <= 0:
        raise DegenerateViews(f"{len(residuals)} points on edges are too few.", remedy="Take more views.")
    covariance = np.linalg.pinv(jacobian.T @ jacobian, hermitian=True) * (residuals @ residuals / freedom)
    sigma = dict(zip(camera.parameter_names, adjustment.scale * np.sqrt(np.diag(covariance)), strict=False))
    lengths = rms_and_mean(np.abs(residuals * adjustment.sigma_px))
    fitted = adjustment.camera(values)
    return MethodResult("lines", fitted, sigma, *lengths, None)


def _start(
    views: Sequence[SeenEdges], image_size: tuple[int, int]
) -> tuple[CameraModel, list[tuple[Array, Array]]]:
    """Return a camera without distortion, and rotation and translation of each view, by the closed form."""
    lines = [np.array([edge.line for edge in view.edges]) for view in views]
    homographies = np.array(
        [homography_of_lines(line, view.ends_mm) for line, view in zip(lines, views, strict=True)]
    )
    matrix = zhang_matrix(homographies, image_size, free_principal_point=False)
    if matrix is None:
        raise DegenerateViews("The closed form has no real camera.", remedy="Tilt the sheet more.")
    rotations, centres = poses_from_homographies(homographies, matrix)
    poses = [(r, -r @ c) for r, c in zip(rotations, centres, strict=True)]
    return CameraModel.of_matrix(matrix, image_size), poses


class _Adjustment:
    """Distances of points to projected edges, over their sigmas, by changes of the camera and of the poses.

    Unknowns: those of the camera (the focal lengths in units of themselves), the widening, and six for each view: a
    rotation vector, rad, and a shift as a share of the distance.
    """

    def __init__(
        self,
        views: Sequence[SeenEdges],
        start: CameraModel,
        poses: Sequence[tuple[Array, Array]],
        *,
        widened: bool,
    ) -> None:
        self._start, self._widened = start, widened
        self._shared = len(start.parameter_names) + int(widened)
        self.size = self._shared + 6 * len(views)
        self.scale = np.ones(self.size)  # Units of the unknowns
        self.scale[:2] = start.fx, start.fy
        self._rotations = np.array([r for r, _ in poses])
        self._translations = np.array([t for _, t in poses])
        self._views = views
        edges = [
            (number, edge, ends)
            for number, view in enumerate(views)
            for edge, ends in zip(view.edges, view.ends_mm, strict=True)
        ]
        counts = [len(edge.points_px) for _, edge, _ in edges]
        self._view = np.repeat([number for number, *_ in edges], counts)
        self._edge = np.repeat(np.arange(len(edges)), counts)
        self._of_view = np.array([number for number, *_ in edges])
        self._ends = np.array([ends for *_, ends in edges])
        self._darkwards = np.array([edge.darkwards for _, edge, _ in edges])
        self._points = np.concatenate([edge.points_px for _, edge, _ in edges])
        self.sigma_px = np.concatenate([edge.sigma_px for _, edge, _ in edges])
        self.focal_and_poses = np.ones(self.size, np.bool_)
        self.focal_and_poses[2 : self._shared] = False

    def camera(self, values: Array) -> CameraModel:
        """Return the camera at some values of the unknowns."""
        count = len(self._start.parameter_names)
        return self._start.with_values(self._start.values + self.scale[:count] * values[:count])

    def leave_out_mistaken_edges(self, values: Array) -> None:
        """Leave out the points of edges that are far worse than the others."""
        square = self.residuals(values) ** 2
        count = np.bincount(self._edge, minlength=len(self._of_view))
        rms = np.sqrt(np.bincount(self._edge, square, minlength=len(count)) / np.maximum(count, 1))
        right = (count > 0) & (rms < _MISTAKEN * np.median(rms[count > 0]))
        # Few edges agree with any pose.
        left = np.bincount(self._of_view, right, minlength=len(self._views))
        good = (right & (left >= _FEWEST_EDGES)[self._of_view])[self._edge]
        self._points, self.sigma_px = self._points[good], self.sigma_px[good]
        self._view, self._edge = self._view[good], self._edge[good]

    def residuals(self, values: Array) -> Array:
        """Return (N,) distances over sigmas."""
        camera = self.camera(values)
        changes = values[self._shared :].reshape(-1, 6)
        turns = np.array([exp_map(change[:3]) for change in changes])
        rotations = turns @ self._rotations
        shifts = changes[:, 3:] * self._translations[:, 2:]
        translations = self._translations + shifts
        rotation, translation = rotations[self._of_view], translations[self._of_view]
        first, second = (
            np.einsum("eij,ej->ei", rotation, ends) + translation
            for ends in (self._ends[:, 0], self._ends[:, 1])
        )
        across = np.cross(first, second)
        across /= np.linalg.norm(across[:, :2], axis=1, keepdims=True)
        rays = camera.rays(self._points)
        rays = rays / rays[:, 2:]
        distance = camera.fx * (rays * across[self._edge]).sum(axis=1)
        if self._widened:
            darkwards = np.sign((across[:, :2] * self._darkwards).sum(axis=1))[self._edge]
            distance = distance - darkwards * values[self._shared - 1]
        return np.asarray(distance / self.sigma_px)

    def jacobian(self, values: Array) -> Array:
        """Return the (N, size) derivatives; an unknown of a pose is changed in all views at once."""
        columns = np.zeros((len(self._points), self.size))
        here = self.residuals(values)
        for number in range(self._shared):
            changed = values.copy()
            changed[number] += _STEP
            columns[:, number] = (self.residuals(changed) - here) / _STEP
        for number in range(6):
            changed = values.copy()
            changed[self._shared + number :: 6] += _STEP
            slope = (self.residuals(changed) - here) / _STEP
            columns[np.arange(len(here)), self._shared + 6 * self._view + number] = slope
        return columns

    def solved(self, values: Array, free: Bools, loss: str) -> Array:
        """Return the values at the least sum; only some unknowns are free."""

        def full(own: Array) -> Array:
            every = values.copy()
            every[free] = own
            return every

        fit = least_squares(
            lambda own: self.residuals(full(own)),
            values[free],
            lambda own: self.jacobian(full(own))[:, free],
            loss=loss,
            f_scale=3.0,
            x_scale="jac",
            max_nfev=200,
        )
        if not fit.success:
            raise NotConverged("The adjustment over lines did not converge.", remedy="Add views.")
        return full(fit.x)
