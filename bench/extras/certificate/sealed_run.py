"""A sealed run as the source of a certificate: verified first, and refused if it is none. It reads the run's folder.

The certificate's list of software ends with what wrote it: the program's files by hash, and the libraries that decide
bytes; a verifier that is another program cannot expect the same bytes.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.base.errors import BenchError, EvidenceError
from bench.base.pasteable import pasteable
from bench.base.program import differing_software, hash_of_files, installed_versions
from bench.evidence.findings import Findings, Verification
from bench.extras.certificate.certificate_data import Certificate, Run, Software, sha256
from bench.extras.certificate.series import amending
from bench.record.ledger import Ledger
from bench.record.results import Results
from bench.record.run_folder import CERTIFICATE, MANIFEST, RESULTS, SEQUENCE_COPY, STATION_COPY, require_run
from bench.record.storage import read_bounded, sha256_of, storage_errors
from bench.record.stored_run import StoredRun

FORM = "certificate_form"
_LIBRARIES = ("typst", "lxml")
_FOLDER = "bench/extras/certificate"
_ENDINGS = frozenset({".py", ".typ", ".j2"})
_ALSO = (
    "bench/record/stored_calibration.py",
    "bench/report/calibration_tables.py",
    "bench/report/distortion_plot.py",
    "bench/wording/conformity.py",
    "bench/wording/earlier_runs.py",
    "bench/wording/numbers.py",
    "calib/model/camera.py",
    "calib/model/lens.py",
    "calib/uncertainty/covariance.py",
    "calib/uncertainty/projection_uncertainty.py",
)
"""Other modules whose code decides a value or a word of a certificate."""
_SEAL = "Before the issue the sealed run was verified: its seal, every file, its journal and the ledger."
_SAME = " The results were made again from the recordings, and are the same."
_NOT_MADE = " The results were not made again from the recordings."

Verify = Callable[[Path], Verification]
_MOST_NAMED = 5  # A sentence


@functools.cache
def written_with() -> tuple[Software, ...]:
    """Return what writes a certificate here: libraries, and ``certificate_form``, 16 digits of its files' SHA-256."""
    import bench

    root = Path(bench.__file__).parent.parent
    folder = root / _FOLDER
    files = [path for path in folder.rglob("*") if path.suffix in _ENDINGS and path.parent == folder]
    form = hash_of_files(root, [*files, *(root / name for name in _ALSO)])
    installed = installed_versions(_LIBRARIES)
    return (Software(FORM, form), *(Software(name, version) for name, version in installed.items()))


def other_writer(software: tuple[Software, ...]) -> str:
    """Return how the program that wrote a certificate differs, as ``typst 0.14 (here 0.15)``; empty if it does not."""
    stated, here = (
        {program.name: program.version for program in every} for every in (software, written_with())
    )
    return differing_software(stated, here)


def statement_of(verification: Verification) -> str:
    """Return the sentence that states what was verified."""
    return _SEAL + (_SAME if verification.again else _NOT_MADE)


def is_statement(text: str) -> bool:
    """Return whether a sentence is one that `statement_of` makes."""
    return text in {_SEAL + _SAME, _SEAL + _NOT_MADE}


def check_run_of_certificate(
    folder: Path, ledger: Ledger, verify_run: Callable[[Path], Verification]
) -> Findings:
    """Make the results of a certificate's run again from its recordings, if it lies where the ledger says."""
    findings = Findings()
    certificate = Certificate.from_json(read_bounded(folder / CERTIFICATE))
    seal = certificate.run.seal_sha256
    try:
        places = [Path(run.folder) for run in ledger.runs() if run.seal == seal]
    except BenchError as error:
        findings.not_compared.append(f"the ledger of this bench cannot be read: {error.what.rstrip('.')}")
        return findings
    here = [path for path in places if (path / MANIFEST).is_file() and sha256_of(path / MANIFEST) == seal]
    if not here:
        where = f"not in {places[0]} any more" if places else "not in the ledger of this bench"
        findings.not_compared.append(
            f"{RESULTS} with the recordings: the run {certificate.run.id} is {where}, so they were not made again"
        )
        return findings
    run = verify_run(here[0])
    for fault in run.faults:
        findings.fault(fault.kind, f"{here[0]}/{fault.where}", fault.what)
    findings.not_compared += run.not_compared
    findings.not_confirmed += run.not_confirmed
    if run.complete:
        findings.remarks.append(f"the results of the run in {here[0]} were made again from its recordings")
    return findings


@dataclass(frozen=True)
class Source:
    """What a certificate is made from."""

    folder: Path  # Of the run, or of the certificate that is amended
    results: Results
    results_bytes: bytes
    run: Run
    plots: Mapping[str, str]
    verified: str


def read_sealed_run(folder: Path, verify: Verify) -> Source:
    """Verify a finished run with ``verify``, and read what a certificate needs; `EvidenceError` if it may have none."""
    if not StoredRun(folder).is_sealed:
        require_run(folder)
        raise EvidenceError(
            "This run is not sealed: a certificate is made from a sealed run only.",
            where=str(folder),
            remedy=f"Let the run end: {pasteable('resume', folder)}",
        )
    verification = verify(folder)
    _refuse_unverified(folder, verification)
    if not verification.complete:
        what = [*verification.not_confirmed, *verification.not_compared]
        raise EvidenceError(
            f"This version does not confirm all results of this run: {'; '.join(what[:_MOST_NAMED])}.",
            where=str(folder),
            remedy="Issue the certificate with the version that made the run, or run the sequence again with this one.",
        )
    with storage_errors(folder):
        stored = StoredRun(folder)
        _refuse_other_than_finished(stored)
        if not stored.has_results:
            raise EvidenceError("This run has no results.", where=str(folder), remedy="Add a solve step.")
        results, results_bytes, seal = stored.results, stored.results_bytes, stored.seal
    _refuse_unfit(folder, results)
    from bench.extras.certificate.pdf import plots_of_run

    hashes = stored.history.started.get("sha256", {})
    run = Run(
        **stated_run(results, results_bytes, written_with()),
        journal_head=stored.head,
        sequence_sha256=hashes.get(SEQUENCE_COPY, ""),
        station_sha256=hashes.get(STATION_COPY, ""),
        seal_sha256=seal,
        signer=verification.signer or "",
        signer_fingerprint=verification.fingerprint or "",
    )
    return Source(
        folder, results, results_bytes, run, plots_of_run(folder, results), statement_of(verification)
    )


def stated_run(results: Results, results_bytes: bytes, written: tuple[Software, ...]) -> dict[str, Any]:
    """Return the fields of a `Run` that results.json states; only the sealed folder can give the others."""
    run = results["run"]
    place: Mapping[str, Any] = run.get("ledger") or {}
    used = (Software(str(name), str(version)) for name, version in run["software"].items())
    return {
        "id": str(run["id"]),
        "sequence": str(run["sequence"]),
        "station": str(run["station"]),
        "ledger_number": int(place["number"]) if "number" in place else None,
        "ledger_head": str(place.get("head") or ""),
        "results_sha256": sha256(results_bytes),
        "software": (*used, *written),
    }


def _refuse_unfit(folder: Path, results: Results) -> None:
    if results["run"].get("board"):
        raise EvidenceError(
            "This run recorded a board: a certificate is made from runs with the star target only.",
            where=str(folder),
            remedy="Run a sequence on the collimator bench.",
        )
    if not results["calibration"]["converged"]:
        raise EvidenceError(
            "The calibration of this run did not converge.", where=str(folder), remedy="Run it again."
        )


def _refuse_unverified(folder: Path, verification: Verification) -> None:
    if verification.kind != "run":
        raise EvidenceError(
            f"This folder is a {verification.kind} folder, not a run.",
            where=str(folder),
            remedy=f"To amend it: {amending(str(folder))}."
            if verification.kind == "certificate"
            else "Name the folder of a sealed run.",
        )
    what = [str(fault) for fault in verification.faults]
    if what:
        more = f"; and {len(what) - _MOST_NAMED} more" if len(what) > _MOST_NAMED else ""
        raise EvidenceError(
            f"The run does not verify: {'; '.join(what[:_MOST_NAMED])}{more}.",
            where=str(folder),
            remedy=f"See all faults: {pasteable('verify', folder)}",
        )


def _refuse_other_than_finished(run: StoredRun) -> None:
    if run.is_rehearsal:
        raise EvidenceError(
            "This is a rehearsal: nothing was measured.", where=str(run.folder), remedy="Name a sealed run."
        )
    if run.history.ended != "finished":
        raise EvidenceError(
            f"This run did not finish: it {run.history.ended or 'has no end'}.",
            where=str(run.folder),
            remedy=f"Run it again, or continue it: {pasteable('resume', run.folder)}",
        )
