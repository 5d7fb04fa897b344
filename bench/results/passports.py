"""Passport files: what is known of a collimator from one calibration or certificate, for use in later calibrations.

A passport is one JSON object. It is written atomically and never overwrites a file. `calib.model.passport` defines its
content; this module adds the file and the conditions under which the passport was made.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from typing import Any

from bench.base.errors import UsageError
from bench.records.storage import storage_errors, write_atomic
from calib.engine import Calibration
from calib.errors import InputMismatch
from calib.model.passport import Passport

_LARGEST_BYTES = 1_000_000


def read_passport(path: Path) -> Passport:
    """Read a passport file.

    Parameters
    ----------
    path
        The file.

    Returns
    -------
    Passport
        The collimator's parameters and their covariance.

    Raises
    ------
    UsageError
        When there is no such file, or it is not a passport; the message says why.
    StorageError
        When it cannot be read.
    """
    if not path.is_file():
        raise UsageError("There is no such passport file.", where=str(path), remedy="Check the path.")
    with storage_errors(path):
        if path.stat().st_size > _LARGEST_BYTES:
            raise UsageError("The file is too large for a passport.", where=str(path))
        text = path.read_bytes()
    try:
        shape: Any = json.loads(text)
        return Passport.from_dict(shape if isinstance(shape, dict) else {})
    except (ValueError, RecursionError, InputMismatch) as error:
        what = (
            error.what
            if isinstance(error, InputMismatch)
            else f"The file is not a passport (not JSON: {error})."
        )
        raise UsageError(
            what, where=str(path), remedy="Make a passport with `starbench passport make`."
        ) from error


def write_passport(path: Path, passport: Passport) -> None:
    """Write a passport to a new file.

    Parameters
    ----------
    path
        The file.
    passport
        The passport.

    Raises
    ------
    UsageError
        When the file exists.
    StorageError
        When it cannot be written.
    """
    if path.exists():
        raise UsageError(
            "A file with this name already exists.", where=str(path), remedy="Choose another name."
        )
    write_atomic(path, (json.dumps(passport.to_dict(), indent=1, allow_nan=False) + "\n").encode())


def passport_from_calibration(
    calibration: Calibration,
    *,
    collimator: str | None,
    temperature_c: float | None,
    now: datetime,
    sources: list[str],
) -> Passport:
    """Make a passport from a calibration, with the conditions under which it was made.

    Parameters
    ----------
    calibration
        The calibration; its model must include a collimator.
    collimator
        Serial number or name of the collimator, if known.
    temperature_c
        Temperature of the bench, degrees Celsius, if known.
    now
        Time at which the passport is made, UTC.
    sources
        Names of the recordings or runs behind the calibration.

    Returns
    -------
    Passport
        The collimator's parameters and their covariance.

    Raises
    ------
    calib.errors.InputMismatch
        When the calibration has no collimator (planar model).
    """
    conditions = {
        "collimator": collimator,
        "temperature_c": temperature_c,
        "made_utc": now.isoformat(timespec="seconds"),
        "sources": sources,
        "model": calibration.model,
    }
    return calibration.passport(_without_none(conditions))


def passport_from_certificate(
    r_mm: float,
    sigma_mm: float,
    *,
    number: str,
    issued: str | None,
    collimator: str | None,
    temperature_c: float | None,
    now: datetime,
) -> Passport:
    """Make a passport from a certificate of the collimator's focal length.

    Parameters
    ----------
    r_mm
        Certified focal length, mm.
    sigma_mm
        Its standard uncertainty, mm: the expanded uncertainty of the certificate divided by its coverage factor.
    number
        Number of the certificate.
    issued
        Date of the certificate, if known.
    collimator
        Serial number or name of the collimator, if known.
    temperature_c
        Temperature at the certification, degrees Celsius, if known.
    now
        Time at which the passport is made, UTC.

    Returns
    -------
    Passport
        Passport with the focal length alone.

    Raises
    ------
    UsageError
        When focal length or uncertainty is not positive and finite.
    """
    if not (0 < r_mm < float("inf") and 0 < sigma_mm < float("inf")):
        raise UsageError(
            "The focal length and its uncertainty must be positive and finite.", where="--radius, --sigma"
        )
    conditions = {
        "certificate": number,
        "issued": issued,
        "collimator": collimator,
        "temperature_c": temperature_c,
        "made_utc": now.isoformat(timespec="seconds"),
    }
    return Passport.of_radius(r_mm, sigma_mm, _without_none(conditions))


def _without_none(conditions: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in conditions.items() if value is not None}
