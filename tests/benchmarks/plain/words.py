"""Notes of the adjustment for its reader, and the refusal of views that do not determine the camera."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.adjustment.parameters import (
    MAX_FOCAL_SIGMA,
    AdjustmentParameters,
    explain_weak_geometry,
    require_distinct_poses,
)
from calib.calibration import Calibration
from calib.errors import DegenerateViews, InputMismatch, NotConverged
from calib.model import result_parts as rows
from calib.model.cause import PARALLAX, cause_sentence, probability
from calib.model.gimbal import MOUNTING
from calib.model.result_parts import Witness
from calib.model.rotation import exp_map
from calib.view import View

from .hypotheses import FOCAL
from .knowledge import CERTIFICATE, READINGS
from .mixture import Mixture, quantities
from .posterior import Posterior
from .witnesses import fault_probabilities

#: A statement is named if it is doubted with this probability. An honest one is named at 2.8 sigma.
DOUBTED = 0.2
#: A certificate is named if it is so many sigma from what the stars say alone, however probable its fault is: errors of
#: the glass that are larger than expected could explain it.
_FAR_AWAY = 4.0
#: Readings that scatter this many times more than stated are looked at.
SCATTER = 2.0
#: A certificate is refused if it is wrong with this probability, and differs by the second number, as a share.
_SURELY, _OTHER_RADIUS = 0.99, 0.1
#: A focal length is poorly known from this share on, by its U.
_WEAK_FOCAL = 0.02
#: Which length a certificate states is open if the less probable one has this share: beyond it, U depends on both.
_OPEN, _MORE_PROBABLE = 0.1, 0.5
#: If these have this share of the variance of fx, it rests on how large errors are expected. With a certificate it is
#: below 0.22 in 41 of 42 drawn benches.
_EXPECTED = rows.UNBOUNDED_PARALLAX, rows.TURN_FIELDS, rows.LENS, rows.AMPLITUDES
_EXPECTED_SHARE = 0.4
#: Visible discs show how far the pupil moves if its logarithm is known to this, 1-sigma.
_SEEN = 0.5
_BACKWARDS = (
    "The sign of one axis, pan or tilt, is probably wrong: with it, the gimbal's readings contradict the stars; with "
    "the other sign, they fit."
)
_TOGETHER = (
    "These statements contradict each other or the stars. What cannot be decided is in the uncertainties."
)
_DENIED = (
    "The bound on the place of the entrance pupil is probably wrong: the rim of the beam and the stars contradict "
    "it. It has little weight in this result. Measure how far the pupil is in front of the pivot, or leave the "
    "bound out of the station."
)
_BINDS = {
    "r": "a certificate of the collimator, readings of the gimbal, or poses turned farther",
    "x y": "a passport of the collimator, or poses turned farther",
    "centre x": "poses turned to both sides along X, or rolled",
    "centre y": "poses turned to both sides along Y, or rolled",
    "log f": "poses turned farther",
}
#: Names of the unknowns that limits hold, as a reader knows them.
_READERS = {"x y": "the axis of the collimator", "centre x": "cx", "centre y": "cy", "log f": "fx"}


def require_determined(
    mixture: Mixture, views: Sequence[View], parameters: AdjustmentParameters, *, known: bool, doubt: str = ""
) -> None:
    """Refuse views that know a focal length to no better than 5 % (1-sigma), or an adjustment without an optimum.

    ``known``: whether a passport or certificate is stated. The error names a ``doubt`` about the data as the cause, if
    there is one; else the unknown that nothing binds.
    """
    if not known:
        require_distinct_poses(parameters)
    sigmas = np.sqrt(np.diag(mixture.covariance))
    weak = explain_weak_geometry(views, parameters)  # then nothing else is determined: no lens, no ids
    cause = "" if weak else doubt
    why = weak or cause
    for k, name in enumerate(("fx", "fy")):
        share = float(sigmas[k] / mixture.mean[k])
        if not 0.0 <= share <= MAX_FOCAL_SIGMA:
            free = free_unknown(mixture)
            raise DegenerateViews(
                f"These views determine {name} only to ±{200.0 * share:.0f} % (k = 2). {why}".strip(),
                remedy=""
                if cause
                else f"Nothing binds {_READERS.get(free, free)}: {_BINDS.get(free, 'more poses')} would."
                " Add views turned about other axes, with the stars elsewhere in the image.",
            )
    optimum = mixture.first.optimum
    if not optimum.converged:
        raise NotConverged(
            f"The adjustment did not converge within {optimum.rounds} steps. {why}".strip(),
            remedy="" if cause else "Add views from other angles.",
        )


def require_own_certificate(mixture: Mixture, doubt: str) -> None:
    """Refuse a certificate of another collimator: the views alone show a radius that is far from it."""
    posterior = mixture.first
    stated = next((s for s in posterior.problem.unknowns.statements if s.name == CERTIFICATE), None)
    wrong = fault_probabilities(posterior).get(CERTIFICATE, 0.0)
    if stated is None or wrong < _SURELY:
        return
    r_mm = float(mixture.mean[mixture.places(("r",))[0]])
    if abs(stated.stated - r_mm) < _OTHER_RADIUS * r_mm:
        return
    why = doubt or (
        f"The pitch of the target is probably {stated.stated / r_mm:.3g} times the stated one, or another target "
        "is in the collimator. A certificate of another collimator looks the same."
    )
    raise InputMismatch(
        f"The certificate of the collimator says {stated.stated:.6g} mm; "
        f"the views alone show about {r_mm:.3g} mm. {why}",
        remedy="" if doubt else "Check pitch and target, then the certificate.",
    )


def free_unknown(mixture: Mixture) -> str:
    """Return the unknown whose mere limit contributes most to the variance of the focal length."""
    solution, unknowns = mixture.first.largest.solution, mixture.problem.unknowns
    parts = {
        name: float(
            solution.covariance[unknowns.places(name), 0] ** 2 @ solution.prior.shared[unknowns.places(name)]
        )
        for name in _BINDS
        if len(unknowns.places(name))
    }
    return max(parts, key=lambda name: parts[name])


def notes(result: Calibration, mixture: Mixture, better_lens: str = "") -> tuple[str, ...]:
    """Return what a reader must know: weak geometry, statements that others contradict, readings that scatter."""
    explained = {name for cause in result.causes for name in cause.explains}
    named = [
        witness
        for witness in result.witnesses
        if witness.name not in {READINGS, *explained}
        and (witness.fault_probability >= DOUBTED or (witness.name == CERTIFICATE and _is_far(witness)))
    ]
    named.sort(key=lambda witness: (-witness.fault_probability, -abs(witness.innovation)))
    together = "" if len(named) < 2 else _TOGETHER
    sentences = [*map(cause_sentence, result.causes), lens_note(better_lens) or _weakness(result, mixture)]
    sentences += [*map(_doubt, named), together, _DENIED if mixture.no_bound > _MORE_PROBABLE else ""]
    if READINGS not in explained:
        sentences += [_readings(result), _contradiction(result)]
    sentences += [_length(mixture.first), _cameras(mixture), _expected(result, mixture.first)]
    return tuple(filter(None, sentences))


def _is_far(witness: Witness) -> bool:
    """Return whether a statement is far from what all others say, though larger errors of the glass may explain it."""
    return abs(witness.innovation) > _FAR_AWAY


def lens_note(better: str) -> str:
    """Return a note if the other family of lenses explains the views far better; empty if not, as all here."""
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
    wrong = f"it is wrong, or its uncertainty too small, with probability {probability(witness.fault_probability)}"
    if witness.stated is None:
        return f"{what} differs by {abs(witness.innovation):.1f} sigma from what all others say; {wrong}."
    unit = f" {witness.unit}" if witness.unit not in ("", "1") else ""
    return (
        f"{what} says {witness.stated:.6g} +- {witness.sigma:.2g}{unit}; all others say {witness.expected:.6g} +- "
        f"{witness.expected_sigma:.2g}{unit}, {abs(witness.innovation):.1f} sigma away; {wrong}."
    )


def _length(posterior: Posterior) -> str:
    """Return a note if the views do not show which length a certificate states."""
    share = sum(p for hypothesis, p in posterior.odds.items() if (CERTIFICATE, FOCAL) in hypothesis.faults)
    if not _OPEN < share < 1.0 - _OPEN:
        return ""
    return (
        "The certificate of the collimator does not say which length it states. By what the views show, it is the "
        f"focal length with a probability of {share:.0%}, and else the length that this camera sees. The uncertainties "
        "cover both. State which one it is (length: focal_length or seen)."
    )


def _cameras(mixture: Mixture) -> str:
    """Return a note if searches ended at different cameras that explain the views about as well."""
    at = mixture.names.index("fx")
    fx = [(part.share, part.posterior) for part in mixture.parts if part.row in ("", rows.AMPLITUDES)]
    if len(fx) == 1 or max(share for share, _ in fx[1:]) < _OPEN:
        return ""
    values = [quantities(one.problem, one.mean).values[at] for _, one in fx]
    cameras = ", or ".join(
        f"fx is {value:.5g} px with a probability of {probability(share)}"
        for value, (share, _) in zip(values, fx, strict=True)
    )
    return (
        f"Two searches ended at different cameras that explain these views: {cameras}. The uncertainties cover both. "
        "A certificate of the collimator, readings of the gimbal, or poses turned farther would decide."
    )


def _weakness(result: Calibration, mixture: Mixture) -> str:
    """Return a note if a focal length is poorly determined."""
    relative = {name: result.U[name] / getattr(result.camera, name) for name in ("fx", "fy")}
    name = max(relative, key=lambda focal: relative[focal])
    if relative[name] < _WEAK_FOCAL:
        return ""
    binds = _BINDS[free_unknown(mixture)]
    return (
        f"Weak geometry: {name} is known only to ±{100.0 * relative[name]:.1f} % (95 %). "
        f"{binds[0].upper()}{binds[1:]} would bind it."
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
        or PARALLAX in shares
    ):
        return ""
    note = (
        "What is stated of collimator and gimbal does not determine the focal length. So it rests on how large the "
        "parallax, and other errors that follow the turn, are expected to be. The uncertainties include them."
    )
    problem = posterior.problem
    lever, r_mm = problem.lever, problem.fields.r0
    if lever.spread < _SEEN:
        return note
    return (
        f"{note} No visible rim of the beam shows how the entrance pupil moves. The pupil is expected some "
        f"{lever.middle * r_mm:.0f} mm from the pivot. If it is more than twice as far away, the focal length can be "
        "wrong by several times its uncertainty. State pupil_off_pivot_mm and defocus in the station, even roughly."
    )
