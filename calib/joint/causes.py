"""What a person did to a bench while it recorded, or stated wrongly: hypotheses beside those of the statements.

Each is weighed against the same views with the faults of statements that the engine knows, by its likelihood ratio and
the number of places where it is looked for. A statement that is at fault only without the cause is not accused.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calib.calibration import Calibration, CalibrationOptions
from calib.diagnosis.hand_eye import PARALLAX as PARALLAX_SIGMA
from calib.diagnosis.hand_eye import check_hand_eye
from calib.errors import CalibrationError
from calib.joint.effects.collimator import CENTRE
from calib.joint.evidence import two_log
from calib.joint.knowledge import CERTIFICATE, DOUBTED, FOCAL, ORTHOGONAL, READINGS, SCALE_OF
from calib.joint.posterior import Posterior
from calib.model import cause as kinds
from calib.model.cause import LARGEST_EVIDENCE, PARALLAX, Cause
from calib.model.type_b_terms import SCALES

#: A cause that takes the place of accusations is more probable than not.
_MORE_PROBABLE = 0.5
#: Certificates are right to this share: beyond it, the target is wrong more often.
_CERTIFIED = 1e-3
#: What readings seem to contradict.
_OF_GIMBAL = (READINGS, ORTHOGONAL, *(SCALE_OF.format(axis) for axis in ("pan", "tilt", "roll")))


def find_causes(
    result: Calibration, posterior: Posterior, of_views: Sequence[Cause | None], stated: CalibrationOptions
) -> tuple[Cause, ...]:
    """Return the causes that the data show, the most probable first.

    ``of_views`` are those that the stars show, ``stated`` the options with the readings. Shifted ids make all else look
    wrong.
    """
    found = [cause for cause in of_views if cause is not None]
    ids = [cause for cause in found if cause.kind == kinds.IDS]
    causes = ids or [*_of_gimbal(result, posterior, stated), *_other_scale(posterior, stated), *found]
    causes = [replace(cause, evidence=min(cause.evidence, LARGEST_EVIDENCE)) for cause in causes]
    return tuple(sorted(causes, key=lambda cause: -cause.evidence))


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
    cause = Cause(
        kinds.SCALED, two_log(share) - two_log(1.0 - share), value=ratio, expanded=2.0 * sigma, stated=r_mm
    )
    # Small changes of the scale, parallax can imitate; then both are told together.
    parallax = (PARALLAX,) if DOUBTED <= posterior.faults.get(PARALLAX, 0.0) < _MORE_PROBABLE else ()
    return (replace(cause, beside=(CERTIFICATE, *parallax), explains=(*sorted(length), *parallax)),)


def _of_gimbal(result: Calibration, posterior: Posterior, stated: CalibrationOptions) -> tuple[Cause, ...]:
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
            times=posterior.optimum.marginal.problem.bench.times,
        )
    except CalibrationError:  # too few poses, or axes that did not move
        return ()
    # What is more probably errors of the collimator accuses nobody, unless the readings contradict the stars.
    accused = not check.is_smooth or (result.gimbal is not None and not result.gimbal.entered)
    causes = [cause for cause in check.causes if accused or kinds.BIASED not in cause.beside]
    # How many times more than stated readings scatter, and with what weight they entered, stays to be said.
    return tuple(replace(cause, explains=_OF_GIMBAL[cause.kind == kinds.SCATTERED :]) for cause in causes)
