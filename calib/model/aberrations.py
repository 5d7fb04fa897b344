"""How real collimators depart from the spherical model: each departure a displacement of the target's points.

Knows third-order aberration theory, and where in the pupil a view's camera stands (the centre of its visible
disc). With h a point's field and b the disc's centre, both in units of r about the reference centre, g = h - b, and
rho the point's distance from the disc's centre in units of its radius, a unit coefficient displaces the point by r
times:

=================  ==================  ==========================================================================
``pupil_shift``    b                   reticle out of focus: the centre moves with the camera's place in the pupil
``radial``         |h|^2 h             the collimator's distortion, or a bowed reticle
``field_curve``    |h|^2 b             focus varies over the field
``tilt_x, _y``     h_x b, h_y b        reticle tilted: focus varies across it
``coma``           (h . b) b           magnification differs over the pupil, along b
``coma_round``     |b|^2 h             the same, in all directions
``astigmatism``    (h . b) h           focus differs along and across the field
``rim_4, rim_10``  rho^4 g, rho^10 g   the camera's pupil only partly filled by the beam's rim
=================  ==================  ==========================================================================

All are linear in their coefficients, and the reference is held, so they enter the refinement as constant arrays.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from calib.errors import InputMismatch
from calib.model.beam import Disc
from calib.model.prior import Prior

Array = NDArray[np.float64]

#: Each coefficient and its size in real collimators: the 1-sigma, about zero, of what is assumed beforehand. So weak
#: that twenty views overrule it, strong enough that three do not follow their noise.
EXPECTED_SIGMA: Mapping[str, float] = {
    "pupil_shift": 0.2,
    "radial": 0.05,
    "field_curve": 0.05,
    "tilt_x": 0.01,
    "tilt_y": 0.01,
    "coma": 0.1,
    "coma_round": 0.05,
    "astigmatism": 0.1,
    "rim_4": 0.005,
    "rim_10": 0.0015,
}
_RIM = ("pupil_shift", "radial", "rim_4", "rim_10")
_FIELD = (*_RIM, "field_curve", "tilt_x", "tilt_y")
#: The ladder of models of a collimator; each rung adds to the one before it.
LADDER: Mapping[str, tuple[str, ...]] = {
    "spherical": (),
    "pupil": ("pupil_shift",),
    "rim": _RIM,
    "field": _FIELD,
    "coma": (*_FIELD, "coma", "coma_round"),
}


def model_with_terms(terms: Sequence[str]) -> str:
    """Return the lowest rung of the ladder that has all the terms; the highest, if none has."""
    return next((name for name, own in LADDER.items() if set(terms) <= set(own)), list(LADDER)[-1])


def aberration_prior(terms: Sequence[str]) -> Prior | None:
    """Return what is assumed of coefficients beforehand; None when there are none."""
    if not terms:
        return None
    information = np.diag([EXPECTED_SIGMA[name] ** -2 for name in terms])
    return Prior(tuple(terms), np.zeros(len(terms)), information)


def displacements(
    target_mm: Array, disc: Disc, reference: tuple[float, float, float], terms: Sequence[str]
) -> Array:
    """Return (N, 2, T) displacement of each star by a unit of each term's coefficient, mm.

    Parameters
    ----------
    target_mm
        (N, 2) the view's stars on the target.
    disc
        The view's visible disc.
    reference
        Centre x, y, r, mm, about which the terms are expressed.
    terms
        Names out of `EXPECTED_SIGMA`.

    Raises
    ------
    InputMismatch
        When a term is unknown.
    """
    x, y, r = reference
    h = (target_mm - [x, y]) / r
    b = np.broadcast_to((disc.centre_mm - [x, y]) / r, h.shape)
    g = h - b
    h2, b2, hb = ((u * v).sum(axis=1, keepdims=True) for u, v in ((h, h), (b, b), (h, b)))
    rho = np.linalg.norm(g, axis=1, keepdims=True) * r / disc.radius_mm
    shapes = {
        "pupil_shift": b,
        "radial": h2 * h,
        "field_curve": h2 * b,
        "tilt_x": h[:, :1] * b,
        "tilt_y": h[:, 1:] * b,
        "coma": hb * b,
        "coma_round": b2 * h,
        "astigmatism": hb * h,
        "rim_4": rho**4 * g,
        "rim_10": rho**10 * g,
    }
    unknown = [name for name in terms if name not in shapes]
    if unknown:
        raise InputMismatch(
            f"Unknown imperfection {unknown[0]!r}.", remedy=f"Known are: {', '.join(EXPECTED_SIGMA)}."
        )
    if not terms:
        return np.zeros((len(h), 2, 0))
    return r * np.stack([shapes[name] for name in terms], axis=2)
