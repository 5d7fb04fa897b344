"""The file of a collimator's passport: one JSON object, as `Passport` writes it, perhaps with a seal in it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, NamedTuple

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from bench.base.bounded_json import canonical_json, parse_json
from bench.base.errors import EvidenceError, UsageError
from bench.record.storage import read_bounded
from calib.errors import InputMismatch
from calib.model.collimator import ABERRATIONS, CENTRE
from calib.model.passport import SCHEMA, Passport

if TYPE_CHECKING:
    from bench.evidence.passport_seal import PassportSeal

LEAST_R_MM = 0.1
"""Smallest focal length of a collimator, mm."""
_MOST = 1e6
"""Largest size of a value, mm; no collimator is a kilometre long."""
_LEAST_SIGMA = 1e-7
"""Smallest standard uncertainty, mm: a tenth of a nanometre."""
_LEAST_RELATIVE_SIGMA_OF_R = 1e-8  # No length of a metre is known to 10 nm
_LEAST_EIGENVALUE = 1e-13
"""Smallest eigenvalue of the correlation matrix; rounding alone gives values below it."""
_ASYMMETRY = 1e-9  # Rounding of numbers with 15 digits, far above
_LARGEST_BYTES = 1_000_000  # A covariance of 100 parameters takes a quarter
_REMEDY: Final = "Make a passport with `starbench passport make`."
_CHANGED: Final = "Perhaps an editor or a transfer changed it: get the original again, or make a passport."


def _of_passports(schema: Any) -> Any:
    if schema != SCHEMA:
        raise ValueError(f"it is not {SCHEMA}")
    return schema


def _known(name: str) -> str:
    """Refuse what is no coordinate of the centre, aberration, or coefficient of the common field (``common_7``)."""
    is_common = name.startswith("common_") and name.removeprefix("common_").isdecimal()
    if name not in (*CENTRE, *ABERRATIONS) and not is_common:
        raise ValueError("it is no parameter of a collimator")
    return name


_Number = Annotated[float, Field(ge=-_MOST, le=_MOST)]


class _Form(BaseModel):
    """The keys of a passport; what its numbers must be together, `Passport` says."""

    model_config = ConfigDict(extra="forbid")
    form: Annotated[Any, Field(alias="schema"), AfterValidator(_of_passports)]
    names: list[Annotated[str, AfterValidator(_known)]]
    values: list[_Number]
    covariance: list[list[_Number]]
    reference: tuple[_Number, _Number, _Number] | None
    disagreement: Annotated[_Number, Field(ge=0.0)]
    views: list[Any]
    conditions: dict[str, Any]
    length: str = ""
    seal: str | None = None


class PassportFile(NamedTuple):
    """A passport, the bytes of its file, and its valid seal; None if nobody sealed it."""

    passport: Passport
    data: bytes
    seal: PassportSeal | None


def read_passport_file(path: Path) -> PassportFile:
    """Read a passport file."""
    if not path.exists():
        raise UsageError("There is no such passport file.", where=str(path), remedy="Check the path.")
    return parse_passport(read_bounded(path, _LARGEST_BYTES), str(path))


def parse_passport(data: bytes, where: str) -> PassportFile:
    """Read the bytes of a passport; `UsageError` says why it is none: changed, an unknown parameter, absurd numbers."""
    from bench.evidence.passport_seal import read_passport_seal  # it loads the cryptography

    try:
        document: Any = parse_json(data)
        seal = read_passport_seal(data)
        form = _Form.model_validate(document if isinstance(document, dict) else {})
        canonical_json(document, ascii_only=False)  # half a surrogate pair is no text: no run could state it
        if form.seal is not None and seal is None:
            raise UsageError(
                "The seal of this passport is not on its second line: the file was written anew by another program.",
                where=where,
                remedy="Use the file as it was made.",
            )
        passport = Passport.from_dict(document)
        _refuse_indefinite(passport)
    except ValidationError as error:
        raise UsageError(_words_of(error), where=where, remedy=_REMEDY) from error
    except (EvidenceError, InputMismatch) as error:
        raise UsageError(error.what, where=where, remedy=error.remedy or _REMEDY) from error
    except ValueError as error:
        what = f"This is not the text of a passport: {error}."
        raise UsageError(what, where=where, remedy=_CHANGED) from error
    return PassportFile(passport, data, seal)


def _words_of(error: ValidationError) -> str:
    """Return in words the first fault of a passport's form."""
    fault = error.errors(include_url=False)[0]
    kind, place = fault["type"], ".".join(map(str, fault["loc"]))
    if kind == "missing":
        return f"Not a passport: it has no {place}."
    if kind == "extra_forbidden":
        return f"A passport has no key {place[:40]!r}."
    own = fault["msg"].removeprefix("Value error, ") if kind == "value_error" else "no passport has that"
    return f"Not a passport: {place} is {fault['input']!r:.40}; {own}."


def _refuse_indefinite(passport: Passport) -> None:
    """Refuse a radius that is none, and a covariance that is not positive definite, or of a certainty that nobody has.

    Own limits: below 0.1 nm of the centre, or 1e-8 of the focal length, nothing is measured. Eigenvalues are the
    correlation matrix's: without units.
    """
    if not passport.values_by_name["r"] > LEAST_R_MM:
        what = f"The passport's radius r is not positive, or below {LEAST_R_MM:g} mm; no collimator is that short."
        raise InputMismatch(what, where="passport")
    covariance = passport.covariance
    variances = covariance.diagonal()
    for name, value, variance in zip(passport.names, passport.values, variances, strict=True):
        least = _LEAST_SIGMA if name in CENTRE else 0.0
        if not variance > max(least, _LEAST_RELATIVE_SIGMA_OF_R * value if name == "r" else 0.0) ** 2:
            what = f"The variance of {name} in its covariance is {variance:g}; "
            raise InputMismatch(
                f"{what}no measurement is that certain. A variance is the square of a standard uncertainty, mm².",
                where="passport",
            )
    scale = np.sqrt(variances)
    correlation = covariance / np.outer(scale, scale)
    if not np.allclose(correlation, correlation.T, rtol=0.0, atol=_ASYMMETRY):
        raise InputMismatch("Its covariance is not symmetric.", where="passport")
    if np.linalg.eigvalsh(correlation)[0] < _LEAST_EIGENVALUE:
        raise InputMismatch(
            "Its covariance is not positive definite: the uncertainties contradict each other.",
            where="passport",
        )


def passport_bytes(passport: Passport) -> bytes:
    """Return the bytes of a passport's file."""
    return canonical_json(passport.to_dict())
