"""The folder of a certificate, as `verify` must know it. What the checks need is imported when they are made."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from bench.evidence.findings import Derivation, Findings
from bench.evidence.folder_kinds import FolderKind, VerifyRun
from bench.record.ledger import bench_ledger
from bench.record.run_folder import CERTIFICATE


def _checks(verify_run: VerifyRun | None) -> Sequence[Derivation]:
    """Return the checks of a certificate; with --again also that of its run, from the recordings."""
    if verify_run is None:
        return [_check]

    def of_run(folder: Path) -> Findings:
        from bench.extras.certificate.sealed_run import check_run_of_certificate

        return check_run_of_certificate(folder, bench_ledger(), verify_run)

    return [_check, of_run]


def _check(folder: Path) -> Findings:
    """Derive a certificate again, and compare it with the ledger of this bench."""
    from bench.extras.certificate.check import check_certificate

    return check_certificate(folder, bench_ledger())


CERTIFICATE_FOLDER = FolderKind(
    "certificate",
    "certificate",
    "a calibration certificate made by Starbench",
    "Certificate of run",
    re.compile(
        r"certificate\.json|results\.json|lab\.yaml|dcc\.xml|certificate\.pdf|VERIFY\.txt"
        r"|plots/(uncertainty|direction|coverage|vectors|regions|distortion)\.svg"
    ),
    """
certificate.json names the person who is to authorise it (authorised_by), with the fingerprint of the
person's key. ssh-keygen must print the same fingerprint.
""",
    {CERTIFICATE: False},
    _checks,
)
