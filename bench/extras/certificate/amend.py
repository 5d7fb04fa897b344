"""Amend a certificate: a new one that names the old one, and says what changed and why."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

from bench.base.bounded_json import leaves
from bench.base.errors import EvidenceError
from bench.base.pasteable import pasteable
from bench.evidence.findings import Verification
from bench.extras.certificate.certificate_data import Amends, Certificate, Change
from bench.extras.certificate.certificate_folder import (
    PLOTS,
    require_libraries,
)
from bench.extras.certificate.issue import Issued, Issuer, finished_before, make_certificate
from bench.extras.certificate.lab_config import LabConfig
from bench.extras.certificate.sealed_run import Source, written_with
from bench.extras.certificate.series import (
    numbers,
    refuse_old,
)
from bench.record.run_folder import CERTIFICATE, MANIFEST, RESULTS
from bench.record.storage import (
    read_bounded,
    require_free,
    sha256_of,
    storage_errors,
)
from bench.record.stored_run import results_of
from sequences.reader import read_document
from sequences.tree import path_text

ABSENT = "absent"
_OWN = frozenset({"number", "issued_utc", "amends"})
"""Fields that differ in every amendment."""
_PROGRAM = "run.software["
"""Programs and their versions; a new version alone is no change of the certificate."""
_MOST_CHARACTERS = 300  # A changed field stands in a table of the certificate


def amend(
    old: Path, lab_file: Path, folder: Path, laboratory: Issuer, *, reason: str, despite: str = ""
) -> Issued:
    """Issue a certificate that replaces another one: it verifies, is the newest one, and something changes.

    ``despite`` is as for `issue`; without it, the reason of the old one remains.
    """
    require_libraries()
    if finished := finished_before(folder, laboratory.ledger):
        return finished
    require_free(folder)
    lab = read_document(lab_file, LabConfig)
    before, source = _read_certificate(old, laboratory.verify(old))
    refuse_old(numbers(laboratory.ledger.entries()), before.number)
    with storage_errors(old):
        digest = sha256_of(old / MANIFEST)

    def amended(trial: Certificate) -> Amends:
        return Amends(before.number, digest, reason, changes_of(before, trial))

    return make_certificate(
        source,
        lab,
        folder,
        laboratory,
        further=before.statement("also"),
        despite=despite or before.statement("limits_reason"),
        amended=amended,
        amends=before.number,
    )


def changes_of(before: Certificate, after: Certificate) -> tuple[Change, ...]:
    """Return the fields that differ, sorted, except number, time, software and what they amend."""
    old, new = (_texts_by_path(certificate) for certificate in (before, after))
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


def _texts_by_path(certificate: Certificate) -> dict[str, str]:
    content = {name: value for name, value in json.loads(certificate.to_json()).items() if name not in _OWN}
    texts = {
        path_text(place): value if isinstance(value, str) else json.dumps(value)
        for place, value in leaves(content)
    }
    return {
        path: text if len(text) <= _MOST_CHARACTERS else f"{text[:_MOST_CHARACTERS]}..."
        for path, text in texts.items()
        if not path.startswith(_PROGRAM)
    }


def plots_in(folder: Path) -> dict[str, str]:
    """Return the plots in the folder of a certificate: SVG by name."""
    return {path.stem: path.read_text("utf-8") for path in sorted((folder / PLOTS).glob("*.svg"))}


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
            remedy=f"Amend the copy that the laboratory keeps. See all faults: {pasteable('verify', folder)}",
        )
    with storage_errors(folder):
        certificate = Certificate.from_json(read_bounded(folder / CERTIFICATE), str(folder / CERTIFICATE))
        results = read_bounded(folder / RESULTS)
        plots = plots_in(folder)
    content = results_of(results, folder / RESULTS)
    of_the_run = certificate.run.software[: len(content["run"]["software"])]
    run = replace(certificate.run, software=(*of_the_run, *written_with()))
    return certificate, Source(folder, content, results, run, plots, certificate.statement("verification"))
