"""Aberrations of real collimators: each displaces the points of the target.

The terms are those of third-order aberration theory (Born and Wolf, Principles of Optics, chapter 5), with the camera's
position in the pupil given by the centre of the view's visible disc. Let h be the field of a point and b the centre of
the disc, both from the reference centre in units of r; let g = h - b; let rho be the distance of the point from the
centre of the disc in units of its radius; let t be the tangents of the camera's turn, that is, of its optical axis in
the target's frame. A unit coefficient displaces the point by r times:

=================  ==================  ===========================================================================
``pupil_shift``    b                   reticle out of focus: the centre moves with the camera's position in the pupil
``radial``         |h|^2 h             distortion of the collimator, or a bowed reticle
``radial_4``       |h|^4 h             the same, next order
``parallax_x``     (t_x, 0)            the camera's pupil moves across the beam as the camera turns
``parallax_y``     (0, t_y)            the same along y
``field_curve``    |h|^2 b             focus varies over the field
``tilt_x, _y``     h_x b, h_y b        reticle tilted: focus varies across it
``coma``           (h . b) b           magnification varies over the pupil, along b
``coma_round``     |b|^2 h             magnification varies over the pupil, in all directions
``astigmatism``    (h . b) h           focus differs along and across the field
``rim_4, rim_10``  rho^4 g, rho^10 g   the rim of the beam fills the camera's pupil only partly
=================  ==================  ===========================================================================

All displacements are linear in the coefficients, and the reference is fixed, so they enter the adjustment as constant
arrays.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from calib.errors import InputMismatch
from calib.model.beam import Disc

Array = NDArray[np.float64]

#: Prior 1-sigma about zero of each coefficient: its typical size in real collimators. Twenty views overrule it; with
#: three views it prevents that coefficients follow the noise.
EXPECTED_SIGMA: Mapping[str, float] = {
    "pupil_shift": 0.2,
    "radial": 0.05,
    "radial_4": 1.0,
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
#: The ladder of collimator models. From ``pupil`` on, each model has all aberrations of the model before it.
LADDER: Mapping[str, tuple[str, ...]] = {
    "spherical": (),
    "radial": ("radial", "radial_4"),
    "pupil": ("pupil_shift",),
    "rim": _RIM,
    "field": _FIELD,
    "coma": (*_FIELD, "coma", "coma_round"),
}


#: Terms that follow from the place in the field alone, so that the rim of the beam need not be in view.
FIELD_ONLY = frozenset({"radial", "radial_4"})
#: Terms that the gimbal's readings separate from the focal length.
PARALLAX = ("parallax_x", "parallax_y")


def needs_rim(terms: Iterable[str]) -> bool:
    """Tell whether aberrations depend on the camera's position in the pupil, which the rim of the beam shows.

    Returns: True if any of them needs the visible disc.
    """
    return bool(set(terms) - FIELD_ONLY - set(PARALLAX))


def displacements(
    target_mm: Array,
    disc: Disc | None,
    reference: tuple[float, float, float],
    terms: Sequence[str],
    turn: tuple[float, float] = (0.0, 0.0),
) -> Array:
    """Return the displacement of each star by a unit of each coefficient.

    The third-order terms are those of Born and Wolf, chapter 5. The choice of terms and the terms of the rim are this
    project's own; the head of the module gives all equations.

    target_mm: (N, 2) positions of the view's stars on the target, mm.
    disc: The view's visible disc; None if no term needs it (`needs_rim`).
    reference: Centre (x, y, r), mm, about which the terms are expressed.
    terms: T names from `EXPECTED_SIGMA` or `PARALLAX`.
    turn: Tangents of the camera's turn along the target's X and Y, for the terms of `PARALLAX`.
    Returns: (N, 2, T) displacements, mm.
    Raises InputMismatch: If a term is unknown.
    """
    x, y, r = reference
    h = (target_mm - [x, y]) / r
    b = np.broadcast_to((disc.centre_mm - [x, y]) / r if disc else np.zeros(2), h.shape)
    g = h - b
    h2, b2, hb = ((u * v).sum(axis=1, keepdims=True) for u, v in ((h, h), (b, b), (h, b)))
    rho = np.linalg.norm(g, axis=1, keepdims=True) * r / (disc.radius_mm if disc else r)
    shapes = {
        "pupil_shift": b,
        "radial": h2 * h,
        "radial_4": h2**2 * h,
        "parallax_x": np.broadcast_to([turn[0], 0.0], h.shape),
        "parallax_y": np.broadcast_to([0.0, turn[1]], h.shape),
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
            f"Unknown aberration {unknown[0]!r}.", remedy=f"Known: {', '.join(EXPECTED_SIGMA)}."
        )
    if not terms:
        return np.zeros((len(h), 2, 0))
    return r * np.stack([shapes[name] for name in terms], axis=2)
