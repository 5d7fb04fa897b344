"""The gimbal's readings in the adjustment: what they add to a bundle, and whether they agree with the stars.

A bundle that was adjusted without readings is the start. Scales, the angle between the axes and the parallax become
parameters with the priors that the station states.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib.adjustment.bundle import Bundle
from calib.adjustment.collimator_terms import term_displacements
from calib.adjustment.gimbal_observations import GimbalObservations
from calib.adjustment.parameters import AdjustmentParameters
from calib.model.aberrations import PARALLAX
from calib.model.beam import Disc
from calib.model.gimbal import SCALES, aligned_gimbal
from calib.model.gimbal_readings import GimbalReadings
from calib.model.prior import Prior, joined
from calib.view import View

Array = NDArray[np.float64]

#: Smallest 1-sigma of the parallax, as a share of r: a certain value would make the equations singular.
_MIN_PARALLAX_SIGMA = 1e-7
#: Probability that correct statements are reported as contradicted.
_FALSE_ALARMS = 1e-3


@dataclass(frozen=True)
class ReadingsTest:
    """Whether readings agree with the stars and with the statements about them."""

    # chi_square, degrees_of_freedom: Weighted squares of the readings' residuals and of the distances of the
    # gimbal's parameters and of a certificate's radius from what is stated.
    chi_square: float
    degrees_of_freedom: int
    rms_deg: float  # Root mean square rotation between reading and stars, degrees
    sigma_rad: float  # Standard uncertainty of a reading in the test, rad
    times_stated: float = 1.0
    source: str = ""  # Where the statements come from

    @property
    def contradicted(self) -> bool:
        """Whether the chi-square is above its 99.9 % quantile."""
        from scipy import special

        return bool(self.chi_square > special.chdtri(max(self.degrees_of_freedom, 1), _FALSE_ALARMS))

    @property
    def scatter(self) -> float:
        """How many times more the readings scatter than stated; 1 is agreement."""
        return float(np.sqrt(self.chi_square / max(self.degrees_of_freedom, 1)))


def add_readings(
    views: Sequence[View],
    discs: Sequence[Disc],
    bundle: Bundle,
    parameters: AdjustmentParameters,
    readings: GimbalReadings,
    radius: Prior | None = None,
) -> tuple[Bundle, AdjustmentParameters]:
    """Add readings with bounded parallax to a bundle.

    Readings and a certificate both determine the focal length. The radius is then no longer held, but a parameter with
    the certificate as its prior, so that each gets its weight.

    A scale and an eccentricity act alike over a small range of angles: an error a sin(angle + phase) has the slope
    a cos(phase), at most a in rad.

    discs: Their visible discs; none if no term needs them.
    bundle: Bundle without readings.
    readings: One reading for each view, with `GimbalReadings.parallax`.
    radius: Prior of the radius by a certificate; None if there is none.
    Returns: Bundle and start with the gimbal's parameters.
    """
    assert readings.parallax is not None
    observations = GimbalObservations(readings.angles, float(np.deg2rad(readings.reading_sigma_deg)))
    scale_sigma = float(np.hypot(readings.scale_sigma, np.deg2rad(readings.eccentricity_deg)))
    own = observations.free_parameters(scale_sigma)
    collimator = parameters.collimator
    mean, sigma = readings.parallax.mean_and_sigma(collimator.r)
    information = np.eye(2) / max(sigma, _MIN_PARALLAX_SIGMA) ** 2
    parallax = Prior(PARALLAX, np.full(2, mean), information)
    collimator = replace(
        collimator,
        aberrations={**collimator.aberrations, **dict.fromkeys(PARALLAX, mean)},
        reference=collimator.reference or (collimator.x, collimator.y, collimator.r),
    )
    start = replace(
        parameters, collimator=collimator, gimbal=aligned_gimbal(parameters.rotations, readings.angles)
    )
    bundle = replace(
        bundle,
        names=(*bundle.names, *(radius.names if radius else ()), *PARALLAX, *own.names),
        prior=joined(bundle.prior, radius, parallax, own),
        gimbal=observations,
    )
    return with_turns(views, discs, bundle, start), start


def with_turns(
    views: Sequence[View], discs: Sequence[Disc], bundle: Bundle, parameters: AdjustmentParameters
) -> Bundle:
    """Return the bundle with displacements for the turns of given parameters.

    discs: Their visible discs; none if no term needs them.
    """
    terms = tuple(parameters.collimator.aberrations)
    return replace(bundle, displacements=term_displacements(views, discs, parameters, terms))


def check_readings(bundle: Bundle, parameters: AdjustmentParameters, stated: GimbalReadings) -> ReadingsTest:
    """Compare readings and statements with the optimum.

    The sum of the squares of the weighted residuals has a chi-square distribution if the errors are normal (Rao, 1973).
    The stars determine the rotations much better than the readings do, so each view gives three degrees of freedom.
    """
    assert bundle.gimbal is not None
    assert parameters.gimbal is not None
    assert bundle.prior is not None
    off = bundle.gimbal.residuals(parameters.gimbal, parameters.rotations)
    chi_square = float((off**2).sum()) / bundle.gimbal.sigma_rad**2
    bounded = [name for name in bundle.prior.names if name in ("r", *SCALES, *PARALLAX)]
    at = [bundle.prior.names.index(name) for name in bounded]
    away = parameters.values(bounded) - bundle.prior.mean[at]
    chi_square += float((away**2 * np.diag(bundle.prior.information)[at]).sum())
    rank = np.linalg.matrix_rank(
        bundle.gimbal.derivatives(parameters.gimbal, bundle.names).reshape(off.size, -1), tol=1e-6
    )
    # The focal lengths follow the readings too: one more parameter that only the readings determine.
    freedom = off.size + len(bounded) - int(rank) - 1
    rms = float(np.rad2deg(np.sqrt((off**2).sum(axis=1).mean())))
    times = bundle.gimbal.sigma_rad / np.deg2rad(stated.reading_sigma_deg)
    return ReadingsTest(
        chi_square, freedom, rms, bundle.gimbal.sigma_rad, round(float(times), 9), stated.source
    )
