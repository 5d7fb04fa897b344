"""The file ``lab.yaml``: what a certificate says that a run cannot know. One file for each calibrated item.

Its parts are parts of `certificate_data.Certificate` too. Nearly every key may be left out here;
`bench.extras.certificate.clauses` refuses what is open. docs/extras/certificate/certificates.md has them all.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import (
    AfterValidator,
    AliasChoices,
    BeforeValidator,
    Discriminator,
    Field,
    Tag,
    ValidationInfo,
    ValidatorFunctionWrapHandler,
    WrapValidator,
    model_validator,
)

from bench.extras.certificate.series import is_number_format
from bench.stations.station_budget import Date
from bench.stations.station_fields import Serial
from sequences.schema import RuleConfig
from sequences.strict_model import Form, StrictModel
from sequences.wording import MESSAGES

EXAMPLE = Path(__file__).with_name("example_lab.yaml")
NONE = "none"
PLACEHOLDER = "REPLACE"
"""Stands in the example for every value that only the laboratory knows."""
Kind = TypeVar("Kind")

Sha256 = Annotated[
    str,
    Form(r"^[0-9a-f]{64}$", "64 digits 0 to 9 and a to f, as `sha256sum` prints them"),
    Field(description="SHA-256 of the certificate's file."),
]
Number = Annotated[float, Field(ge=-1e12, le=1e12)]
NotNegative = Annotated[float, Field(ge=0, le=1e12)]
Factor = Annotated[float, Field(ge=1, le=10, description="Coverage factor of the uncertainty.")]

PlaceKind = Literal["laboratory", "customer", "laboratoryBranch", "customerBranch", "other"]


def _plain(text: str) -> str:
    """Refuse blank texts and characters that cannot be printed."""
    if not text.strip():
        raise ValueError("must not be empty.")
    if PLACEHOLDER in text:
        raise ValueError("replace this placeholder by your own value.")
    if any(not char.isprintable() and char != "\n" for char in text) or re.search("[\ud800-\udfff]", text):
        raise ValueError("must contain no control characters.")
    return text.strip()


Text = Annotated[
    str,
    Field(
        min_length=1,
        max_length=300,
        # An editor may read 38116 as a number; Starbench reads it as text
        json_schema_extra={"type": ["string", "number"]},
    ),
    AfterValidator(_plain),
]
LongText = Annotated[str, Field(min_length=1, max_length=3000), AfterValidator(_plain)]


def _or_empty(value: Any, read: ValidatorFunctionWrapHandler, info: ValidationInfo) -> Any:
    """Read an absent text as an empty one: lab.yaml leaves it out, certificate.json writes it as ``""``."""
    return "" if value == ("" if info.mode == "json" else None) else read(value)


OrEmpty = Annotated[
    Kind,
    WrapValidator(_or_empty),
    Field(json_schema_extra={"type": ["string", "number", "null"]}),
]
"""A text that may be absent: it is then empty."""


def _none_or_values(value: Any) -> str | None:
    if isinstance(value, Mapping | StrictModel):
        return "values"
    return NONE if value == NONE else None


_NONE_OR_VALUES = Discriminator(
    _none_or_values,
    custom_error_type="none_or_values",
    custom_error_message=MESSAGES["none_or_values"],
)


def _nothing(value: Any) -> Any:
    """Read ``none`` as an empty list."""
    return () if value == NONE else value


def _list_or_none() -> Any:
    """Return the field of a list that may be written as ``none``."""
    return Field(max_length=100, json_schema_extra={"type": ["array", "string"]})


class Address(StrictModel):
    """A postal address."""

    street: OrEmpty[Text] = ""
    post_code: OrEmpty[Text] = ""
    city: Text
    country: Annotated[str, Form(r"^[A-Z]{2}$", "two capital letters by ISO 3166-1, such as DE")]
    """Two letters, ISO 3166-1."""


class Contact(StrictModel):
    """How to reach somebody: at least one of mail and telephone."""

    name: OrEmpty[Text] = ""
    email: OrEmpty[
        Annotated[
            str, Field(max_length=254), Form(r"^[^@\s]+@[^@\s]+$", "an address such as lab@example.org")
        ]
    ] = ""
    phone: OrEmpty[Text] = ""

    @model_validator(mode="after")
    def _reachable(self) -> Contact:
        if not (self.email or self.phone):
            raise ValueError("needs email or phone.")
        return self


class Accreditation(StrictModel):
    """An accreditation that covers this calibration."""

    body: Text
    number: Text
    scope: Text


class LaboratoryConfig(StrictModel):
    """The laboratory."""

    name: OrEmpty[Text] = ""
    address: Address | None = None
    contact: Contact | None = None
    accreditation: (
        Annotated[
            Annotated[Literal["none"], Tag(NONE)] | Annotated[Accreditation, Tag("values")],
            _NONE_OR_VALUES,
        ]
        | None
    ) = None


class PlaceConfig(StrictModel):
    """Where the calibration was performed."""

    kind: PlaceKind
    name: Text


class NumbersConfig(StrictModel):
    """The series of numbers of certificates."""

    format: Annotated[str, Field(max_length=60)] = "SB-{year}-{number:05d}-{head}"
    """Number of a certificate; {year}, {number:05d} and {head} are replaced."""

    @model_validator(mode="after")
    def _is_a_series(self) -> NumbersConfig:
        if not is_number_format(self.format):
            raise ValueError(
                "format must contain {number:05d} once and otherwise letters, digits, '-', '_', '.', '/', {year} and"
                " {head}."
            )
        return self


class Customer(StrictModel):
    """The customer (ISO/IEC 17025, 7.8.2.1 e)."""

    name: OrEmpty[Text] = ""
    contact: Contact | None = None
    address: Address | None = None


class Lens(StrictModel):
    """The lens, with the settings that were calibrated. Camera and lens are calibrated as one."""

    maker: OrEmpty[Text] = ""
    model: OrEmpty[Text] = ""
    serial: OrEmpty[Text] = ""
    """`none` if the lens has no serial number."""
    focus: OrEmpty[Text] = ""
    aperture: OrEmpty[Text] = ""
    focus_locked: bool | None = None
    aperture_locked: bool | None = None


class ItemConfig(StrictModel):
    """The calibrated item."""

    serial: Annotated[Serial, AfterValidator(_plain)] | None = None
    """Serial number of the camera; must be that of the run."""
    maker: Text | None = None
    """Only for a camera that does not report its serial number."""
    model: Text | None = None
    """Only for a camera that does not report its serial number."""
    lens: Lens = Lens()
    customer_id: OrEmpty[Text] = ""
    received: Date | None = None
    """Date of receipt."""
    condition: OrEmpty[LongText] = ""


class Method(StrictModel):
    """The calibration procedure of the laboratory (7.8.2.1 f)."""

    id: Text
    version: Text
    text: LongText
    sequence_sha256: OrEmpty[Sha256] = ""
    """SHA-256 of the only sequence.yaml that this version of the method allows."""


class ConditionConfig(StrictModel):
    """A condition that influences the result: a value with its instrument, or words."""

    name: Text
    value: Number | None = None
    unit: OrEmpty[Text] = ""
    uncertainty: NotNegative | None = None
    """Expanded uncertainty."""
    k: Factor = 2.0
    instrument: OrEmpty[Text] = ""
    certificate: OrEmpty[Text] = ""
    """Number of the instrument's certificate."""
    text: OrEmpty[Text] = ""

    @model_validator(mode="after")
    def _value_or_text(self) -> ConditionConfig:
        if (self.value is None) == (not self.text):
            raise ValueError("needs either value or text.")
        if self.value is not None and not (self.unit and self.instrument):
            raise ValueError("a value needs unit and instrument.")
        return self


class LabRuleConfig(RuleConfig):
    """Limits of one result, for a statement of conformity. The guard band is the expanded uncertainty."""

    result: Text
    """Symbol of the result, such as fx."""
    specification: Text


class PreviousConfig(StrictModel):
    """The last certificate of this item."""

    number: Text
    date: Date
    issuer: OrEmpty[Text] = ""
    sha256: OrEmpty[Sha256] = ""


class SuppliedConfig(StrictModel):
    """Data that the customer supplied, and the results that depend on them."""

    text: LongText
    results: Annotated[tuple[Text, ...], Field(max_length=40)] = ()


class SourceConfig(StrictModel):
    """A certificate of a reference; it may stand behind a row of the uncertainty budget."""

    row: Text | None = None
    """Name of a row of the uncertainty budget."""
    what: Text | None = None
    """The reference, in words; without it, the row's name."""
    number: OrEmpty[Text] = ""
    issuer: OrEmpty[Text] = ""
    date: Date | None = None
    sha256: OrEmpty[Sha256] = ""
    statement: OrEmpty[LongText] = ""
    """To what the reference is traceable."""

    @model_validator(mode="after")
    def _names_something(self) -> SourceConfig:
        if self.row is None and self.what is None:
            raise ValueError("needs row, what, or both.")
        return self


class AuthorisedBy(StrictModel):
    """The person who is to authorise the certificate (7.8.2.1 o). The signature itself lies beside the seal."""

    name: Text
    role: Text
    key: Annotated[
        str,
        Form(
            r"^SHA256:[A-Za-z0-9+/]{43}$", "SHA256: and 43 characters, as `ssh-keygen -l -f KEY` prints them"
        ),
        Field(validation_alias=AliasChoices("key", "key_fingerprint"), serialization_alias="key_fingerprint"),
    ]
    """Fingerprint of the person's key, as `ssh-keygen -l` prints it."""


_Texts = Annotated[tuple[LongText, ...], BeforeValidator(_nothing), _list_or_none()]


class LabConfig(StrictModel):
    """A file lab.yaml."""

    format: Literal["starbench/lab/1"]
    title: Text = "Calibration certificate"
    numbers: NumbersConfig = NumbersConfig()
    laboratory: LaboratoryConfig = LaboratoryConfig()
    place: PlaceConfig | None = None
    customer: Customer = Customer()
    item: ItemConfig = ItemConfig()
    method: Method | None = None
    deviations: _Texts | None = None
    conditions: Annotated[tuple[ConditionConfig, ...], Field(max_length=100)] | None = None
    sources: Annotated[tuple[SourceConfig, ...], Field(max_length=100)] = ()
    traceability: LongText | None = None
    decision_rules: (
        Annotated[tuple[LabRuleConfig, ...], BeforeValidator(_nothing), _list_or_none()] | None
    ) = None
    previous_certificate: (
        Annotated[
            Annotated[Literal["none"], Tag(NONE)] | Annotated[PreviousConfig, Tag("values")],
            _NONE_OR_VALUES,
        ]
        | None
    ) = None
    customer_supplied: (
        Annotated[tuple[SuppliedConfig, ...], BeforeValidator(_nothing), _list_or_none()] | None
    ) = None
    external: _Texts | None = None
    opinions: _Texts = ()
    recalibration: LongText | None = None
    """Only if it was agreed with the customer; begins with 'agreed with'."""
    authorised_by: AuthorisedBy | None = None

    @model_validator(mode="after")
    def _interval_was_agreed(self) -> LabConfig:
        if self.recalibration is not None and not self.recalibration.startswith("agreed with the customer"):
            raise ValueError(
                "recalibration is printed only if it was agreed: begin it with 'agreed with the customer'"
                " (ISO/IEC 17025, 7.8.4.3), or leave it out."
            )
        return self
