"""The expected posterior: the joint adjustment of predicted views, with the amplitudes that are expected of the bench.

Predicted views have no residuals, so they cannot tell how large the errors are. The amplitudes therefore stand at their
expected values, and are known as well as the Fisher information of the planned views allows.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calib.adjustment.parameters import AdjustmentParameters
from calib.calibration import CalibrationOptions
from calib.errors import DegenerateViews
from calib.joint import amplitudes as amp
from calib.joint.adjust import lens_names, posed
from calib.joint.curvature import expected_curvature
from calib.joint.equations import State
from calib.joint.marginal import Marginal, Problem, Solution
from calib.joint.posterior import Posterior
from calib.joint.prior import NO_FAULT
from calib.joint.samples import Node
from calib.joint.solve import Optimum
from calib.model.lens import is_fisheye
from calib.studies.predicted_views import ExpectedBench
from calib.view import View

Array = NDArray[np.float64]
Angles = Mapping[str, float]

#: Amplitudes of the errors that follow the collimator.
_ERRORS = (amp.PARALLAX, *amp.COMMON, *amp.TURN, *amp.TURN_2, amp.RADIAL, amp.SHIFTED, amp.SHIFTED_TURN)
_PAIRS = 8
#: Distortion of a lens at the corner of the sensor, as a share of the distance from the axis: as large as that of the
#: camera of arXiv:2512.16092.
_THIRD_ORDER, _FIFTH_ORDER = 0.003, -0.002
#: Robust limit of predicted stars; they have no residuals.
_LIMIT = 1.0


def expected_options(bench: ExpectedBench, angles_deg: Sequence[Angles]) -> CalibrationOptions:
    """Return the options of the calibration that a bench expects.

    angles_deg: Angles of the gimbal for each view, degrees.
    """
    readings = bench.readings
    return CalibrationOptions(
        passport=bench.passport,
        gimbal=replace(readings, angles_deg=tuple(dict(one) for one in angles_deg)) if readings else None,
        budget=bench.terms,
        radial_sigma=bench.radial_sigma,
    )


def posed_bench(
    bench: ExpectedBench, views: Sequence[View], rotations: Array, angles_deg: Sequence[Angles]
) -> tuple[Problem, State]:
    """Return the adjustment of predicted views at the expected bench.

    rotations: (n, 3, 3) rotations of the views, camera <- target.
    angles_deg: Angles of the gimbal for each view, degrees.
    """
    lens = lens_names(tuple(bench.camera.distortion))
    start = AdjustmentParameters(bench.camera, bench.collimator, rotations, np.zeros((len(views), 3)))
    return posed(views, expected_options(bench, angles_deg), start, lens)


def with_distortion(bench: ExpectedBench) -> ExpectedBench:
    """Return the bench with a typical distortion if none is stated; without any, nothing separates cx and p1."""
    camera = bench.camera
    if any(camera.distortion.values()) or is_fisheye(camera.distortion):
        return bench
    square = (0.5 * float(np.hypot(*camera.image_size)) / camera.fx) ** 2
    lens = {**camera.distortion, "k1": _THIRD_ORDER / square, "k2": _FIFTH_ORDER / square**2}
    return replace(bench, camera=replace(camera, distortion=lens))


def expected_amplitudes(bench: ExpectedBench, hyper: amp.Hyperprior) -> Array:
    """Return the (A,) logarithms of the amplitudes that a bench expects.

    They are those of the run so far, if one is under way. Else they are the medians of the hyperprior, times the size
    of the errors that the station states over that of a good collimator.
    """
    eta = hyper.mean.copy()
    if bench.amplitudes is not None:
        found = {name: value for name, value in bench.amplitudes.items() if name in hyper.names}
        eta[hyper.places(tuple(found))] = np.log(list(found.values()))
        return eta
    errors, focal_px, sigma_px = bench.errors, bench.camera.fx, bench.star_sigma_px
    edge = float(np.tan(np.radians(bench.half_angle_deg)))
    eta[hyper.places(_ERRORS)] += np.log(errors.times_good(focal_px, sigma_px))
    own = errors.pose_times_good(focal_px, sigma_px, bench.collimator.r, edge)
    eta[hyper.places(amp.POSE)] += np.log(own)
    if bench.readings is not None:
        wander_deg = np.degrees(errors.defocus * errors.pupil_wander_mm / bench.collimator.r)
        scatter = np.hypot(1.0, wander_deg / bench.readings.reading_sigma_deg)
        eta[hyper.at(amp.READING)] += np.log(scatter)
    bounds = np.array(hyper.bounds).T
    return np.clip(eta, *bounds)


def expected_posterior(
    bench: ExpectedBench, views: Sequence[View], rotations: Array, angles_deg: Sequence[Angles]
) -> Posterior:
    """Return the posterior that planned views are expected to give.

    rotations: (n, 3, 3) rotations of the views, camera <- target.
    angles_deg: Angles of the gimbal for each view, degrees.
    Raises DegenerateViews: If they do not determine the camera.
    """
    problem, state = posed_bench(bench, views, rotations, angles_deg)
    marginal = Marginal(problem, problem.bench.linearised(state, _LIMIT), state)
    hyper = problem.hyper
    eta = expected_amplitudes(bench, hyper)
    try:
        middle = _still(marginal.solve(eta, slope=False))
        spread = np.linalg.inv(0.5 * expected_curvature(marginal, eta, middle))
        lower = np.linalg.cholesky(spread)
        deviates = np.random.default_rng(0).standard_normal((_PAIRS, len(eta)))
        places = [eta, *(eta + lower @ z for z in (*deviates, *-deviates))]
        bounds = np.array(hyper.bounds).T
        solved = [_still(marginal.solve(np.clip(place, *bounds), slope=False)) for place in places]
    except np.linalg.LinAlgError as error:
        raise DegenerateViews("These poses do not determine the camera.") from error
    weight = 1.0 / len(places)
    nodes = tuple(Node(weight, place, NO_FAULT, one) for place, one in zip(places, solved, strict=True))
    optimum = Optimum(marginal, eta, middle, 0, converged=True)
    return Posterior(optimum, nodes, np.sqrt(np.diag(spread)), {}, replace(nodes[0], solution=middle))


def _still(found: Solution) -> Solution:
    """Return a solution whose mean is the expected bench itself: statements do not move a forecast."""
    return replace(found, step=np.zeros_like(found.step), fields=np.zeros_like(found.fields))
