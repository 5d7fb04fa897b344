"""Numbers that certificates in a folder have: a ledger that was restored from an older copy does not know of them."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

from bench.base.bounded_json import parse_json
from bench.base.errors import BenchError
from bench.evidence.ledger_check import is_sealed_by
from bench.extras.certificate.series import number_pattern
from bench.record.run_folder import CERTIFICATE
from bench.record.storage import read_bounded, storage_errors


def count_beside(folder: Path, own_keys: Collection[bytes], series: str) -> int:
    """Return the highest count of a series among the certificates in a folder that this bench has sealed, or 0."""
    pattern, highest = number_pattern(series), 0
    with storage_errors(folder):
        paths = sorted(folder.glob(f"*/{CERTIFICATE}")) if folder.is_dir() else []
    for path in paths:
        try:
            number = parse_json(read_bounded(path)).get("number", "")
        except (BenchError, ValueError, AttributeError):  # it is no certificate
            continue
        match = pattern.fullmatch(str(number))
        if match is not None and int(match["count"]) > highest and is_sealed_by(path.parent, own_keys):
            highest = int(match["count"])
    return highest
