"""Passport files: what is known of a collimator from one calibration, for use in later calibrations.

A passport is one JSON object, `calib.model.passport` with its conditions, and never overwrites a file.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

from bench.base.errors import UsageError
from bench.evidence.keys import BenchKey
from bench.evidence.passport_seal import seal_passport
from bench.plan.passport_file import passport_bytes, read_passport_file
from bench.record.run_folder import MANIFEST, is_sealed
from bench.record.storage import sha256_of, storage_errors, write_new
from calib.engine import Calibration
from calib.model.passport import Passport


def sealed_bytes(passport: Passport, key: BenchKey | None = None) -> bytes:
    """Return the file of a passport, sealed if there is a key."""
    data = passport_bytes(passport)
    return seal_passport(data, key) if key is not None else data


def seal_file(path: Path, output: Path, key: BenchKey) -> None:
    """Write a sealed copy of a passport that has no seal, to a new file."""
    passport, _, seal = read_passport_file(path)
    if seal is not None:
        raise UsageError(f"This passport is sealed already, by {seal.fingerprint}.", where=str(path))
    write_new(output, sealed_bytes(passport, key))


def seals_of(paths: Sequence[Path]) -> dict[str, str]:
    """Return the SHA-256 of ``SHA256SUMS`` of the sealed runs among a passport's sources: it is bound to them."""
    seals = {}
    for path in paths:
        with storage_errors(path):
            if path.is_dir() and is_sealed(path):
                seals[path.resolve().name] = sha256_of(path / MANIFEST)
    return seals


def passport_from_calibration(
    calibration: Calibration,
    *,
    collimator: str | None,
    temperature_c: float | None,
    now: datetime,
    sources: list[str],
    seals: Mapping[str, str] | None = None,
) -> Passport:
    """Make a passport from a calibration and its conditions; ``seals`` are hashes of sealed sources, by name."""
    conditions = {
        "collimator": collimator,
        "temperature_c": temperature_c,
        "made_utc": now.isoformat(timespec="seconds"),
        "sources": sources,
        "seals": dict(seals) if seals else None,
        "model": calibration.model,
    }
    return calibration.passport(_without_none(conditions))


def _without_none(conditions: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in conditions.items() if value is not None}
