"""Passport files of collimators: their bytes, and what is refused about them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from bench.base.bounded_json import parse_json
from bench.base.errors import EvidenceError, UsageError
from bench.evidence.passport_seal import read_passport_seal
from bench.records.storage import storage_errors
from calib.errors import InputMismatch
from calib.model.aberrations import EXPECTED_SIGMA
from calib.model.collimator import CENTRE
from calib.model.passport import Passport

# Numbers of a passport that no measurement gives: too small, too large, or a covariance that is not one.

_MOST = 1e6
"""Largest size of a value, mm; no collimator is a kilometre long."""
LEAST_R_MM = 0.1
"""Smallest focal length of a collimator, mm."""
_LEAST_SIGMA = 1e-7
"""Smallest standard uncertainty, mm: a tenth of a nanometre."""
_LEAST_RELATIVE_SIGMA_OF_R = 1e-8
_LEAST_EIGENVALUE = 1e-13
"""Smallest eigenvalue of the correlation matrix; rounding alone gives values below it."""
_ASYMMETRY = 1e-9
_MOST_NUMBERS = 10_000


def refuse_absurd_numbers(document: Mapping[str, Any]) -> None:
    """Refuse values and covariances of a size that no collimator has, before anything is calculated with them.

    Raises InputMismatch: When a number is too large or too small.
    """
    for name in ("values", "covariance"):
        numbers = list(_numbers(document.get(name)))
        if len(numbers) > _MOST_NUMBERS:
            raise InputMismatch(f"Its {name} has more than {_MOST_NUMBERS} numbers.", where="passport")
        for number in numbers:
            if not abs(number) <= _MOST:
                raise InputMismatch(f"Its {name} contains {number:g}, which is too large.", where="passport")


def _numbers(found: Any) -> list[float]:
    """Return all numbers of nested lists; other things are left to the reader of the passport."""
    if isinstance(found, list):
        return [number for one in found for number in _numbers(one)]
    if isinstance(found, bool) or not isinstance(found, int | float):
        return []
    try:
        return [float(found)]
    except OverflowError:
        return [float("inf")]


def refuse_indefinite(passport: Passport) -> None:
    """Refuse a covariance that is not symmetric and positive definite, or states a certainty that nobody has.

    Own limits: a standard uncertainty of the centre below 0.1 nm, or below 1e-8 of the focal length, is not a
    measurement. The smallest eigenvalue is that of the correlation matrix, so that the units of the parameters do not
    matter.

    Raises InputMismatch: When it is refused; the message names the parameter.
    """
    covariance = passport.covariance
    variances = covariance.diagonal()
    least = {
        name: max(
            _LEAST_SIGMA if name in CENTRE else 0.0,
            _LEAST_RELATIVE_SIGMA_OF_R * abs(value) if name == "r" else 0.0,
        )
        for name, value in passport.values_by_name.items()
    }
    for name, variance in zip(passport.names, variances.tolist(), strict=True):
        if not variance > least[name] ** 2:
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


_LARGEST_BYTES = 1_000_000
_KEYS = frozenset(
    {"schema", "names", "values", "covariance", "reference", "disagreement", "views", "conditions", "seal"}
)


def determines_one_view(passport: Passport) -> bool:
    """Return whether one view is enough to calibrate a camera with a passport.

    Own count: the homography of a view has 8 degrees of freedom. With x, y and r known, the view has 7 unknowns: fx,
    fy, cx, cy and a rotation. With r alone, as a certificate states it, it has 9.

    Returns: True if the passport holds the collimator's whole centre.
    """
    return set(CENTRE) <= set(passport.names)


def read_passport_file(path: Path) -> tuple[Passport, bytes]:
    """Read a passport file.

    Raises UsageError: When there is no such file, or it is not a passport; the message says why.
    Raises StorageError: When it cannot be read.
    """
    if path.is_dir():
        raise UsageError("This is a folder, not a passport file.", where=str(path), remedy="Name the file.")
    if not path.is_file():
        raise UsageError("There is no such passport file.", where=str(path), remedy="Check the path.")
    with storage_errors(path):
        if path.stat().st_size > _LARGEST_BYTES:
            raise UsageError("The file is too large for a passport.", where=str(path))
        data = path.read_bytes()
    return parse_passport(data, str(path)), data


def parse_passport(data: bytes, where: str) -> Passport:
    """Read the bytes of a passport.

    data: Bytes of a passport file.
    Returns: The collimator's parameters and their covariance.
    Raises UsageError: When it is not a passport, was changed after it was sealed, has a parameter that the
      engine does not know, or numbers that no collimator has; the message says why.
    """
    remedy = "Make a passport with `starbench passport make` or `starbench passport certificate`."
    try:
        shape: Any = parse_json(data)
        document = shape if isinstance(shape, dict) else {}
        seal = read_passport_seal(data)
        if "seal" in document and seal is None:
            raise UsageError(
                "The seal of this passport is not on its second line: the file was written anew by another program.",
                where=where,
                remedy="Use the file as it was made.",
            )
        if unknown_keys := sorted(set(document) - _KEYS):
            raise UsageError(f"A passport has no key {unknown_keys[0][:40]!r}.", where=where, remedy=remedy)
        refuse_absurd_numbers(document)
        passport = Passport.from_dict(document)
        refuse_indefinite(passport)
    except json.JSONDecodeError as error:
        what = f"The file is not a passport. It is not JSON, line {error.lineno}, column {error.colno}: {error.msg}."
        raise UsageError(what, where=where, remedy=remedy) from error
    except EvidenceError as error:
        raise UsageError(error.what, where=where, remedy=error.remedy) from error
    except ValueError as error:
        raise UsageError(
            f"The file is not a passport (not JSON: {error}).", where=where, remedy=remedy
        ) from error
    except InputMismatch as error:
        raise UsageError(error.what, where=where, remedy=remedy) from error
    unknown = [name for name in passport.terms if not _is_known(name)]
    if unknown:
        raise UsageError(
            f"The passport has the unknown parameter {unknown[0]!r}.", where=where, remedy=remedy
        )
    if not passport.values_by_name["r"] > LEAST_R_MM:
        what = f"The passport's radius r is not positive, or below {LEAST_R_MM:g} mm; no collimator is that short."
        raise UsageError(what, where=where, remedy=remedy)
    return passport


def _is_known(name: str) -> bool:
    """Return whether a parameter is a term of the collimator, or a coefficient of its common field (``common_7``)."""
    return name in EXPECTED_SIGMA or (name.startswith("common_") and name.removeprefix("common_").isdecimal())


def passport_bytes(passport: Passport) -> bytes:
    """Return the bytes of a passport's file."""
    return (json.dumps(passport.to_dict(), indent=1, allow_nan=False) + "\n").encode()
