"""Amend a certificate: a new number that replaces the old one, names it by hash, and says what changed.

The old certificate stays as it is. The results are those of the old certificate; results of another run are another
certificate.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

from bench.base.bounded_json import parse_json
from bench.base.errors import EvidenceError
from bench.certificate.certificate_data import CERTIFICATE, Amends, Certificate, Change
from bench.certificate.folder import PLOTS, refuse_occupied, require_libraries
from bench.certificate.issue import Issued, Laboratory, make_certificate
from bench.certificate.lab_config import read_lab
from bench.certificate.sealed_run import Source
from bench.certificate.series import refuse_old
from bench.certificate.series_numbers import numbers
from bench.certificate.written_with import written_with
from bench.evidence.findings import Verification
from bench.records.reading import read_bounded
from bench.records.run_folder import MANIFEST, RESULTS
from bench.records.storage import sha256_of, storage_errors

ABSENT = "absent"
_OWN = frozenset({"number", "issued_utc", "amends"})
"""Fields that differ in every amendment."""
_PROGRAM = "run.software["
"""Programs and their versions; a new version alone is no change of the certificate."""
_MOST_CHARACTERS = 300


def amend(old: Path, lab_file: Path, folder: Path, laboratory: Laboratory, *, reason: str) -> Issued:
    """Issue a certificate that replaces another one.

    Raises DocumentFaults, UsageError, StorageError: As `bench.certificate.issue.issue`.
    Raises EvidenceError: When the old certificate does not verify, is not the newest one, or nothing would
      change.
    """
    require_libraries()
    refuse_occupied(folder)
    lab = read_lab(lab_file)
    before, source = _read_certificate(old, laboratory.verify(old))
    refuse_old(numbers(laboratory.ledger.entries()), before.number)
    with storage_errors(old):
        digest = sha256_of(old / MANIFEST)

    def amended(trial: Certificate) -> Amends:
        return Amends(before.number, digest, reason, changes_of(before, trial))

    return make_certificate(
        source, lab, folder, laboratory, also=_also(before), amended=amended, amends=before.number
    )


def changes_of(before: Certificate, after: Certificate) -> tuple[Change, ...]:
    """Return the fields that differ between two certificates, except number, time, software and what they amend.

    Returns: Each with its path, sorted as in certificate.json.
    Raises EvidenceError: When nothing differs.
    """
    old, new = (_leaves(json.loads(one.to_json())) for one in (before, after))
    paths = dict.fromkeys([*old, *new])
    changes = tuple(
        Change(path, old.get(path, ABSENT), new.get(path, ABSENT))
        for path in paths
        if old.get(path) != new.get(path)
    )
    if not changes:
        raise EvidenceError(
            f"Nothing would change: this lab.yaml gives the certificate {before.number} again.",
            remedy="Correct lab.yaml first.",
        )
    return changes


def _leaves(found: dict[str, Any]) -> dict[str, str]:
    leaves: dict[str, str] = {}

    def walk(value: Any, path: str) -> None:
        if isinstance(value, dict) and value:
            for name, inner in value.items():
                walk(inner, f"{path}.{name}" if path else name)
        elif isinstance(value, list) and value:
            for at, inner in enumerate(value):
                walk(inner, f"{path}[{at}]")
        else:
            text = value if isinstance(value, str) else json.dumps(value)
            leaves[path] = text if len(text) <= _MOST_CHARACTERS else f"{text[:_MOST_CHARACTERS]}..."

    walk({name: value for name, value in found.items() if name not in _OWN}, "")
    return {path: text for path, text in leaves.items() if not path.startswith(_PROGRAM)}


def _also(before: Certificate) -> str:
    """Return why the amended certificate was a further one of its run; the new one is it, too."""
    return before.statement("also").partition("Reason: ")[2]


def _read_certificate(folder: Path, verification: Verification) -> tuple[Certificate, Source]:
    if verification.kind != "certificate":
        raise EvidenceError(
            f"This folder is a {verification.kind} folder, not a certificate.",
            where=str(folder),
            remedy="Name the folder of a certificate.",
        )
    if not verification.ok:
        what = "; ".join(str(fault) for fault in verification.faults[:5])
        raise EvidenceError(
            f"The certificate does not verify: {what}.",
            where=str(folder),
            remedy="Check it with `starbench verify`. Amend the copy that the laboratory keeps.",
        )
    with storage_errors(folder):
        certificate = Certificate.from_json(read_bounded(folder / CERTIFICATE), str(folder / CERTIFICATE))
        results = read_bounded(folder / RESULTS)
        plots = {path.stem: path.read_text("utf-8") for path in sorted((folder / PLOTS).glob("*.svg"))}
    found = parse_json(results)
    of_the_run = certificate.run.software[: len(found["run"]["software"])]
    run = replace(certificate.run, software=(*of_the_run, *written_with()))
    return certificate, Source(found, results, run, plots, certificate.statement("verification"))
