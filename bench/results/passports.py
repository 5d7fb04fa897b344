"""Passport files: a collimator as known from one calibration, kept for all that follow.

A passport is one JSON object, written whole and never over another. What it holds, and what it is worth, is the
engine's (`calib.model.passport`); here are the file, and the conditions under which it was made.
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

    Raises
    ------
    UsageError
        When it is no passport; the message says why.
    StorageError
        When it cannot be read.
    """
    if not path.is_file():
        raise UsageError("There is no such passport.", where=str(path), remedy="Check the path.")
    with storage_errors(path):
        if path.stat().st_size > _LARGEST_BYTES:
            raise UsageError("This file is too large for a passport.", where=str(path))
        text = path.read_bytes()
    try:
        shape: Any = json.loads(text)
        return Passport.from_dict(shape if isinstance(shape, dict) else {})
    except (ValueError, RecursionError, InputMismatch) as error:
        what = error.what if isinstance(error, InputMismatch) else f"Not JSON: {error}."
        raise UsageError(what, where=str(path), remedy="Make one by `starbench passport make`.") from error


def write_passport(path: Path, passport: Passport) -> None:
    """Write a passport to a new file.

    Raises
    ------
    UsageError
        When the file exists.
    StorageError
        When it cannot be written.
    """
    if path.exists():
        raise UsageError("A file of this name exists.", where=str(path), remedy="Choose another name.")
    write_atomic(path, (json.dumps(passport.to_dict(), indent=1, allow_nan=False) + "\n").encode())


def passport_from_calibration(
    calibration: Calibration,
    *,
    collimator: str | None,
    temperature_c: float | None,
    now: datetime,
    sources: list[str],
) -> Passport:
    """Take the passport out of a calibration, with the conditions under which it was made.

    Raises
    ------
    calib.errors.InputMismatch
        When the calibration knows no collimator (the planar model).
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
    """Make a passport from a certificate of the collimator's focal length and its standard uncertainty.

    Raises
    ------
    UsageError
        When one of them is not positive.
    """
    if not (0 < r_mm < float("inf") and 0 < sigma_mm < float("inf")):
        raise UsageError("A focal length and its uncertainty are positive.", where="--radius, --sigma")
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
