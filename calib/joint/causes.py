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
from calib.diagnosis.hand_eye import PARALLAX as PARALLAX_SIGMA
from calib.diagnosis.hand_eye import check_hand_eye
from calib.errors import CalibrationError
from calib.joint.added_columns import AddedColumns, displaced
from calib.joint.curvature import best_amplitudes
from calib.joint.effects.collimator import CENTRE
from calib.joint.evidence import log_evidence
from calib.joint.hypotheses import FOCUS_STEP
from calib.joint.knowledge import CERTIFICATE, DOUBTED, FOCAL, ORTHOGONAL, READINGS, SCALE_OF
from calib.joint.modes import modes_of
from calib.joint.posterior import Posterior
from calib.joint.solve import Optimum
from calib.model import cause as kinds
from calib.model.cause import LARGEST_EVIDENCE, PARALLAX, Cause
from calib.model.likelihood_ratio import DECISIVE, needed
from calib.model.type_b_terms import SCALES
from calib.view import View

#: Prior 1 sigma of a step of the focal length, as a share: 2 degrees of an ordinary ring. Smaller ones than the second
#: number may come from 3 K of aluminium.
_STEP, _LEAST_STEP = 1e-3, 1e-4
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
#: What readings seem to contradict.
_OF_GIMBAL = (READINGS, ORTHOGONAL, *(SCALE_OF.format(axis) for axis in ("pan", "tilt", "roll")))


def find_causes(
    result: Calibration, posterior: Posterior, views: Sequence[View], stated: CalibrationOptions
) -> tuple[Cause, ...]:
    """Return the causes that the data show, the most probable first; ``stated`` are the options with the readings."""
    steps = _focus_steps(posterior, views)
    scale = () if steps else _other_scale(posterior, stated)
    causes = (*_of_gimbal(result, stated), *steps, *scale)
    return tuple(sorted(causes, key=lambda cause: -cause.evidence))


def _focus_steps(posterior: Posterior, views: Sequence[View]) -> tuple[Cause, ...]:
    """Return the step of the focal length between two views that explains them better than any fault; or none.

    A step displaces focal lengths in the bases of all later views; the equations at the optimum say what that gains.
    """
    optimum, m = posterior.optimum, len(views)
    if m < 3 or len(set(optimum.marginal.problem.bench.poses.tolist())) < 3:
        return ()
    at = optimum.marginal.problem.bench.layout.places(("fx", "fy"))
    columns = np.zeros((m, optimum.marginal.equations.of_views.shape[1], m - 1))
    for k in range(1, m):
        columns[k:, at, k - 1] = optimum.state.shared[at]
    gains = AddedColumns.of(optimum, columns)
    promised = gains.gradient**2 / (np.diag(gains.information) + _STEP**-2)
    places = [place for place in np.argsort(-promised)[:_TRIED].tolist() if promised[place] > _PROMISED]
    first, cost = _at_best(optimum), needed(m - 1) - 2.0 * math.log(FOCUS_STEP.odds)
    steps = {place: _stepped(optimum, columns[:, :, place]) for place in places}
    likely = [
        place
        for place, step in steps.items()
        if abs(step.size) >= _LEAST_STEP
        and first.solution.value - step.optimum.solution.value > step.taken + cost
    ]
    before = log_evidence(modes_of(first), first) if likely else 0.0
    best: Cause | None = None
    for place in likely:
        step = steps[place]
        there = modes_of(step.optimum)
        gained = 2.0 * (log_evidence(there, there.optimum) - before)
        evidence = gained - step.taken - cost + DECISIVE
        if evidence > (best.evidence if best else DECISIVE):
            accused = there.fault_probabilities(there.nodes)
            explains = [name for name, p in posterior.faults.items() if p >= DOUBTED > accused.get(name, 0.0)]
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
        added = AddedColumns.of(there, column[:, :, None])
        information = float(added.information[0, 0])
        size += float(added.gradient[0]) / (information + _STEP**-2)
        solution = displaced(optimum, size * column).solve(there.eta)
        there = _at_best(replace(optimum, solution=solution))
    return _Step(size, 1.0 / math.sqrt(max(information, 1e-300)), there)


def _at_best(optimum: Optimum) -> Optimum:
    """Return an optimum at its best amplitudes, which a long search does not look for at its end."""
    return replace(optimum, solution=best_amplitudes(optimum.solution, _AMPLITUDE_STEPS))


def _other_scale(posterior: Posterior, stated: CalibrationOptions) -> tuple[Cause, ...]:
    """Return the cause if the certified radius alone contradicts the views: another pitch looks the same."""
    scales = {term.name for term in stated.budget if term.kind in SCALES}
    witnesses = posterior.optimum.marginal.problem.knowledge.witnesses
    if CERTIFICATE not in witnesses:
        return ()
    length = {CERTIFICATE, *scales}
    share = sum(
        node.weight
        for node in posterior.nodes
        if length & {name for name, fault in node.faults if fault != FOCAL}
    )
    if share < _MORE_PROBABLE:
        return ()
    layout, r_mm = posterior.optimum.marginal.problem.bench.layout, float(witnesses[CERTIFICATE].values[0])
    row = np.zeros(len(layout.names))
    row[layout.index[CENTRE[2]]] = 1.0
    # A print that is larger than stated looks as one that is nearer.
    row[layout.places([name for name in scales if name in layout.index])] = -r_mm
    ratio = float(row @ posterior.mean) / r_mm
    if abs(ratio - 1.0) < _CERTIFIED:
        return ()
    sigma = math.sqrt(float(row @ posterior.covariance @ row)) / r_mm
    cause = Cause(kinds.SCALED, _two_log_odds(1.0 - share), value=ratio, expanded=2.0 * sigma, stated=r_mm)
    # Small changes of the scale, parallax can imitate; then both are told together.
    parallax = (PARALLAX,) if DOUBTED <= posterior.faults.get(PARALLAX, 0.0) < _MORE_PROBABLE else ()
    return (replace(cause, beside=(CERTIFICATE, *parallax), explains=(*sorted(length), *parallax)),)


def _two_log_odds(against: float) -> float:
    """Return 2 log of the odds for what has a probability against it."""
    return min(2.0 * (math.log1p(-min(against, 0.999)) - math.log(max(against, 1e-30))), LARGEST_EVIDENCE)


def _of_gimbal(result: Calibration, stated: CalibrationOptions) -> tuple[Cause, ...]:
    """Return what explains the readings and the rotations of the stars together."""
    readings = stated.gimbal
    if readings is None or not len(result.rotation_covariance):
        return ()
    bound, centre = readings.parallax, result.collimator
    parallax = math.hypot(*bound.mean_and_sigma(centre.r)) if bound and centre else PARALLAX_SIGMA
    try:
        check = check_hand_eye(
            result.rotations,
            result.rotation_covariance,
            readings.angles_deg,
            reading_sigma_deg=readings.reading_sigma_deg,
            scale_sigma=math.hypot(readings.scale_sigma, math.radians(readings.eccentricity_deg)),
            parallax_sigma=parallax,
            names=[view.name for view in result.views],
        )
    except CalibrationError:  # too few poses, or axes that did not move
        return ()
    # How many times more than stated readings scatter, and with what weight they entered, stays to be said.
    return tuple(
        replace(cause, explains=_OF_GIMBAL[cause.kind == kinds.SCATTERED :]) for cause in check.causes
    )
