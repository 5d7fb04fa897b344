"""The face of the adjustment for studies: what predicted views are expected to tell.

Predicted views have no residuals, so they cannot tell how large the errors are. The amplitudes therefore stand at their
expected values, and are known as well as views with such errors are expected to show them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from calib.adjustment.parameters import AdjustmentParameters, poses_of
from calib.arrays import Array
from calib.calibration import CalibrationOptions
from calib.errors import DegenerateViews
from calib.model.camera import CameraModel
from calib.model.result_parts import WORST_CORNER, BudgetRow
from calib.view import View

from . import amplitudes
from .budget import budget_rows, row_gradients, variances
from .camera import Camera, lens_names
from .effects import Poses
from .equations import Equations
from .hypotheses import AS_IT_STANDS, FOCAL, Hypothesis, hypotheses
from .knowledge import Known
from .mixture import Mixture, Part, stated
from .posterior import Component, Posterior
from .problem import Problem, Start, State, Task
from .pupils import Moved
from .search import Optimum
from .solution import Solution, Wide, expected_curvature, solve
from .weights import Weights
from .words import require_determined

__all__ = ["PoseInformation", "PredictedViews", "Summary", "amplitudes"]

#: Pairs of samples: with half as many, expected uncertainties of neighbouring poses scatter by 8 %.
_PAIRS = 24
#: No sample counts more than this many times the usual one.
_LARGEST_WEIGHT = 10.0


@dataclass(frozen=True)
class Summary:
    """What predicted views are expected to give: of the camera, of the collimator's centre, of its radial terms."""

    names: tuple[str, ...]
    covariance: Array  # (K, K)
    coverage_factors: dict[str, float]  # By name, and of `WORST_CORNER`
    rows: tuple[BudgetRow, ...]
    camera: CameraModel  # With the term of r^8
    camera_covariance: Array  # (C, C) of its parameters


class PoseInformation(NamedTuple):
    """What each of n poses tells of the S shared unknowns, with its rotation and its own field eliminated."""

    own: Array  # (n, Z, Z) information of its basis and of the gimbal
    maps: Array  # (n, Z, S) what the shared unknowns do to these
    prior: Array  # (S, S) information of all that is known beside the poses
    camera: CameraModel
    camera_size: int  # The first so many unknowns are the camera's parameters


class PredictedViews:
    """Views as they are expected of a camera and a collimator, as the problem of an adjustment that is at its end."""

    def __init__(
        self, views: Sequence[View], start: AdjustmentParameters, options: CalibrationOptions
    ) -> None:
        self.views, self.options, self.start = views, options, start
        self._lens = lens_names(tuple(start.camera.distortion))
        self._problem, self._state = self._posed(poses_of(start.rotations))

    def _posed(self, poses: Sequence[int]) -> tuple[Problem, State]:
        """Return the problem about what is expected, and its state."""
        known, camera = Known.of(self.options), self.start.camera
        f = float(np.sqrt(camera.fx * camera.fy))
        unknowns = Camera(camera.image_size, f, self._lens).unknowns(camera)
        centre = self.start.collimator
        rho = [np.zeros(len(view)) for view in self.views]
        task = Task(self.views, known, self._lens, np.array(poses, np.int64), Moved(), rho)
        return task.posed(Start(f, (centre.x, centre.y, centre.r), self.start.rotations, unknowns))

    @property
    def hyper(self) -> amplitudes.Expected:
        """What is expected of the amplitudes."""
        return self._problem.expected

    def _equations(self, problem: Problem, state: State) -> Equations:
        """Return the equations of stars that all count."""
        ones = [np.ones(len(view)) for view in self.views]
        return Equations.at(problem, state, Weights(ones, ones, 0.0, 0.0, *np.ones((2, len(ones)))))

    def summary(self, eta: Array) -> Summary:
        """Return what these views are expected to give with (A,) logarithms of the amplitudes.

        Views that would not determine the camera are refused.
        """
        mixture = Mixture((Part(self._posterior(eta), 1.0),))
        known = self.options.passport is not None
        require_determined(mixture, self.views, self.start, known=known)
        result, gradients = stated(mixture), row_gradients(mixture)
        corner = mixture.expanded(gradients[-1]) / float(
            np.sqrt(gradients[-1] @ mixture.covariance @ gradients[-1])
        )
        size = len(mixture.camera.values)
        return Summary(
            result.names,
            result.covariance,
            {**result.coverage_factors, WORST_CORNER: corner},
            budget_rows(mixture, gradients, variances(mixture, gradients)),
            mixture.camera,
            mixture.covariance[:size, :size],
        )

    def _posterior(self, eta: Array) -> Posterior:
        q = self._equations(self._problem, self._state)
        others = [one for one in hypotheses(self._problem.unknowns) if any(f == FOCAL for _, f in one.faults)]
        meanings = [AS_IT_STANDS, *others]
        odds = np.exp([one.log_odds for one in meanings])
        try:
            middle = _still(solve(q, eta))
            spread = np.asarray(np.linalg.inv(0.5 * expected_curvature(middle)), np.float64)
            components = [
                component
                for one, share in zip(meanings, (odds / odds.sum()).tolist(), strict=True)
                for component in _samples(_still(solve(q, eta, one.wide)), one, spread, share)
            ]
        except np.linalg.LinAlgError as error:
            raise DegenerateViews("These poses do not determine the camera.") from error
        shares = dict(zip(meanings, (odds / odds.sum()).tolist(), strict=True))
        shares[AS_IT_STANDS] += 1e-9  # the first of equals
        return Posterior(
            tuple(components), shares, np.sqrt(np.diag(spread)), Optimum(middle, 0, converged=True), 0.0
        )

    def information(self, eta: Array) -> PoseInformation:
        """Return what each view tells, as a pose of its own, with (A,) logarithms of the amplitudes."""
        problem, state = self._posed(range(len(self.views)))
        still = problem.unknowns.fixed.copy()
        still[:, :, problem.unknowns.places("drift")] = 0.0  # it is not known when a pose will be recorded
        problem = replace(
            problem, unknowns=replace(problem.unknowns, fixed=still), turned=Poses.of(state.rotations)
        )
        q = self._equations(problem, state)
        solution = solve(q, eta)
        own = [_of_pose(solution, pose) for pose in range(problem.n)]
        c, size = state.b[: problem.depth], 4 + len(problem.camera.lens)
        gimbal = problem.readings.at if problem.readings else np.zeros(0, np.int64)
        units = np.tile(np.eye(len(state.b))[gimbal], (problem.n, 1, 1))
        maps, prior = np.concatenate([q.maps, units], axis=1), np.diag(solution.prior.shared)
        # The camera's parameters in place of its unknowns: a result states these.
        back = np.linalg.inv(problem.camera.by_unknowns(c)[:, :size])
        maps[:, :, :size] = maps[:, :, :size] @ back
        prior[:size, :size] = back.T @ prior[:size, :size] @ back
        return PoseInformation(np.array(own), maps, prior, problem.camera.model(c), size)


def _of_pose(solution: Solution, pose: int) -> Array:
    """Return the (Z, Z) information of a pose's basis and of the gimbal, all that it has for itself eliminated."""
    q, p, star = solution.equations, solution.problem, solution.prior.star
    between, count = star * q.of_local[0][pose], q.by_gimbal.shape[2]
    whole = np.zeros((p.size + count, p.size + count))
    whole[: p.size, : p.size] = star * q.of_views[pose, : p.size, : p.size]
    across = np.concatenate([between, np.zeros((len(between), count))], axis=1)
    if count:
        by, reading = q.by_gimbal[pose], solution.prior.reading
        whole[p.size :, p.size :] = reading * by.T @ by
        across[q.slots[pose], p.size :] -= reading * by
    return np.asarray(whole - across.T @ solution.own[pose] @ across)


def _samples(mode: Solution, one: Hypothesis, spread: Array, share: float) -> list[Component]:
    """Return samples of the amplitudes about a mode, in pairs, with weights that sum to ``share``; spread: (A, A)."""
    lower, size = np.linalg.cholesky(spread), len(mode.eta)
    deviates = np.random.default_rng(0).standard_normal((_PAIRS, size))
    low, high = mode.problem.expected.bounds
    wide: Wide = mode.wide
    solutions, logs = [mode], [0.0]
    for z in (*deviates, *-deviates):
        eta = np.clip(mode.eta + lower @ z, low, high)
        solutions.append(_still(solve(mode.equations, eta, wide)))
        gain = _expected_value(mode.eta, mode) - _expected_value(mode.eta, solutions[-1])
        logs.append(0.5 * gain + 0.5 * float(z @ z))
    limited = np.minimum(logs, np.median(logs) + np.log(_LARGEST_WEIGHT))
    weights = np.exp(limited - limited.max())
    weights *= share / weights.sum()
    return [
        Component(weight, solution, one) for weight, solution in zip(weights.tolist(), solutions, strict=True)
    ]


def _expected_value(eta: Array, solution: Solution) -> float:
    """Return -2 log of the likelihood that data with (A,) logarithms ``eta`` are expected to give other amplitudes.

    Without residuals the value is log det S of the data's covariance S. To this come tr S^-1 S', with S' at ``eta``.
    What an amplitude a scales has the part a^2 times d log det S / d a^2 in it.
    """
    expected = solution.problem.expected
    of_determinant = solution.gradient - 2.0 * expected.information @ (solution.eta - expected.mean)
    return solution.value + 0.5 * float(of_determinant @ np.expm1(2.0 * (eta - solution.eta)))


def _still(solution: Solution) -> Solution:
    """Return a solution whose mean is the expected bench itself: statements do not move a forecast."""
    return replace(solution, step=np.zeros_like(solution.step), local=np.zeros_like(solution.local))
