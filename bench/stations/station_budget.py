"""Section `budget` of the station file: uncertainties that no view can show, each with its distribution and source.

The section gives the type B terms of the uncertainty budget; `calib.joint` propagates them to the result.
"""

from __future__ import annotations

import datetime as dt
import math
import re
from collections.abc import Mapping
from contextlib import suppress
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Discriminator,
    Field,
    Tag,
    ValidationInfo,
    field_validator,
    model_validator,
)

from bench.stations.station_fields import FocalLength, Positive, Serial, Text
from calib.model.gimbal_readings import BESIDE_AXES_MM
from calib.model.type_b_terms import Distribution, TermKind, TypeBTerm
from sequences.schema import Name
from sequences.strict_model import StrictModel, Within

Celsius = Annotated[float, Field(ge=-50, le=100)]
_DATE = re.compile(r"\d{4}-\d{2}-\d{2}")
#: A focal length farther than this share from the nominal one is another collimator's (``calib.joint.adjust``).
_OTHER_RADIUS = 0.15
#: Reference temperature of dimensional measurements, degrees Celsius (ISO 1).
_REFERENCE_C = 20.0
_Degrees = Annotated[
    float | None, Field(ge=1, le=1e6, description="Degrees of freedom; without it infinite.")
]
_Share = Annotated[float, Field(ge=0, le=0.1)]

_TERMS = ("print_scale", "print_bow", "thermal", "collimator_thermal", "effective_radius", "wavefront")
"""Keys of the budget that are terms of the same kind, in their order."""


def _date(value: Any) -> Any:
    """Read a date; raise ValueError if it is not one."""
    if not isinstance(value, str):
        return value
    if _DATE.fullmatch(value):
        with suppress(ValueError):  # a day that does not exist, such as 2026-02-30: refused below
            return dt.date.fromisoformat(value)
    raise ValueError(f"must be a date, year-month-day: 2026-03-31 (got {value[:60]!r}).")


Date = Annotated[dt.date, BeforeValidator(_date)]


class StatedValue(StrictModel):
    """A value with its standard uncertainty."""

    value: Annotated[float, Within(-1e6, 1e6)]
    sigma: Annotated[float, Within(0, 1e6)]
    """Standard uncertainty (k = 1), in the unit of the value."""


class CertificateConfig(StrictModel):
    """A certificate of the collimator's focal length."""

    r_mm: FocalLength
    """Focal length on the axis."""
    uncertainty_mm: Annotated[float, Within(1e-6, 1e4, "mm")]
    """Expanded uncertainty, as the certificate states it."""
    k: Annotated[float, Field(ge=1, le=10)] = 2.0
    """Coverage factor of the uncertainty."""
    length: Literal["focal_length", "seen"] | None = None
    """Which length it is: the focal length, as makers state it, or the distance from centre to target as a camera on
    this bench saw it. Both are weighed if it is not said."""
    number: Text
    date: Date | None = None
    valid_until: Date | None = None
    temperature_c: Celsius | None = None
    """Temperature for which the value holds."""

    @model_validator(mode="after")
    def _ends_after_it_begins(self) -> CertificateConfig:
        if self.date and self.valid_until and self.valid_until < self.date:
            raise ValueError("valid_until is before the date of the certificate.")
        return self

    @property
    def sigma_mm(self) -> float:
        """Standard uncertainty of the focal length, mm."""
        return self.uncertainty_mm / self.k


def _text_or_values(value: Any) -> str:
    return "values" if isinstance(value, Mapping | CertificateConfig) else "text"


class CollimatorConfig(StrictModel):
    """What is known of the collimator. The solve steps use its certificate or its passport, and its defocus."""

    serial: Serial | None = None
    nominal_r_mm: FocalLength | None = None
    certificate: (
        Annotated[
            Annotated[Text, Tag("text")] | Annotated[CertificateConfig, Tag("values")],
            Discriminator(_text_or_values),
            Field(description="Values of the certificate. A plain text is printed in the report only."),
        ]
        | None
    ) = None
    passport: Annotated[str | None, Field(min_length=1, max_length=4096)] = None
    """Passport file, relative to the station file."""
    unsealed_passport: Literal["accept", "refuse"] | None = None
    """Passport file without a seal, or with that of an unknown key; accepted by default."""
    temperature_c: Celsius | None = None
    """Temperature of the collimator on this bench."""
    defocus: StatedValue | None = None
    """Shift of the pattern on the target over the shift of the camera across the beam."""
    pupil_to_focus_mm: StatedValue | None = None
    """Distance from the camera's entrance pupil to the front focal plane; negative if the pupil is between that plane
    and the glass."""

    @field_validator("certificate")
    @classmethod
    def _of_this_collimator(
        cls, certificate: str | CertificateConfig | None, info: ValidationInfo
    ) -> str | CertificateConfig | None:
        """Refuse before anything moves what the adjustment would take for another collimator's certificate."""
        nominal = info.data.get("nominal_r_mm")
        stated = certificate.r_mm if isinstance(certificate, CertificateConfig) else None
        if stated is not None and nominal is not None and abs(stated - nominal) > _OTHER_RADIUS * nominal:
            raise ValueError(
                f"r_mm {stated:g} is more than 15 % off nominal_r_mm {nominal:g}: another collimator's. Correct one."
            )
        return certificate

    @model_validator(mode="after")
    def _certificate_or_passport(self) -> CollimatorConfig:
        if self.passport is not None and isinstance(self.certificate, CertificateConfig):
            raise ValueError(
                "give the values of a certificate or a passport, not both: the solve uses one of them."
            )
        return self


def _has_direction(normal: tuple[float, float, float]) -> tuple[float, float, float]:
    """Refuse a vector without a direction."""
    if not 1e-6 < math.hypot(*normal) < 1e6:
        raise ValueError("has no direction: give a vector such as [0, 0, 1].")
    return normal


class FaceConfig(StrictModel):
    """A face of the camera's mount, against the stage's flange."""

    normal: Annotated[tuple[float, float, float], AfterValidator(_has_direction)]
    """Direction of its normal: x along the tilt axis, y along the pan axis, z forward."""
    sigma_deg: Annotated[float, Within(0, 10, "deg")] = 0.0
    """Standard uncertainty of the normal, in each direction."""


class GimbalConfig(StrictModel):
    """What the gimbal's readings are worth as measurements, and what bounds their parallax."""

    reading_sigma_deg: Annotated[float, Within(1e-6, 10, "deg")]
    """Standard uncertainty of a reading, wobble of the axes included."""
    scale_sigma: Annotated[float, Field(ge=0, le=1)] = 0.0
    """Standard uncertainty of the scale of an axis."""
    eccentricity_deg: Annotated[float, Field(ge=0, le=10)] = 0.0
    """Standard uncertainty of the encoder's error of one period a turn."""
    source: Text
    """Certificate, data sheet or measurement of these values."""
    pupil_off_pivot_mm: StatedValue | None = None
    """Distance of the lens's entrance pupil in front of the pivot."""
    pupil_beside_axes_mm: Annotated[float, Within(0, 100, "mm")] = BESIDE_AXES_MM
    """Standard uncertainty of the pupil's place beside the axes."""
    faces: dict[Name, FaceConfig] | None = None
    """Faces of the camera's mount, by name, for the boresight."""


def _not_blank(text: str) -> str:
    """Refuse a text of spaces."""
    if not text.strip():
        raise ValueError("must not be empty.")
    return text


_Source = Annotated[
    Text,
    AfterValidator(_not_blank),
    Field(description="Certificate, drawing, data sheet or measurement of these values."),
]


class _StatedConfig(StrictModel):
    """What every term of the budget states besides its value."""

    distribution: Distribution = "normal"
    """The value is the half width; for normal, k times the standard uncertainty."""
    k: Annotated[float, Field(ge=1, le=10)] = 1.0
    """Coverage factor of a normal distribution."""
    degrees_of_freedom: _Degrees = None
    source: _Source

    @model_validator(mode="after")
    def _k_of_a_normal_distribution(self) -> _StatedConfig:
        if self.k != 1 and self.distribution != "normal":
            raise ValueError("k applies to a normal distribution only; a half width needs no k.")
        return self

    def stated(self, name: str, kind: TermKind, value: float, **more: float) -> TypeBTerm:
        """Return a term with its distribution and source; ``more`` are further fields of `TypeBTerm`."""
        freedom = self.degrees_of_freedom or float("inf")
        return TypeBTerm(name, kind, value, self.source, self.distribution, self.k, freedom, **more)


class PrintScaleConfig(_StatedConfig):
    """Relative error of the scale of the printed target."""

    value: _Share
    """Relative uncertainty of the scale."""
    correction: Annotated[float, Field(ge=-0.1, le=0.1)] = 0.0
    """Known relative error: true over nominal size, minus 1."""

    def term(self, *_: object) -> TypeBTerm:
        """Return the term of the budget."""
        return self.stated("scale of the print", "print_scale", self.value, correction=self.correction)


class PrintBowConfig(_StatedConfig):
    """Bow of the printed target: its height at a distance from the axis."""

    value_mm: Annotated[float, Field(ge=0, le=100)]
    """Height over the middle."""
    radius_mm: Positive
    """Distance from the axis at which the target is so high."""

    def term(self, *_: object) -> TypeBTerm:
        """Return the term of the budget."""
        return self.stated("bow of the print", "print_bow", self.value_mm, radius_mm=self.radius_mm)


class EffectiveRadiusConfig(_StatedConfig):
    """Difference between the focal length of a certificate, on the axis, and the effective one over the beam."""

    relative: _Share
    """Relative uncertainty."""

    def term(self, *_: object) -> TypeBTerm:
        """Return the term of the budget."""
        return self.stated("effective radius", "effective_radius", self.relative)


class CollimatorDistortionConfig(_StatedConfig):
    """Distortion of the collimator: how far a point at the edge of the field lies from its ideal place."""

    relative: _Share
    """Displacement over the distance from the axis."""
    at_deg: Annotated[float, Field(gt=0, lt=60)]
    """Angle from the axis at which the displacement is so large."""


class WavefrontConfig(StrictModel):
    """Slopes of the collimator's wavefront that differ over the beam."""

    urad_rms: Annotated[float, Field(ge=0, le=1e5)]
    """RMS slope, its mean subtracted."""
    correlation_mm: Positive | None = None
    """Of stations of earlier versions; it has no effect."""
    source: _Source

    def term(self, *_: object) -> TypeBTerm:
        """Return the term of the budget."""
        return TypeBTerm("slopes of the wavefront", "wavefront", self.urad_rms, self.source)


class ThermalConfig(StrictModel):
    """Thermal expansion between the reference temperature and that of the bench."""

    expansion_per_c: Annotated[float, Field(ge=-1e-3, le=1e-3)]
    """Coefficient of expansion."""
    expansion_sigma_per_c: Annotated[float, Field(ge=0, le=1e-3)] = 0.0
    """Standard uncertainty of the coefficient."""
    reference_c: Celsius | None = None
    """Temperature for which the nominal size holds."""
    temperature_c: Celsius | None = None
    """Temperature on the bench; without it, that of the collimator."""
    sigma_c: Annotated[float, Field(ge=0, le=100)]
    """Standard uncertainty of the temperature difference."""
    source: _Source

    def term(self, kind: Literal["thermal", "collimator_thermal"], collimator: CollimatorConfig) -> TypeBTerm:
        """Return the term; the temperature is the section's, else the ``collimator``'s, else that of reference."""
        of_glass, certificate = kind == "collimator_thermal", collimator.certificate
        certificate_c = certificate.temperature_c if isinstance(certificate, CertificateConfig) else None
        references = (self.reference_c, certificate_c if of_glass else None, _REFERENCE_C)
        reference_c = next(reference for reference in references if reference is not None)
        temperatures = (self.temperature_c, collimator.temperature_c)
        measured_c = next(
            (temperature for temperature in temperatures if temperature is not None), reference_c
        )
        return TypeBTerm.thermal(
            kind,
            f"thermal expansion of the {'collimator' if of_glass else 'print'}",
            self.source,
            expansion_per_c=self.expansion_per_c,
            expansion_sigma_per_c=self.expansion_sigma_per_c,
            difference_c=measured_c - reference_c,
            difference_sigma_c=self.sigma_c,
        )


class BudgetConfig(StrictModel):
    """Uncertainties that no view can show. What is not stated is listed in the results as not included."""

    print_scale: PrintScaleConfig | None = None
    print_bow: PrintBowConfig | None = None
    thermal: ThermalConfig | None = None
    collimator_thermal: ThermalConfig | None = None
    effective_radius: EffectiveRadiusConfig | None = None
    collimator_distortion: CollimatorDistortionConfig | None = None
    wavefront: WavefrontConfig | None = None

    def terms(self, collimator: CollimatorConfig) -> tuple[TypeBTerm, ...]:
        """Return the terms, each of the kind that its key names."""
        stated = ((kind, getattr(self, kind)) for kind in _TERMS)
        return tuple(section.term(kind, collimator) for kind, section in stated if section is not None)

    def radial_sigma(self, r_mm: float) -> float | None:
        """Return the prior of the radial term k of the target's map, k |h|^2 h at the tangents h, in radii.

        A bow of height z at the distance R gives k = z r / R^2, a relative displacement d at the angle a k = d /
        tan(a)^2 (own derivation, first order). None unless bow and distortion are both stated above zero: the term
        stands for both.
        """
        bow, distortion = self.print_bow, self.collimator_distortion
        if bow is None or distortion is None:
            return None
        by_bow = bow.term().standard_uncertainty * r_mm / bow.radius_mm**2
        by_distortion = distortion.stated(
            "value", "effective_radius", distortion.relative
        ).standard_uncertainty
        by_distortion /= math.tan(math.radians(distortion.at_deg)) ** 2
        return math.hypot(by_bow, by_distortion) or None
