"""Passport files of collimators: their bytes, and what is refused about them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from bench.base.errors import UsageError
from bench.records.storage import storage_errors
from calib.errors import InputMismatch
from calib.model.aberrations import EXPECTED_SIGMA
from calib.model.collimator import CENTRE
from calib.model.passport import Passport

_LARGEST_BYTES = 1_000_000


def determines_one_view(passport: Passport) -> bool:
    """Return whether one view is enough to calibrate a camera with a passport.

    Own count: the homography of a view has 8 degrees of freedom. With x, y and r known, the view has 7 unknowns: fx,
    fy, cx, cy and a rotation. With r alone, as a certificate states it, it has 9.

    Parameters
    ----------
    passport
        The passport.

    Returns
    -------
    bool
        True if the passport holds the collimator's whole centre.
    """
    return set(CENTRE) <= set(passport.names)


def read_passport_file(path: Path) -> tuple[Passport, bytes]:
    """Read a passport file.

    Parameters
    ----------
    path
        The file.

    Returns
    -------
    tuple of Passport and bytes
        The passport, and the bytes of the file.

    Raises
    ------
    UsageError
        When there is no such file, or it is not a passport; the message says why.
    StorageError
        When it cannot be read.
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

    Parameters
    ----------
    data
        Bytes of a passport file.
    where
        Name of the file, for messages.

    Returns
    -------
    Passport
        The collimator's parameters and their covariance.

    Raises
    ------
    UsageError
        When it is not a passport, or has a parameter that the engine does not know; the message says why.
    """
    remedy = "Make a passport with `starbench passport make` or `starbench passport certificate`."
    try:
        shape: Any = json.loads(data)
        passport = Passport.from_dict(shape if isinstance(shape, dict) else {})
    except json.JSONDecodeError as error:
        what = f"The file is not a passport. It is not JSON, line {error.lineno}, column {error.colno}: {error.msg}."
        raise UsageError(what, where=where, remedy=remedy) from error
    except (ValueError, RecursionError) as error:
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
    if not passport.values_by_name["r"] > 0:
        raise UsageError("The passport's radius r is not positive.", where=where, remedy=remedy)
    return passport


def passport_bytes(passport: Passport) -> bytes:
    """Return the bytes of a passport's file.

    Parameters
    ----------
    passport
        The passport.

    Returns
    -------
    bytes
        JSON; the same passport gives the same bytes.
    """
    return (json.dumps(passport.to_dict(), indent=1, allow_nan=False) + "\n").encode()
