"""Terms of the collimator in the adjustment: displacements of the stars by a unit of each aberration.

The displacements are constant arrays about a fixed reference, so that the adjustment is linear in the coefficients.
This module adds them to a bundle; it chooses no model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calib.adjustment.bundle import Bundle
from calib.adjustment.parameters import AdjustmentParameters
from calib.model.aberrations import aberration_prior, displacements
from calib.model.beam import Disc
from calib.model.passport import Passport
from calib.model.prior import joined
from calib.view import View

Array = NDArray[np.float64]


def add_terms(
    views: Sequence[View],
    discs: Sequence[Disc],
    bundle: Bundle,
    start: AdjustmentParameters,
    terms: Sequence[str],
    passport: Passport | None = None,
    radial_sigma: float | None = None,
) -> tuple[Bundle, AdjustmentParameters]:
    """Add aberrations to a bundle: those of a passport at its values, the others free with their prior.

    discs: Their visible discs; none if no term needs them.
    start: Its optimum; its centre becomes the reference if the passport has none.
    radial_sigma: Prior 1-sigma of the radial term, if the bench states it.
    """
    ideal, held = start.collimator, passport.terms if passport else ()
    collimator = passport.collimator(ideal) if passport else ideal
    collimator = replace(
        collimator,
        aberrations={**collimator.aberrations, **dict.fromkeys(terms, 0.0)},
        reference=collimator.reference or (ideal.x, ideal.y, ideal.r),
    )
    if terms:
        prior = joined(bundle.prior, aberration_prior(terms, radial_sigma))
        bundle = replace(bundle, names=(*bundle.names, *terms), prior=prior)
    start = replace(start, collimator=collimator)
    shifts = term_displacements(views, discs, start, (*held, *terms))
    return replace(bundle, displacements=shifts), start


def term_displacements(
    views: Sequence[View], discs: Sequence[Disc], parameters: AdjustmentParameters, terms: Sequence[str]
) -> Array:
    """Return the displacements of all stars by a unit of each aberration.

    The equations are those of `calib.model.aberrations`. The turn of a view is the direction of its optical axis in the
    target's frame.

    discs: Their visible discs; none if no term needs them.
    parameters: The collimator's reference, and the rotations of the views.
    terms: T names of aberrations, in their order in the collimator.
    Returns: (N, 2, T) displacements, mm, view after view.
    """
    reference = parameters.collimator.reference
    assert reference is not None
    axes = parameters.rotations[:, 2]
    return np.concatenate(
        [
            displacements(
                view.target_mm,
                discs[i] if discs else None,
                reference,
                terms,
                (float(axes[i, 0] / axes[i, 2]), float(axes[i, 1] / axes[i, 2])),
            )
            for i, view in enumerate(views)
        ]
    )
