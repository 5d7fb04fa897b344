"""Notes of the joint adjustment for its reader, and the refusal of views that do not determine the camera."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.adjustment.parameters import (
    MAX_FOCAL_SIGMA,
    AdjustmentParameters,
    explain_weak_geometry,
    require_distinct_poses,
)
from calib.calibration import Calibration, CalibrationOptions
from calib.errors import DegenerateViews, NotConverged
from calib.joint.hypotheses import OTHER_OPTIMUM
from calib.joint.knowledge import CERTIFICATE, DOUBTED, FOCAL, READINGS
from calib.joint.posterior import Posterior
from calib.joint.readings import SCATTER
from calib.model import result_parts as rows
from calib.model.cause import PARALLAX, Cause, cause_sentence
from calib.model.gimbal import MOUNTING
from calib.model.result_parts import Witness
from calib.model.rotation import exp_map
from calib.view import View

#: A focal length is poorly known from this share on, by its U.
_WEAK_FOCAL = 0.02
#: Which length a certificate states is open if the less probable one has this share: beyond it, U depends on both.
_OPEN = 0.1
#: If these have this share of the variance of fx, it rests on how large errors are expected. With a certificate it is
#: below 0.22 in 41 of 42 drawn benches.
_EXPECTED = rows.UNBOUNDED_PARALLAX, rows.TURN_FIELDS, rows.LENS, rows.AMPLITUDES
_EXPECTED_SHARE = 0.4
#: A certificate is named, too, if all others say another length by so many sigmas, and larger errors explain that.
#: Right ones are within 1.7 on eleven ray-traced benches.
_APART = 4.0
#: Visible discs show how far the pupil moves if its logarithm is known to this, 1-sigma.
_SEEN = 0.5
_BACKWARDS = (
    "The sign of one axis, pan or tilt, is probably wrong: with it, the gimbal's readings contradict the stars; with "
    "the other sign, they fit."
)
_TOGETHER = (
    "These statements contradict each other or the stars. What cannot be decided is in the uncertainties."
)
_BINDS = {
    "r": "a certificate of the collimator, readings of the gimbal, or poses turned farther",
    "x": "a passport of the collimator, or poses turned farther",
    "y": "a passport of the collimator, or poses turned farther",
    "cx": "poses turned to both sides along X, or rolled",
    "cy": "poses turned to both sides along Y, or rolled",
    "fx": "poses turned farther",
    "fy": "poses turned farther",
}


def require_determined(
    posterior: Posterior,
    views: Sequence[View],
    parameters: AdjustmentParameters,
    options: CalibrationOptions,
    shifted: Cause | None = None,
) -> None:
    """Refuse views that know a focal length to no better than 5 % (1-sigma), or an adjustment without an optimum.

    The error names ids that are ``shifted`` as the cause, if there are any; else the unknown that nothing binds.
    """
    if options.passport is None:
        require_distinct_poses(parameters)
    sigmas = np.sqrt(np.diag(posterior.covariance))
    weak = explain_weak_geometry(views, parameters)  # then nothing else is determined: no lens, no ids
    doubt = cause_sentence(shifted) if shifted else ""
    cause = "" if weak else _lens(posterior) or doubt  # a lens of another family looks like shifted ids, too
    why = weak or cause
    for k, name in enumerate(("fx", "fy")):
        share = float(sigmas[k] / posterior.mean[k])
        if not 0.0 <= share <= MAX_FOCAL_SIGMA:
            free = _free_unknown(posterior, k)
            raise DegenerateViews(
                f"These views determine {name} only to ±{200.0 * share:.0f} % (k = 2). {why}".strip(),
                remedy=""
                if cause
                else f"Nothing binds {free}: {_BINDS.get(free, 'more poses')} would."
                " Add views turned about other axes, with the stars elsewhere in the image.",
            )
    if not posterior.optimum.converged:
        raise NotConverged(
            f"The adjustment did not converge within {posterior.optimum.iterations} steps. {why}".strip(),
            remedy="" if cause else "Add views from other angles.",
        )


def _free_unknown(posterior: Posterior, at: int) -> str:
    """Return the unknown whose mere limit contributes most to the variance of another."""
    problem, slope = posterior.optimum.marginal.problem, posterior.optimum.solution.covariance[:, at]
    limits = [statement for statement in problem.knowledge.statements if statement.name == rows.PRIORS]
    widest = max(limits, key=lambda limit: float((limit.rows @ slope)[0] ** 2 / limit.covariance[0, 0]))
    return problem.bench.layout.names[int(np.argmax(widest.rows[0]))]


def notes(result: Calibration, posterior: Posterior) -> tuple[str, ...]:
    """Return what a reader must know: weak geometry, statements that others contradict, readings that scatter."""
    explained, length = {name for cause in result.causes for name in cause.explains}, _length(posterior)
    named = [
        witness
        for witness in result.witnesses
        if witness.name not in {READINGS, *explained}
        and (
            witness.fault_probability >= DOUBTED
            or (witness.name == CERTIFICATE and abs(witness.innovation) >= _APART and not length)
        )
    ]
    named.sort(key=lambda witness: (-witness.fault_probability, -abs(witness.innovation)))
    together = "" if len(named) < 2 else _TOGETHER
    sentences = [*map(cause_sentence, result.causes), _lens(posterior) or _weakness(result, posterior)]
    sentences += [*map(_doubt, named), together]
    if READINGS not in explained:
        sentences += [_readings(result), _contradiction(result)]
    sentences += [
        _two_optima(posterior),
        length,
        "" if PARALLAX in explained else _denied(posterior),
        _expected(result, posterior),
    ]
    return tuple(filter(None, sentences))


def _lens(posterior: Posterior) -> str:
    """Return a note if the other family of lenses explains the views far better; empty if not, as all here."""
    better = posterior.better_lens
    if not better:
        return ""
    return (
        f"The lens is of another model: the distortion {better} explains these views far better, so this camera is "
        "probably wrong. Calibrate again with that distortion."
    )


def _doubt(witness: Witness) -> str:
    """Return the sentence that names a statement."""
    source = "" if witness.source == witness.name else f" ({witness.source})"
    what = f"The statement '{witness.name}'{source}"
    probability = (
        f"it is wrong, or its uncertainty too small, with probability {witness.fault_probability:.0%}"
        if witness.fault_probability >= DOUBTED
        else "this result holds it, and supposes that errors of the bench are larger than expected"
    )
    if witness.stated is None:
        return (
            f"{what} differs by {abs(witness.innovation):.1f} sigma from what all others say; {probability}."
        )
    unit = f" {witness.unit}" if witness.unit not in ("", "1") else ""
    return (
        f"{what} says {witness.stated:.6g} +- {witness.sigma:.2g}{unit}; all others say {witness.expected:.6g} +- "
        f"{witness.expected_sigma:.2g}{unit}, {abs(witness.innovation):.1f} sigma away; {probability}."
    )


def _length(posterior: Posterior) -> str:
    """Return a note if the views do not show which length a certificate states."""
    share = posterior.share_of((CERTIFICATE, FOCAL))
    if not _OPEN < share < 1.0 - _OPEN:
        return ""
    return (
        "The certificate of the collimator does not say which length it states. By what the views show, it is the "
        f"focal length with a probability of {share:.0%}, and else the length that this camera sees. The uncertainties "
        "cover both. State which one it is (length: focal_length or seen)."
    )


def _two_optima(posterior: Posterior) -> str:
    """Return a note if searches from two starts ended at cameras that explain the views nearly as well."""
    optima = [
        (share, float(part.optimum.state.shared[0]))
        for part, share, hypothesis in posterior.explanations
        if hypothesis in (None, OTHER_OPTIMUM)
    ]
    if len(optima) == 1 or max(share for share, _ in optima[1:]) < _OPEN:
        return ""
    cameras = ", or ".join(f"fx is {fx:.5g} px with a probability of {share:.0%}" for share, fx in optima)
    return (
        f"Two searches ended at different cameras that explain these views: {cameras}. The uncertainties cover both. "
        "A certificate of the collimator, readings of the gimbal, or poses turned farther would decide."
    )


def _denied(posterior: Posterior) -> str:
    """Say what to do if the bound of the parallax is probably wrong."""
    if posterior.denied is None:
        return ""
    return (
        "The bound on the place of the entrance pupil is probably wrong: the rim of the beam and the stars contradict "
        "it. It has little weight in this result. Measure how far the pupil is in front of the pivot, or leave the "
        "bound out of the station."
    )


def _weakness(result: Calibration, posterior: Posterior) -> str:
    """Return a note if a focal length is poorly determined."""
    relative = {name: result.U[name] / getattr(result.camera, name) for name in ("fx", "fy")}
    name = max(relative, key=lambda focal: relative[focal])
    if relative[name] < _WEAK_FOCAL:
        return ""
    free = _free_unknown(posterior, 0)
    return (
        f"Weak geometry: {name} is known only to ±{100.0 * relative[name]:.1f} % (95 %). "
        f"{_BINDS[free][0].upper()}{_BINDS[free][1:]} would bind it."
    )


def _readings(result: Calibration) -> str:
    """Return what the reader must know about the gimbal's readings."""
    gimbal = result.gimbal
    if gimbal is None or not gimbal.entered:
        return ""
    mounting = exp_map(np.radians([gimbal.values[name] for name in MOUNTING]))
    if mounting[2, 2] < 0:
        return _BACKWARDS
    if gimbal.scatter < SCATTER:
        return ""
    return (
        f"The gimbal's readings scatter {gimbal.scatter:.1f} times more than stated. They entered with "
        f"{gimbal.reading_sigma_deg:.4f} degrees each."
    )


def _contradiction(result: Calibration) -> str:
    """Return a note on readings that did not enter."""
    gimbal = result.gimbal
    if gimbal is None or gimbal.entered:
        return ""
    return (
        f"The gimbal's readings contradict the stars: {gimbal.rms_deg:.3f} degrees rms, chi-square "
        f"{gimbal.chi_square:.0f} with {gimbal.degrees_of_freedom} degrees of freedom. They did not enter. Either the "
        "readings are wrong: check the sign and the scale of each axis, whether each axis that moved is read, and "
        "whether one slipped. Or the camera moves across the beam from pose to pose, and the collimator's errors move "
        "with it: check what the station states of pupil and pivot."
    )


def _expected(result: Calibration, posterior: Posterior) -> str:
    """Return a note if the focal length rests on how large errors by turn are expected, which nothing states."""
    shares = {row.name: row.share.get("fx", 0.0) for row in result.budget_rows}
    if (
        rows.UNBOUNDED_PARALLAX not in shares
        or sum(shares.get(name, 0.0) for name in _EXPECTED) < _EXPECTED_SHARE
    ):
        return ""
    note = (
        "What is stated of collimator and gimbal does not determine the focal length. So it rests on how large the "
        "parallax, and other errors that follow the turn, are expected to be. The uncertainties include them."
    )
    problem = posterior.optimum.marginal.problem
    lever, r_mm = problem.hyper.lever, problem.bench.layout.basis.reference[2]
    if lever.spread < _SEEN:
        return note
    return (
        f"{note} No visible rim of the beam shows how the entrance pupil moves. The pupil is expected some "
        f"{lever.middle * r_mm:.0f} mm from the pivot. If it is more than twice as far away, the focal length can be "
        "wrong by several times its uncertainty. State pupil_off_pivot_mm and defocus in the station, even roughly."
    )
