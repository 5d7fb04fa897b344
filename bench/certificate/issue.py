"""Issue a certificate: verify the run, take a number, render, seal, and enter it in the ledger.

Nothing is asked and nothing is authorised here: the certificate is SEALED, and a person authorises it later. Everything
that can be refused is refused before a number is taken.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path

from bench.base.errors import EvidenceError
from bench.certificate import run_facts
from bench.certificate.certificate_data import CERTIFICATE, Amends, Certificate
from bench.certificate.compose import Identity, compose
from bench.certificate.contradictions import faults_of_lab
from bench.certificate.dcc import render_dcc
from bench.certificate.folder import (
    certificate_files,
    refuse_occupied,
    remove_unfinished,
    require_libraries,
    write_sealed,
)
from bench.certificate.lab_config import LabConfig, read_lab
from bench.certificate.sealed_run import Source, Verify, read_sealed_run
from bench.certificate.series import Wanted, enter_issued, one_at_a_time, refuse_second, reserve
from bench.certificate.series_numbers import Numbered, numbers, open_numbers
from bench.evidence.keys import BenchKey
from bench.records.ledger import Ledger
from bench.records.reading import read_bounded
from bench.records.run_folder import MANIFEST, is_sealed
from bench.records.storage import sha256_of, storage_errors
from sequences.errors import DocumentFaults
from sequences.reader import Located


@dataclass(frozen=True)
class Laboratory:
    """What a laboratory needs to issue certificates."""

    ledger: Ledger
    # Returns the bench's key; called only when nothing speaks against the certificate.
    key: Callable[[], BenchKey]
    utc_now: Callable[[], datetime]  # Returns the present time, with its time zone
    verify: Verify
    # Signs a DCC with the laboratory's key, given the time of signing; None for DCCs without a signature.
    sign_dcc: Callable[[bytes, datetime], bytes] | None = None


@dataclass(frozen=True)
class Issued:
    """A certificate that was issued."""

    certificate: Certificate
    folder: Path
    seal: str  # SHA-256 of its SHA256SUMS
    completed: tuple[str, ...] = ()


def issue(
    run: Path,
    lab_file: Path,
    folder: Path,
    laboratory: Laboratory,
    *,
    also: str = "",
    accept_not_compared: bool = False,
) -> Issued:
    """Issue the certificate of a sealed run.

    also: Why a second certificate of the run is needed; empty: a second one is refused.
    accept_not_compared: Whether a run may have parts that could not be made again from the recordings.
    Raises DocumentFaults: With all faults of lab.yaml: clauses without an answer, and contradictions to the
      run.
    Raises EvidenceError: When the run is refused, it has a certificate already, or the series of numbers is
      not in order.
    Raises UsageError: When the folder exists, or a library is missing.
    Raises StorageError: When a file cannot be read or written.
    """
    require_libraries()
    refuse_occupied(folder)
    lab = read_lab(lab_file)
    _refuse_second_early(run, laboratory.ledger, also)
    source = read_sealed_run(run, laboratory.verify, accept_not_compared=accept_not_compared)
    return make_certificate(source, lab, folder, laboratory, also=also)


def make_certificate(
    source: Source,
    lab: Located[LabConfig],
    folder: Path,
    laboratory: Laboratory,
    *,
    also: str = "",
    amended: Callable[[Certificate], Amends] | None = None,
    amends: str = "",
) -> Issued:
    """Make, seal and enter a certificate of a run that was verified.

    also: Why a second certificate of the run is needed; empty if it is the first one.
    amended: Returns what the certificate amends, given the certificate without that; None if it amends none.
    amends: Number of the certificate that it replaces; empty if none.
    Raises DocumentFaults, EvidenceError, UsageError, StorageError: As `issue`.
    """
    folder = folder.absolute()
    try:
        if faults := faults_of_lab(lab, source.found):
            raise DocumentFaults(faults, lab.tree)
        trial_identity = Identity("0", "1970-01-01T00:00:00Z", source.run, None, also, source.verified)
        trial = compose(source.found, lab.value, trial_identity)
    except (LookupError, TypeError, AttributeError, ArithmeticError) as error:
        raise EvidenceError(
            f"The results are not of the form that this version reads ({error!r}).",
            where=source.run.id,
            remedy="Issue the certificate with the version that made the run, or calibrate again.",
        ) from error
    with one_at_a_time(laboratory.ledger.home):
        completed = complete_open(laboratory.ledger)
        key = laboratory.key()
        now = laboratory.utc_now()
        if laboratory.sign_dcc is not None:  # a key that cannot sign is refused before a number is taken
            laboratory.sign_dcc(render_dcc(trial), now)
        replaced = None if amended is None else amended(trial)
        number = reserve(laboratory.ledger, _wanted(source, lab.value, folder, amends, also), now)
        identity = replace(
            trial_identity, number=number.number, issued_utc=number.issued_utc, amends=replaced
        )
        certificate = compose(source.found, lab.value, identity)
        sign = _signer(laboratory, number.issued_utc)
        files = certificate_files(
            certificate, source.found, source.results, lab.text, source.plots, sign=sign
        )
        seal = write_sealed(folder, files, key)
        _enter(laboratory.ledger, certificate, seal)
    return Issued(certificate, folder, seal, tuple(completed))


def _refuse_second_early(run: Path, ledger: Ledger, also: str) -> None:
    """Refuse a second certificate before the run is verified, which takes seconds."""
    with storage_errors(run):
        if not (run / MANIFEST).is_file():
            return
        seal = sha256_of(run / MANIFEST)
    found = numbers(ledger.entries())
    if not open_numbers(found):  # an open number may be that of the first certificate
        refuse_second(found, Wanted("", False, seal, "", "", also=also))


def complete_open(ledger: Ledger) -> list[str]:
    """Settle open numbers: enter those whose folder is complete, and remove the half made folders of the others.

    ledger: The laboratory's ledger.
    Raises EvidenceError, JournalBroken, StorageError: When the ledger is not valid or cannot be written.
    """
    done = []
    for one in open_numbers(numbers(ledger.entries())):
        certificate = finished_certificate(one)
        if certificate is not None:
            with storage_errors(Path(one.folder)):
                seal = sha256_of(Path(one.folder) / MANIFEST)
            _enter(ledger, certificate, seal)
            done.append(one.number)
        elif one.folder:
            remove_unfinished(Path(one.folder))
    return done


def finished_certificate(one: Numbered) -> Certificate | None:
    """Return the certificate that lies in the folder of a number, sealed.

    Returns: None if there is none, or if it has another number.
    Raises EvidenceError: When its certificate.json is not of the expected form.
    Raises StorageError: When it cannot be read.
    """
    folder = Path(one.folder)
    if not one.folder or not is_sealed(folder) or not (folder / CERTIFICATE).is_file():
        return None
    data = read_bounded(folder / CERTIFICATE)
    certificate = Certificate.from_json(data, str(folder / CERTIFICATE))
    return certificate if certificate.number == one.number else None


def _signer(laboratory: Laboratory, utc: str) -> Callable[[bytes], bytes] | None:
    """Return what signs a DCC at a time; None if DCCs are not signed."""
    sign = laboratory.sign_dcc
    return None if sign is None else lambda dcc: sign(dcc, datetime.fromisoformat(utc))


def _wanted(source: Source, lab: LabConfig, folder: Path, amends: str, also: str) -> Wanted:
    return Wanted(
        number_format=lab.numbers.format,
        simulated=bool(source.found["run"]["simulated"]),
        run_seal=source.run.seal_sha256,
        run_id=source.run.id,
        folder=str(folder),
        amends=amends,
        also=also,
        ended_utc=run_facts.utc_seconds(source.found["run"]["finished_utc"]),
    )


def _enter(ledger: Ledger, certificate: Certificate, seal: str) -> None:
    serial, customer = certificate.item.camera.serial, certificate.customer.name
    enter_issued(ledger, certificate.number, seal=seal, serial=serial, customer=customer)
