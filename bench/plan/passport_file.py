"""Passport files of collimators: their bytes, and what is refused about them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from bench.base.bounded_json import parse_json
from bench.base.errors import EvidenceError, UsageError
from bench.evidence.passport_seal import read_passport_seal
from bench.plan.passport_numbers import LEAST_R_MM, refuse_absurd_numbers, refuse_indefinite
from bench.records.storage import storage_errors
from calib.errors import InputMismatch
from calib.model.aberrations import EXPECTED_SIGMA
from calib.model.collimator import CENTRE
from calib.model.passport import Passport

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
    unknown = [name for name in passport.terms if name not in EXPECTED_SIGMA]
    if unknown:
        raise UsageError(
            f"The passport has the unknown parameter {unknown[0]!r}.", where=where, remedy=remedy
        )
    if not passport.values_by_name["r"] > LEAST_R_MM:
        what = f"The passport's radius r is not positive, or below {LEAST_R_MM:g} mm; no collimator is that short."
        raise UsageError(what, where=where, remedy=remedy)
    return passport


def passport_bytes(passport: Passport) -> bytes:
    """Return the bytes of a passport's file."""
    return (json.dumps(passport.to_dict(), indent=1, allow_nan=False) + "\n").encode()
