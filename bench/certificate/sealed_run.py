"""A sealed run as the source of a certificate: verified first, and refused if it is none. It reads the run's folder."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.base.bounded_json import parse_json
from bench.base.errors import EvidenceError
from bench.certificate.certificate_data import Run, Software, sha256
from bench.certificate.check_run import statement_of
from bench.certificate.written_with import written_with
from bench.evidence.findings import Verification
from bench.records.events import Event
from bench.records.journal import read_journal
from bench.records.reading import read_bounded
from bench.records.results import Results
from bench.records.run_folder import JOURNAL, MANIFEST, RESULTS, is_sealed
from bench.records.storage import sha256_of, storage_errors

Verify = Callable[[Path], Verification]
_MOST_NAMED = 5


@dataclass(frozen=True)
class Source:
    """What a certificate is made from."""

    found: Results
    results: bytes
    run: Run
    plots: Mapping[str, str]
    verified: str


def read_sealed_run(folder: Path, verify: Verify, *, accept_not_compared: bool = False) -> Source:
    """Verify a run, and read what a certificate needs.

    verify: Verifies a sealed folder, as the command `verify` does.
    accept_not_compared: Whether a run may have parts that could not be made again.
    Raises EvidenceError: When the run is not sealed, does not verify, was not finished, is a rehearsal, or
      has no converged result.
    Raises RunFolderError, StorageError: When it is no run folder, or cannot be read.
    """
    if not is_sealed(folder):
        raise EvidenceError(
            "This run is not sealed: a certificate is made from a sealed run only.",
            where=str(folder),
            remedy="Let the run end: `starbench resume`.",
        )
    verification = verify(folder)
    _refuse_unverified(folder, verification)
    if verification.not_compared and not accept_not_compared:
        raise EvidenceError(
            f"Not all results of this run could be compared: {'; '.join(verification.not_compared[:_MOST_NAMED])}.",
            where=str(folder),
            remedy="Issue the certificate with the version that made the run. If its seal is enough for you, use"
            " --accept-not-compared: the certificate then states it.",
        )
    with storage_errors(folder):
        entries, _ = read_journal(folder / JOURNAL)
        _refuse_other_than_finished(folder, [(entry.event, entry.data) for entry in entries])
        if not (folder / RESULTS).is_file():
            raise EvidenceError("This run has no results.", where=str(folder), remedy="Add a solve step.")
        results = read_bounded(folder / RESULTS)
        seal = sha256_of(folder / MANIFEST)
    found = parse_json(results)
    if not found["calibration"]["converged"]:
        raise EvidenceError(
            "The calibration of this run did not converge.", where=str(folder), remedy="Run it again."
        )
    from bench.certificate.pdf_plots import plots_of_run

    run = run_of(
        found,
        results,
        journal_head=entries[-1].hash,
        seal_sha256=seal,
        signer=verification.signer or "",
        signer_fingerprint=verification.fingerprint or "",
        written=written_with(),
    )
    return Source(found, results, run, plots_of_run(folder, found), statement_of(verification))


def run_of(
    found: Results,
    results: bytes,
    *,
    journal_head: str,
    seal_sha256: str,
    signer: str,
    signer_fingerprint: str,
    written: tuple[Software, ...],
) -> Run:
    """Return a run as a certificate names it: what results.json states, and what only the sealed folder can give.

    journal_head, seal_sha256, signer, signer_fingerprint: As the attributes of `Run`.
    written: What writes the certificate, from `bench.certificate.written_with`.
    """
    run = found["run"]
    place: Mapping[str, Any] = run.get("ledger") or {}
    return Run(
        id=str(run["id"]),
        sequence=str(run["sequence"]),
        station=str(run["station"]),
        ledger_number=int(place["number"]) if "number" in place else None,
        ledger_head=str(place.get("head") or ""),
        journal_head=journal_head,
        seal_sha256=seal_sha256,
        results_sha256=sha256(results),
        signer=signer,
        signer_fingerprint=signer_fingerprint,
        software=(
            *(Software(str(name), str(version)) for name, version in run["software"].items()),
            *written,
        ),
    )


def _refuse_unverified(folder: Path, verification: Verification) -> None:
    if verification.kind != "run":
        raise EvidenceError(
            f"This folder is a {verification.kind} folder, not a run.",
            where=str(folder),
            remedy="Name the folder of a sealed run; to amend a certificate: `starbench certificate issue` with its"
            " folder.",
        )
    what = [str(fault) for fault in verification.faults]
    if what:
        more = f"; and {len(what) - _MOST_NAMED} more" if len(what) > _MOST_NAMED else ""
        raise EvidenceError(
            f"The run does not verify: {'; '.join(what[:_MOST_NAMED])}{more}.",
            where=str(folder),
            remedy="Check it with `starbench verify`.",
        )


def _refuse_other_than_finished(folder: Path, lines: list[tuple[str, Mapping[str, Any]]]) -> None:
    started = lines[0][1] if lines else {}
    if started.get("rehearsal"):
        raise EvidenceError(
            "This is a rehearsal: nothing was measured.", where=str(folder), remedy="Name a sealed run."
        )
    ended: Mapping[str, Any] = next((data for event, data in reversed(lines) if event == Event.RUN_ENDED), {})
    if ended.get("how") != "finished":
        raise EvidenceError(
            f"This run did not finish: it {ended.get('how') or 'has no end'}.",
            where=str(folder),
            remedy="Continue it with `starbench resume`, or run it again.",
        )
