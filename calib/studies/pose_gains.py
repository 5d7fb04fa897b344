"""What each of many poses would add to others: sums of information at the expected amplitudes.

A pose tells of the shared unknowns what its stars and its reading say, with its rotation and its own field eliminated.
That information adds up over the poses, so that a pose to add is judged without another adjustment.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib.joint import amplitudes as amp
from calib.joint.equations import Equations, turns_of
from calib.joint.layout import POSE_PLACES
from calib.joint.marginal import Problem
from calib.studies.expected_posterior import Angles, expected_amplitudes, posed_bench
from calib.studies.predicted_views import ExpectedBench
from calib.uncertainty.projection_uncertainty import projection_derivatives
from calib.view import View

Array = NDArray[np.float64]

_GRID_POINTS = 9
#: Poses are compared with about so many of their stars; each then counts for those that are left out.
_STARS = 80


@dataclass(frozen=True)
class Sigmas:
    """Standard uncertainties that some poses leave, for the expected amplitudes."""

    fx_px: float  # 1-sigma of the focal length fx, px
    worst_px: float  # Largest projection uncertainty over the sensor, 1 sigma, px


class PoseGains:
    """The information of poses, some of which will be recorded.

    views: Predicted views, one for each pose.
    rotations: (n, 3, 3) rotations of the views, camera <- target.
    angles_deg: Angles of the gimbal for each view, degrees.
    """

    def __init__(
        self, bench: ExpectedBench, views: Sequence[View], rotations: Array, angles_deg: Sequence[Angles]
    ) -> None:
        problem, state = posed_bench(bench, [_thinned(view) for view in views], rotations, angles_deg)
        apart = np.arange(len(views))
        own = replace(problem.bench, poses=apart)
        turns, axes = turns_of(rotations, apart)
        own = replace(own, turns=turns, axes=axes, pupils=turns)
        state = replace(state, fields=np.zeros((len(views), len(POSE_PLACES))))
        eta = expected_amplitudes(bench, problem.hyper)
        squares = np.exp(2.0 * eta)
        equations = own.linearised(state, 1.0)
        self._own = _reduced(replace(problem, bench=own), equations, squares)
        self._maps = _maps(own.maps, own.gimbal_places if own.readings else None)
        self._prior = _prior(problem, squares)
        self._camera = len(own.layout.camera)
        self._by_camera = projection_derivatives(own.camera(state.shared), _GRID_POINTS)[1]

    def covariance(self, weights: Array) -> Array:
        """Return the (S, S) covariance of the shared unknowns for (k,) weights of the first poses."""
        information = self._prior.copy()
        for k, weight in enumerate(weights):
            information += weight * self._maps[k].T @ self._own[k] @ self._maps[k]
        scale = 1.0 / np.sqrt(np.diag(information))
        inverse = np.linalg.inv(information * np.outer(scale, scale))
        return np.asarray(inverse * np.outer(scale, scale))

    def sigmas(self, covariance: Array) -> Sigmas:
        """Return what a covariance of the shared unknowns, or of the camera alone, leaves.

        The criterion of the worst point is the G-optimality of Kiefer and Wolfowitz (1960).
        """
        camera = covariance[: self._camera, : self._camera]
        spread = self._by_camera @ camera @ np.swapaxes(self._by_camera, 1, 2)
        worst = float(np.linalg.eigvalsh(spread)[:, 1].max())
        return Sigmas(float(np.sqrt(max(camera[0, 0], 0.0))), float(np.sqrt(max(worst, 0.0))))

    def with_pose(self, covariance: Array, place: int, weight: float) -> Sigmas:
        """Return what a further pose leaves.

        covariance: (S, S) without it.
        """
        moved, own = self._maps[place] @ covariance, weight * self._own[place]
        inside = np.eye(len(own)) + own @ moved @ self._maps[place].T
        at = moved[:, : self._camera]
        gain: Array = np.asarray(np.linalg.solve(inside, own @ at), np.float64)
        return self.sigmas(covariance[: self._camera, : self._camera] - at.T @ gain)


def _thinned(view: View) -> View:
    """Return the view with every n-th star, each with the information of n."""
    step = max(1, len(view) // _STARS)
    return View(
        view.name,
        view.image_size,
        view.ids[::step],
        view.points_px[::step],
        view.target_mm[::step],
        view.covariances_px2[::step] / step,
    )


def _reduced(problem: Problem, equations: Equations, squares: Array) -> Array:
    """Return (n, Z, Z) the information of each pose on its basis and on the gimbal, its own field eliminated."""
    bench, hyper = problem.bench, problem.hyper
    star = squares[hyper.at(amp.STAR)]
    size, gimbal = bench.layout.size, len(bench.layout.gimbal)
    whole = np.zeros((bench.n_poses, size + gimbal, size + gimbal))
    whole[:, :size, :size] = equations.squares / star
    if len(equations.off) and bench.readings is not None:
        noise = squares[hyper.at(amp.READING)] * bench.readings.sigma_rad**2
        weights = np.linalg.inv(star * np.linalg.inv(equations.turns) + noise * np.eye(3))
        rows = np.concatenate([equations.coupling, equations.gimbal], axis=2)
        whole += np.swapaxes(rows, 1, 2) @ weights @ rows
    at = bench.layout.pose_places
    between = whole[:, at]
    own = between[:, :, at] + np.diag(problem.own_information(squares))
    return np.asarray(whole - np.swapaxes(between, 1, 2) @ np.linalg.solve(own, between))


def _maps(maps: Array, gimbal: NDArray[np.int64] | None) -> Array:
    """Return (n, Z, S) what the shared unknowns do to the bases of the poses and to the gimbal."""
    if gimbal is None:
        return maps
    units = np.zeros((len(maps), len(gimbal), maps.shape[2]))
    units[:, range(len(gimbal)), gimbal] = 1.0
    return np.concatenate([maps, units], axis=1)


def _prior(problem: Problem, squares: Array) -> Array:
    """Return the (S, S) information of all that is known beside the poses."""
    size = len(problem.bench.layout.names)
    information = np.zeros((size, size))
    for one in problem.knowledge.statements:
        information += one.rows.T @ one.information() @ one.rows
    for block in problem.blocks:
        information[block.places[:, None], block.places] += np.linalg.inv(block.covariance(squares))
    return information
