"""What a person did to a bench while it recorded, or stated wrongly: hypotheses beside those of the statements.

Each is weighed against the same views with the faults of statements that the engine knows, by its likelihood ratio and
the number of places where it is looked for. A statement that is at fault only without the cause is not accused.
"""

from __future__ import annotations

import math
from dataclasses import replace

from calib.calibration import Calibration, CalibrationOptions
from calib.diagnosis.hand_eye import PARALLAX as PARALLAX_SIGMA
from calib.diagnosis.hand_eye import check_hand_eye
from calib.errors import CalibrationError
from calib.model import cause as kinds
from calib.model.cause import PARALLAX, Cause
from calib.model.type_b_terms import SCALES

from .hypotheses import FOCAL
from .knowledge import CERTIFICATE, ORTHOGONAL, READINGS, SCALE_OF
from .posterior import Posterior
from .witnesses import two_log_odds

#: A cause that takes the place of accusations is more probable than not; beside it stands what is not 20 times less so.
_MORE_PROBABLE, _BESIDE = 0.5, 0.05
#: Certificates are right to this share: beyond it, the target is wrong more often.
_CERTIFIED = 1e-3
#: What readings seem to contradict.
_OF_GIMBAL = (READINGS, ORTHOGONAL, *(SCALE_OF.format(axis) for axis in ("pan", "tilt", "roll")))


def find_causes(
    result: Calibration, first: Posterior, focus: Cause | None, stated: CalibrationOptions
) -> tuple[Cause, ...]:
    """Return the causes that the data show, the most probable first; ``stated`` are the options with the readings."""
    of_views = (focus,) if focus else _other_scale(first, stated)
    causes = (*_of_gimbal(result, stated), *of_views)
    return tuple(sorted(causes, key=lambda cause: -cause.evidence))


def _other_scale(first: Posterior, stated: CalibrationOptions) -> tuple[Cause, ...]:
    """Return the cause if the certified radius alone contradicts the views: another pitch looks the same."""
    scales = {term.name for term in stated.budget if term.kind in SCALES}
    certificate = next((s for s in first.problem.unknowns.statements if s.name == CERTIFICATE), None)
    if certificate is None:
        return ()
    length = {CERTIFICATE, *scales}

    def doubted(names: set[str]) -> float:
        wrong = ({name for name, fault in each.faults if fault != FOCAL} for each in first.odds)
        return sum(p for p, faults in zip(first.odds.values(), wrong, strict=True) if names & faults)

    # Small changes of the scale, parallax can imitate; then both are told together.
    share, parallax = doubted(length), doubted({PARALLAX})
    if doubted({*length, PARALLAX}) < _MORE_PROBABLE or share < _BESIDE * parallax:
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
    beside = (CERTIFICATE, PARALLAX) if parallax > _BESIDE * share else (CERTIFICATE,)
    evidence = two_log_odds(1.0 - doubted({*length, *beside}))
    return (
        Cause(
            kinds.SCALED,
            evidence,
            value=ratio,
            expanded=2.0 * sigma,
            stated=r_mm,
            beside=beside,
            explains=(*sorted(length), *beside[1:]),
        ),
    )


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
