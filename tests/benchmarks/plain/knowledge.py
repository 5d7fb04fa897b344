"""What a station states beside the stars, in units of the unknowns, and what would be known if it stated nothing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.calibration import CalibrationOptions
from calib.model.gimbal_readings import GimbalReadings, ParallaxBound
from calib.model.passport import Passport
from calib.model.target_focus import CertifiedLength, TargetFocus
from calib.model.type_b_terms import RADII, TypeBTerm

#: Names of witnesses.
CERTIFICATE = "certificate of the collimator"
CHANGED_AXIS, CHANGED_RADIUS = (
    "change of the axis since the passport",
    "change of the radius since the passport",
)
CHANGED_RADIAL = "change of the radial errors since the passport"
CHANGED_FIELD = "size of irregular changes since the passport"
SCALE_OF, ORTHOGONAL = "scale of {}", "axes at a right angle"
ASPECT, READINGS, STEADY = "square pixels", "readings of the gimbal", "steady focal length"

#: A certificate may be another collimator's, whose radius is within a factor of 1.5 (1-sigma).
FREE_CERTIFICATE = 0.4
#: Pixels are square to this share: a sensor is exact to 1e-5, but one that is tilted by 1.4 degrees shows one axis
#: shorter by 3e-4. If not, to the second.
ASPECT_SIGMA, FREE_ASPECT = 3e-4, 0.1
#: Focal length and radius change by this share from first to last pose: 1 K of aluminium; if not, by the second.
DRIFT_SIGMA, FREE_DRIFT = 3e-5, 5e-3
#: The principal point lies in the middle of the sensor to this share of its diagonal.
MIDDLE_SHARE = 0.1
#: If nobody had stated it: the radius since a passport, the scale of an axis, the parallax over what is expected.
FREE_RADIUS, FREE_SCALE, FREE_PARALLAX = 0.02, 0.005, 0.005
FREE_TERMS = {"thermal": 1e-3, "print_scale": 5e-3}
#: Angle between the axes of a gimbal and a right angle; if it is not square.
SKEW_RAD, FREE_SKEW_RAD = float(np.radians(0.1)), 0.1
#: Standard uncertainty that stands for exact, as a share.
EXACT = 1e-7


@dataclass(frozen=True)
class Length:
    """A certified length of the collimator, as that which the camera sees."""

    r_mm: float
    sigma: float  # As a share of it
    focal_sigma: float | None  # The same if it states a focal length; None if it does not say so, and is none
    source: str


@dataclass(frozen=True)
class Known:
    """All that is stated."""

    certificate: Length | None
    passport: Passport | None  # That holds more than a radius
    passport_source: str
    readings: GimbalReadings | None
    bound: ParallaxBound | None
    terms: tuple[TypeBTerm, ...]
    radial_sigma: float | None

    @classmethod
    def of(cls, options: CalibrationOptions) -> Known:
        """Return what options state."""
        passport, gimbal = options.passport, options.gimbal
        certified = passport is not None and passport.is_certificate
        return cls(
            _length(options, passport) if passport is not None and certified else None,
            None if certified else passport,
            options.passport_source or "passport of the collimator",
            gimbal,
            gimbal.parallax if gimbal else None,
            options.budget,
            options.radial_sigma,
        )

    @property
    def r_mm(self) -> float | None:
        """The radius, as far as something states it."""
        if self.certificate:
            return self.certificate.r_mm
        return float(self.passport.values_by_name["r"]) if self.passport else None

    @property
    def wavefront(self) -> float:
        """RMS slope of the wavefront that a station states, rad; 0 if it states none."""
        squares = [term.standard_uncertainty**2 for term in self.terms if term.kind == "wavefront"]
        return 1e-6 * float(np.sqrt(sum(squares)))

    def terms_of(self, kinds: Sequence[str]) -> list[TypeBTerm]:
        """Return the type B terms of some kinds; those of the radius only beside a certificate."""
        terms = [term for term in self.terms if term.kind in kinds]
        return [term for term in terms if term.kind not in RADII or self.certificate]


def _length(options: CalibrationOptions, passport: Passport) -> Length:
    """Return the length that a certificate states."""
    r_mm = float(passport.values_by_name["r"])
    sigma_mm = max(float(np.sqrt(passport.covariance[0, 0])), EXACT * r_mm)
    focus = _focus(options)
    more_mm, more_sigma_mm = focus.seen_less_focal_mm(r_mm)
    focal_mm = float(np.hypot(sigma_mm, more_sigma_mm))
    # Who states where the pupil is before the focal plane means the focal length.
    is_focal = passport.length == CertifiedLength.FOCAL or bool(focus.pupil_to_focus_mm)
    source = options.passport_source or "certificate of the collimator"
    if is_focal and passport.length != CertifiedLength.SEEN:
        seen_mm = r_mm + more_mm
        return Length(seen_mm, focal_mm / seen_mm, None, source)
    unsaid = passport.length == CertifiedLength.UNSAID and not is_focal
    return Length(r_mm, sigma_mm / r_mm, focal_mm / r_mm if unsaid else None, source)


def _focus(options: CalibrationOptions) -> TargetFocus:
    """Return what is known of the target's focus and the pupil's place; a bound of the parallax has a defocus."""
    focus = options.focus or TargetFocus()
    bound = options.gimbal.parallax if options.gimbal else None
    if focus.defocus is not None or bound is None:
        return focus
    return replace(focus, defocus=(bound.defocus, bound.defocus_sigma))
