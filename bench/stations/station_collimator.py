"""Sections of the station file about the collimator and about the gimbal's readings: what is known, and how well."""

from __future__ import annotations

import datetime as dt
import re
from collections.abc import Mapping
from contextlib import suppress
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Discriminator, Field, Tag, model_validator
from pydantic_core import PydanticCustomError

from bench.stations.station_fields import FocalLength, Serial, Text
from sequences.plain_number import Within
from sequences.strict_model import StrictModel

NotNegative = Annotated[float, Field(ge=0)]
Celsius = Annotated[float, Field(ge=-50, le=100)]
_DATE = re.compile(r"\d{4}-\d{2}-\d{2}")


def _date(value: Any) -> Any:
    """Read a date; raise PydanticCustomError if it is not one."""
    if not isinstance(value, str):
        return value
    if _DATE.fullmatch(value):
        with suppress(ValueError):  # a day that does not exist, such as 2026-02-30: refused below
            return dt.date.fromisoformat(value)
    raise PydanticCustomError(
        "no_date", "must be a date, year-month-day: 2026-03-31 (got {got}).", {"got": repr(value[:60])}
    )


Date = Annotated[dt.date, BeforeValidator(_date)]


class StatedValue(StrictModel):
    """A value with its standard uncertainty."""

    value: Annotated[float, Within(-1e6, 1e6)]
    sigma: Annotated[
        float, Within(0, 1e6), Field(description="Standard uncertainty (k = 1), in the unit of the value.")
    ]


class CertificateConfig(StrictModel):
    """A certificate of the collimator's focal length."""

    r_mm: Annotated[FocalLength, Field(description="Focal length on the axis.")]
    uncertainty_mm: Annotated[
        float,
        Within(1e-6, 1e4, "mm"),
        Field(description="Expanded uncertainty, as the certificate states it."),
    ]
    k: Annotated[float, Field(ge=1, le=10, description="Coverage factor of the uncertainty.")] = 2.0
    number: Text
    date: Date | None = None
    valid_until: Date | None = None
    temperature_c: Annotated[Celsius | None, Field(description="Temperature for which the value holds.")] = (
        None
    )

    @model_validator(mode="after")
    def _ends_after_it_begins(self) -> CertificateConfig:
        if self.date and self.valid_until and self.valid_until < self.date:
            raise PydanticCustomError("dates", "valid_until is before the date of the certificate.")
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
    passport: Annotated[
        str | None,
        Field(min_length=1, max_length=4096, description="Passport file, relative to the station file."),
    ] = None
    unsealed_passport: Annotated[
        Literal["accept", "refuse"] | None,
        Field(
            description="Passport file without a seal, or with that of an unknown key; accepted by default."
        ),
    ] = None
    temperature_c: Annotated[
        Celsius | None, Field(description="Temperature of the collimator on this bench.")
    ] = None
    defocus: Annotated[
        StatedValue | None,
        Field(description="Shift of the pattern on the target over the shift of the camera across the beam."),
    ] = None

    @model_validator(mode="after")
    def _certificate_or_passport(self) -> CollimatorConfig:
        if self.passport is not None and isinstance(self.certificate, CertificateConfig):
            raise PydanticCustomError(
                "both",
                "give the values of a certificate or a passport, not both: the solve uses one of them.",
            )
        return self


class GimbalConfig(StrictModel):
    """What the gimbal's readings are worth as measurements, and what bounds their parallax."""

    reading_sigma_deg: Annotated[
        float,
        Within(1e-6, 10, "deg"),
        Field(description="Standard uncertainty of a reading, wobble of the axes included."),
    ]
    scale_sigma: Annotated[
        float, Field(ge=0, le=1, description="Standard uncertainty of the scale of an axis.")
    ] = 0.0
    eccentricity_deg: Annotated[
        float,
        Field(ge=0, le=10, description="Standard uncertainty of the encoder's error of one period a turn."),
    ] = 0.0
    source: Annotated[Text, Field(description="Certificate, data sheet or measurement of these values.")]
    pupil_off_pivot_mm: Annotated[
        StatedValue | None,
        Field(description="Distance of the lens's entrance pupil in front of the pivot."),
    ] = None
