"""What a person did to a bench while it recorded, or stated wrongly: hypotheses beside those of the statements.

Each is weighed against the same views with the faults of statements that the engine knows, by its likelihood ratio and
the number of places where it is looked for. A statement that is at fault only without the cause is not accused.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from calib.arrays import Array
from calib.calibration import Calibration, CalibrationOptions
from calib.diagnosis.gimbal_faults import GimbalFault
from calib.diagnosis.gimbal_model import GimbalModel, first_scales
from calib.diagnosis.hand_eye import check_hand_eye
from calib.diagnosis.hand_eye_verdict import HandEyeCheck
from calib.errors import CalibrationError
from calib.model import cause as kinds
from calib.model.cause import LARGEST_EVIDENCE, PARALLAX, Cause
from calib.model.gimbal import MOUNTING
from calib.model.gimbal_readings import AXES, GimbalReadings, angles_of
from calib.model.likelihood_ratio import DECISIVE, needed
from calib.model.result_parts import GimbalEstimate
from calib.model.rotation import exp_map
from calib.model.type_b_terms import SCALES
from calib.view import View

from .added import AddedColumns, displaced
from .hypotheses import FOCAL
from .knowledge import CERTIFICATE, READINGS
from .posterior import Posterior, posterior
from .results import Mixture
from .search import Optimum, best_amplitudes
from .solution import solve
from .witnesses import fault_probabilities
from .words import DOUBTED, SCATTER

#: An axis moved if its readings differ by more, degrees. A scale that is so far off, in its logarithm, is a wrong
#: number of steps; the search for faults expects scales within a tenth.
_MOVED_DEG, _FAR_SCALE = 0.5, 0.2
#: Prior 1 sigma of a step of the focal length, as a share: 2 degrees of an ordinary ring. Smaller ones than the second
#: number may come from 3 K of aluminium.
_STEP, _LEAST_STEP = 1e-3, 1e-4
#: Odds beforehand that the focus ring was touched between two poses: once in a hundred calibrations.
_FOCUS_STEP = 1e-2
#: A step is adjusted if it promises so much of 2 log of the likelihood at the amplitudes found, though these have grown
#: to take it up: without one, 5 % of places do.
#: Steps of .02 to .2 % on drawn benches that were told promised 5 or more.
_PROMISED = 4.0
#: So many of the most promising places of a step are adjusted, each with so many improvements of its size.
_TRIED, _IMPROVED = 2, 3
_AMPLITUDE_STEPS = 20
#: A cause that takes the place of accusations is more probable than not.
_MORE_PROBABLE = 0.5
#: Certificates are right to this share: beyond it, the target is wrong more often.
_CERTIFIED = 1e-3
_FAULTS = {"slip": kinds.SLIPPED, "mount": kinds.TURNED, "pose": kinds.ONE_POSE}


def find_causes(
    result: Calibration, mixture: Mixture, views: Sequence[View], stated: CalibrationOptions
) -> tuple[Cause, ...]:
    """Return the causes that the data show, the most probable first; ``stated`` are the options with the readings."""
    steps = _focus_steps(mixture.first, views)
    scale = () if steps else _other_scale(mixture.first, stated)
    causes = (*_of_gimbal(result, stated), *steps, *scale)
    return tuple(sorted(causes, key=lambda cause: -cause.evidence))


def _focus_steps(first: Posterior, views: Sequence[View]) -> tuple[Cause, ...]:
    """Return the step of the focal length between two views that explains them better than any fault; or none.

    A step displaces log f in the bases of all later views; the equations at the optimum say what that gains.
    """
    problem, m = first.problem, len(views)
    if m < 3 or problem.n < 3:
        return ()
    columns = np.zeros((m, problem.size, m - 1))
    for k in range(1, m):
        columns[k:, 0, k - 1] = 1.0
    gains = AddedColumns.of(first.optimum.solution, columns)
    promised = gains.gradient**2 / (np.diag(gains.information) + _STEP**-2)
    places = [place for place in np.argsort(-promised)[:_TRIED].tolist() if promised[place] > _PROMISED]
    cost, best = needed(m - 1) - 2.0 * math.log(_FOCUS_STEP), None
    steps = {place: _stepped(first.optimum, columns[:, :, place]) for place in places}
    value = best_amplitudes(first.optimum.solution, _AMPLITUDE_STEPS).value if places else 0.0
    likely = [
        place
        for place, step in steps.items()
        if abs(step.size) >= _LEAST_STEP and value - step.optimum.solution.value > step.taken + cost
    ]
    before = first.log_odds - 0.5 * first.optimum.solution.value
    for place in likely:
        step = steps[place]
        there = posterior(step.optimum)
        gained = 2.0 * (there.log_odds - 0.5 * there.optimum.solution.value - before)
        evidence = gained - step.taken - cost + DECISIVE
        if evidence > (best.evidence if best else DECISIVE):
            accused, faults = fault_probabilities(there), fault_probabilities(first)
            explains = [name for name, p in faults.items() if p >= DOUBTED > accused.get(name, 0.0)]
            best = step.as_cause(evidence, (views[place].name, views[place + 1].name), explains)
    return (best,) if best else ()


class _Step(NamedTuple):
    """A step of the focal length, as a share, and the optimum that has it."""

    size: float
    sigma: float
    optimum: Optimum

    @property
    def taken(self) -> float:
        """By how much the prior of the size lowers 2 log of the evidence: by its width, and by how far out it lies."""
        size = (self.size / _STEP) ** 2
        return math.log1p((_STEP / self.sigma) ** 2) + size / (1.0 + size)

    def as_cause(self, evidence: float, between: tuple[str, str], explains: Sequence[str]) -> Cause:
        """Return the cause; ``between`` are the names of the views before and after the step."""
        return Cause(
            kinds.FOCUSED,
            min(evidence, LARGEST_EVIDENCE),
            value=100.0 * self.size,
            expanded=200.0 * self.sigma,
            unit="%",
            before=between[0],
            pose=between[1],
            explains=tuple(explains),
        )


def _stepped(optimum: Optimum, column: Array) -> _Step:
    """Return the best step along an (m, B) column."""
    size, there, information = 0.0, optimum, 0.0
    for _ in range(_IMPROVED):
        added = AddedColumns.of(there.solution, column[:, :, None])
        information = float(added.information[0, 0])
        size += float(added.gradient[0]) / (information + _STEP**-2)
        moved = displaced(optimum.solution.equations, size * column)
        solution = best_amplitudes(solve(moved, there.solution.eta), _AMPLITUDE_STEPS)
        there = replace(optimum, solution=solution)
    return _Step(size, 1.0 / math.sqrt(max(information, 1e-300)), there)


def _other_scale(first: Posterior, stated: CalibrationOptions) -> tuple[Cause, ...]:
    """Return the cause if the certified radius alone contradicts the views: another pitch looks the same."""
    scales = {term.name for term in stated.budget if term.kind in SCALES}
    certificate = next((s for s in first.problem.unknowns.statements if s.name == CERTIFICATE), None)
    if certificate is None:
        return ()
    length = {CERTIFICATE, *scales}
    share = sum(
        probability
        for hypothesis, probability in first.odds.items()
        if length & {name for name, fault in hypothesis.faults if fault != FOCAL}
    )
    if share < _MORE_PROBABLE:
        return ()
    unknowns, r_mm = first.problem.unknowns, certificate.stated
    # A print that is larger than stated looks as one that is nearer.
    row = unknowns.log_r.copy()
    for name in scales:
        row[unknowns.places(name)] = -1.0
    ratio = first.problem.fields.r0 * math.exp(float(row @ first.mean)) / r_mm
    if abs(ratio - 1.0) < _CERTIFIED:
        return ()
    sigma = ratio * math.sqrt(float(row @ first.covariance @ row))
    cause = Cause(kinds.SCALED, _two_log_odds(1.0 - share), value=ratio, expanded=2.0 * sigma, stated=r_mm)
    # Small changes of the scale, parallax can imitate; then both are told together.
    doubt = fault_probabilities(first).get(PARALLAX, 0.0)
    parallax = (PARALLAX,) if DOUBTED <= doubt < _MORE_PROBABLE else ()
    return (replace(cause, beside=(CERTIFICATE, *parallax), explains=(*sorted(length), *parallax)),)


def _two_log_odds(against: float) -> float:
    """Return 2 log of the odds for what has a probability against it."""
    return min(2.0 * (math.log1p(-min(against, 0.999)) - math.log(max(against, 1e-30))), LARGEST_EVIDENCE)


def _of_gimbal(result: Calibration, stated: CalibrationOptions) -> tuple[Cause, ...]:
    """Return what readings that contradict the stars show: a wrong sign, or faults, or else a wrong scale."""
    readings = stated.gimbal
    if readings is None or not _contradicts(result.gimbal) or not len(result.rotation_covariance):
        return ()
    if far := _far_scales(result, readings):
        return far
    u = result.U
    try:
        check = check_hand_eye(
            result.rotations,
            result.rotation_covariance,
            readings.angles_deg,
            reading_sigma_deg=readings.reading_sigma_deg,
            scale_sigma=math.hypot(readings.scale_sigma, math.radians(readings.eccentricity_deg)),
            focal_uncertainty=max(u[name] / result.values[name] for name in ("fx", "fy")),
            birge_ratio=result.birge_ratio,
            names=[view.name for view in result.views],
        )
    except CalibrationError:  # too few poses, or axes that did not move
        return ()
    if check.reversed_axes:
        return (
            Cause(
                kinds.REVERSED,
                LARGEST_EVIDENCE,
                axis=kinds.one_of(check.reversed_axes),
                beside=(kinds.EXCHANGED,) if len(check.reversed_axes) > 1 else (),
                explains=(READINGS,),
            ),
        )
    if check.faults:
        return tuple(_of_fault(check, fault) for fault in check.faults if fault.kind in _FAULTS)
    return _of_scale(check)


def _contradicts(gimbal: GimbalEstimate | None) -> bool:
    """Return whether readings contradict the stars: they did not enter, or scatter, or the camera looks backwards."""
    if gimbal is None:
        return False
    mounting = exp_map(np.radians([gimbal.values.get(name, 0.0) for name in MOUNTING]))
    return not gimbal.entered or gimbal.scatter >= SCATTER or bool(mounting[2, 2] < 0.0)


def _far_scales(result: Calibration, readings: GimbalReadings) -> tuple[Cause, ...]:
    """Return the axes whose scale is so wrong that no other fault is looked for, by the angles between the poses."""
    angles = angles_of(readings.angles_deg)
    free = tuple(np.flatnonzero(np.ptp(angles, axis=0) > _MOVED_DEG).tolist())
    if 3 * len(angles) <= 6 + len(free) or not free:
        return ()
    ratios = dict(zip(free, first_scales(result.rotations, GimbalModel(angles, free)).tolist(), strict=True))
    return tuple(
        Cause(kinds.AXIS_SCALE, LARGEST_EVIDENCE, value=ratio, axis=_axis(AXES[k]), explains=(READINGS,))
        for k, ratio in ratios.items()
        if abs(math.log(ratio)) > _FAR_SCALE
    )


def _axis(name: str) -> str:
    """Return the name of an axis without its unit."""
    return name.removesuffix("_deg")


def _of_fault(check: HandEyeCheck, fault: GimbalFault) -> Cause:
    """Return a fault of the gimbal as a cause. A step at the first or last pose is one pose that does not fit."""
    names, last = check.names, len(check.names) - 1
    rivals = {_FAULTS[fault.rival]} if fault.rival in _FAULTS else set()
    if fault.kind == "pose" and fault.pose in (0, last):
        rivals |= {kinds.TURNED}
    return Cause(
        _FAULTS[fault.kind],
        _two_log_odds(fault.probability),
        value=fault.size_deg,
        expanded=2.0 * fault.sigma_deg,
        unit="degrees",
        axis=_axis(AXES[fault.axis]) if fault.kind == "slip" else "",
        before=names[fault.pose - 1] if fault.kind != "pose" else "",
        pose=names[fault.pose],
        beside=tuple(sorted(rivals)),
        explains=(READINGS,),
    )


def _of_scale(check: HandEyeCheck) -> tuple[Cause, ...]:
    """Return the scale of the axis that is farthest from 1, if no parallax imitates it."""
    if check.verdict.kind != "gimbal_scale" or not check.scale:
        return ()
    axis = max(check.scale, key=lambda name: abs(check.scale[name] - 1.0))
    value, sigma = check.scale[axis], check.scale_sigma[axis]
    evidence = min(((value - 1.0) / sigma) ** 2, LARGEST_EVIDENCE)
    return (
        Cause(
            kinds.AXIS_SCALE,
            evidence,
            value=value,
            expanded=2.0 * sigma,
            axis=_axis(axis),
            explains=(READINGS,),
        ),
    )
