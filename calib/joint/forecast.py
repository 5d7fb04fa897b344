"""The face of the joint adjustment for studies: what predicted views are expected to tell.

Predicted views have no residuals, so they cannot tell how large the errors are. The amplitudes therefore stand at their
expected values, and are known as well as views with such errors are expected to show them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from calib.adjustment.parameters import AdjustmentParameters, poses_of
from calib.arrays import Array
from calib.calibration import CalibrationOptions
from calib.errors import DegenerateViews
from calib.joint import amplitudes
from calib.joint.curvature import expected_curvature
from calib.joint.effects.camera import DRIFT
from calib.joint.equations import sines_of, turns_of
from calib.joint.hypotheses import OTHER_LENGTH
from calib.joint.knowledge import FOCAL
from calib.joint.marginal import Marginal, Solution
from calib.joint.modes import Modes
from calib.joint.pose_equations import maps_with_gimbal, normal_of_poses
from calib.joint.posed import lens_names, posed
from calib.joint.poses import Poses
from calib.joint.posterior import Posterior
from calib.joint.samples import Node, nodes_about
from calib.joint.solve import Optimum
from calib.joint.summary import Summary, summarised
from calib.joint.words import require_determined
from calib.model.camera import CameraModel
from calib.view import View

__all__ = ["PoseInformation", "PredictedViews", "Summary", "amplitudes"]


class PredictedViews:
    """Views as they are expected of a camera and a collimator, as the problem of an adjustment that is at its end."""

    def __init__(
        self, views: Sequence[View], start: AdjustmentParameters, options: CalibrationOptions
    ) -> None:
        self.views, self.options, self.start = views, options, start
        lens = lens_names(tuple(start.camera.distortion))
        poses = Poses(np.array(poses_of(start.rotations), np.int64))
        self._problem, self._state = posed(views, options, start, lens, poses)

    @property
    def hyper(self) -> amplitudes.Hyperprior:
        """What is expected of the amplitudes."""
        return self._problem.hyper

    def summary(self, eta: Array) -> Summary:
        """Return what these views are expected to give with (A,) logarithms of the amplitudes.

        Views that would not determine the camera are refused.
        """
        expected = self._posterior(eta)
        require_determined(expected, self.views, self.start, self.options)
        return summarised(expected)

    def _posterior(self, eta: Array) -> Posterior:
        marginal = Marginal(self._problem, self._problem.bench.linearised(self._state), self._state)
        try:
            middle = _still(marginal.solve(eta))
            curvature = 0.5 * expected_curvature(middle)
            lower = np.asarray(np.linalg.cholesky(curvature), np.float64)
            nodes = [
                Node(_still(node.solution), node.weight)
                for mode in _meanings(middle)
                for node in nodes_about(mode, lower, mode.weight, _expected_odds)
            ]
            spread = np.sqrt(np.diag(np.linalg.inv(curvature)))
        except np.linalg.LinAlgError as error:
            raise DegenerateViews("These poses do not determine the camera.") from error
        largest = Node(middle, 1.0)
        modes = Modes(Optimum(middle, 0, converged=True), curvature, [largest], largest, {}, 0.0)
        return Posterior(modes, tuple(nodes), spread, {}, largest)

    def information(self, eta: Array) -> PoseInformation:
        """Return what each view tells, as a pose of its own, with (A,) logarithms of the amplitudes."""
        problem, squares = self._problem, np.exp(2.0 * eta)
        apart = np.arange(len(self.views))
        turns, axes = turns_of(self.start.rotations, apart)
        bench = replace(problem.bench, poses=apart, turns=turns, axes=axes, pupils=sines_of(turns))
        state = replace(self._state, fields=np.zeros((len(self.views), self._state.fields.shape[1])))
        marginal = Marginal(replace(problem, bench=bench), bench.linearised(state), state)
        own = normal_of_poses(marginal, squares)[:, :, :-1]
        maps = bench.maps.copy()
        maps[:, :, bench.layout.index[DRIFT]] = 0.0  # it is not known when a pose will be recorded
        prior, at = problem.stated().information.copy(), problem.random.places
        prior[at[:, None], at] += problem.random.information(squares)[0]
        camera = len(bench.layout.pose.camera)
        return PoseInformation(
            own, maps_with_gimbal(bench, maps), prior, bench.camera(self._state.shared), camera
        )


class PoseInformation(NamedTuple):
    """What each of n poses tells of the S shared unknowns, with its rotation and its own field eliminated."""

    own: Array  # (n, Z, Z) information of its basis and of the gimbal
    maps: Array  # (n, Z, S) what the shared unknowns do to these
    prior: Array  # (S, S) information of all that is known beside the poses
    camera: CameraModel
    camera_size: int  # The first so many unknowns are the camera's


def _meanings(middle: Solution) -> list[Node]:
    """Return what is stated, and each other meaning of it that the views may not decide, with their shares."""
    witnesses = middle.marginal.problem.knowledge.witnesses
    others = [((name, FOCAL),) for name, statement in witnesses.items() if FOCAL in statement.doubts]
    share = 1.0 / (1.0 + len(others) * OTHER_LENGTH.odds)
    meant = [_still(middle.marginal.solve(middle.eta, faults)) for faults in others]
    return [Node(middle, share), *(Node(solution, share * OTHER_LENGTH.odds) for solution in meant)]


def _expected_odds(sample: Solution, mode: Solution, more: float) -> float:
    """Return the logarithm of the odds of a sample against a mode that data as expected are expected to show."""
    return 0.5 * (_expected_value(mode.eta, mode) - _expected_value(mode.eta, _still(sample))) + more


def _expected_value(eta: Array, solution: Solution) -> float:
    """Return -2 log of the likelihood that data with (A,) logarithms ``eta`` are expected to give other amplitudes.

    Without residuals the value is log det S of the data's covariance S. To this come tr S^-1 S', with S' at ``eta``.
    What an amplitude a scales has the part a^2 times d log det S / d a^2 in it.
    """
    hyper = solution.marginal.problem.hyper
    of_determinant = solution.gradient - 2.0 * hyper.information @ (solution.eta - hyper.mean)
    return solution.value + 0.5 * float(of_determinant @ np.expm1(2.0 * (eta - solution.eta)))


def _still(solution: Solution) -> Solution:
    """Return a solution whose mean is the expected bench itself: statements do not move a forecast."""
    return replace(solution, step=np.zeros_like(solution.step), fields=np.zeros_like(solution.fields))
