"""Issue a certificate: verify the run, take a number, render, seal, and enter it in the ledger; or amend one.

A person authorises it later. All refusals come before a number is taken. An amendment has a new number and the results
of the old certificate, which it names by hash; the old one stays as it is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import datetime
from functools import partial
from pathlib import Path

from bench.base.errors import EvidenceError, UsageError
from bench.base.pasteable import pasteable
from bench.evidence.keys import BenchKey
from bench.evidence.ledger_check import own_public_keys
from bench.extras.certificate import facts_of_run
from bench.extras.certificate.beside import count_beside
from bench.extras.certificate.budget_rows import BudgetDiffers
from bench.extras.certificate.certificate_data import Amends, Certificate
from bench.extras.certificate.certificate_folder import (
    certificate_files,
    require_libraries,
    write_sealed,
)
from bench.extras.certificate.clauses import faults_of_lab
from bench.extras.certificate.compose import FURTHER, Identity, compose
from bench.extras.certificate.lab_config import LabConfig
from bench.extras.certificate.limits import needed_reason
from bench.extras.certificate.sealed_run import Source, Verify, read_sealed_run
from bench.extras.certificate.series import (
    Numbered,
    Wanted,
    enter_issued,
    numbers,
    one_at_a_time,
    open_numbers,
    refuse_second,
    reserve,
)
from bench.extras.certificate.verdicts import verdict_history
from bench.record.ledger import Ledger
from bench.record.run_folder import CERTIFICATE, MANIFEST, RESULTS, is_sealed
from bench.record.storage import (
    discard_unfinished,
    read_bounded,
    require_free,
    sha256_of,
    storage_errors,
)
from sequences.errors import DocumentFaults
from sequences.reader import Located, read_document


@dataclass(frozen=True)
class Issuer:
    """What a laboratory needs to issue certificates."""

    ledger: Ledger
    # Returns the bench's key; called only when nothing speaks against the certificate.
    key: Callable[[], BenchKey]
    utc_now: Callable[[], datetime]  # Returns the present time, with its time zone
    verify: Verify


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
    laboratory: Issuer,
    *,
    also: str = "",
    despite: str = "",
) -> Issued:
    """Issue the certificate of a sealed run; raises `DocumentFaults` with all faults of lab.yaml.

    Without ``also``, the reason, a second one is refused; without ``despite``, one whose own limits pass over a FAIL of
    the run.
    """
    require_libraries()
    if finished := finished_before(folder, laboratory.ledger):
        return finished
    require_free(folder)
    lab = read_document(lab_file, LabConfig)
    _refuse_second_early(run, laboratory.ledger, also)
    source = read_sealed_run(run, laboratory.verify)
    return make_certificate(
        source,
        lab,
        folder,
        laboratory,
        further=f"{FURTHER}{also}" if also else "",
        despite=despite,
    )


def make_certificate(
    source: Source,
    lab: Located[LabConfig],
    folder: Path,
    laboratory: Issuer,
    *,
    further: str = "",
    despite: str = "",
    amended: Callable[[Certificate], Amends] | None = None,
    amends: str = "",
) -> Issued:
    """Make, seal and enter the certificate of a verified run.

    ``further`` is the statement of a second one, ``despite`` why its own limits may pass over a FAIL of the run,
    ``amends`` the number that it replaces; each may be empty. ``amended`` returns what it amends, given the certificate
    without that; None if it amends none.
    """
    folder = folder.absolute()
    verdicts = verdict_history(laboratory.ledger.runs(), source.results, lab.value)
    trial_identity, trial = _tried(source, lab, further, despite, verdicts)
    key = laboratory.key()  # before the others wait: it may ask for a passphrase
    with one_at_a_time(laboratory.ledger.home):
        completed = complete_open(laboratory.ledger)
        now = laboratory.utc_now()
        replaced = None if amended is None else amended(trial)
        wanted = replace(
            _wanted(source, lab.value, folder, amends, further),
            count_beside=partial(count_beside, folder.parent, own_public_keys(laboratory.ledger.home)),
        )
        number = reserve(laboratory.ledger, wanted, now)
        identity = replace(
            trial_identity, number=number.number, issued_utc=number.issued_utc, amends=replaced
        )
        certificate = compose(source.results, lab.value, identity)
        files = certificate_files(certificate, source.results, source.results_bytes, lab.text, source.plots)
        seal = write_sealed(folder, files, key)
        _enter(laboratory.ledger, certificate, seal)
    return Issued(certificate, folder, seal, tuple(completed))


def _tried(
    source: Source, lab: Located[LabConfig], further: str, despite: str, verdicts: str
) -> tuple[Identity, Certificate]:
    """Compose the certificate without a number, so that none is taken for one that cannot be issued."""
    try:
        if faults := faults_of_lab(lab, source.results, source.run.sequence_sha256):
            raise DocumentFaults(faults, lab.tree)
        identity = Identity(
            "0", "1970-01-01T00:00:00Z", source.run, None, further, despite, source.verified, verdicts
        )
        trial = compose(source.results, lab.value, identity)
        reason = needed_reason(source.results, lab.value, trial.conformity, despite)
        if reason != despite:  # an amended one may not need it any more
            identity = replace(identity, despite=reason)
            trial = compose(source.results, lab.value, identity)
    except BudgetDiffers as error:
        raise EvidenceError(
            error.what,
            where=str(source.folder / RESULTS),
            remedy=f"Compare the numbers with the recordings, and report this: "
            f"`{pasteable('verify', source.folder, '--again')}`.",
        ) from error
    except (LookupError, TypeError, AttributeError, ArithmeticError) as error:
        raise EvidenceError(
            f"The results are not of the form that this version reads ({error!r}).",
            where=source.run.id,
            remedy="Issue the certificate with the version that made the run, or calibrate again.",
        ) from error
    return identity, trial


def _refuse_second_early(run: Path, ledger: Ledger, also: str) -> None:
    """Refuse a second certificate before the run is verified, which takes seconds."""
    with storage_errors(run):
        if not (run / MANIFEST).is_file():
            return
        seal = sha256_of(run / MANIFEST)
    known = numbers(ledger.entries())
    if not open_numbers(known):  # an open number may be that of the first certificate
        refuse_second(known, seal, also)


def complete_open(ledger: Ledger) -> list[str]:
    """Settle open numbers: enter those whose folder is complete, and remove the half made folders of the others."""
    done = []
    for open_number in open_numbers(numbers(ledger.entries())):
        certificate = finished_certificate(open_number)
        if open_number.folder:
            discard_unfinished(Path(open_number.folder))
        if certificate is not None:
            with storage_errors(Path(open_number.folder)):
                seal = sha256_of(Path(open_number.folder) / MANIFEST)
            _enter(ledger, certificate, seal)
            done.append(open_number.number)
    return done


def finished_before(folder: Path, ledger: Ledger) -> Issued | None:
    """Return the certificate that the same command completed before its line of the ledger could be written.

    A certificate that is in the ledger too is refused as one that needs nothing: only the sync of its line had failed.
    """
    if not is_sealed(folder):
        return None
    place = folder.absolute()
    with one_at_a_time(ledger.home):
        for number in complete_open(ledger):
            entered = numbers(ledger.entries())[number]
            certificate = finished_certificate(entered) if Path(entered.folder) == place else None
            if certificate is not None:
                return Issued(certificate, place, entered.seal, (number,))
        for entered in numbers(ledger.entries()).values():
            if (
                entered.how == "issued"
                and Path(entered.folder) == place
                and entered.seal == sha256_of(place / MANIFEST)
            ):
                raise UsageError(
                    f"This folder is the certificate {entered.number}, which is issued and in the ledger.",
                    where=str(folder),
                    remedy="Nothing is missing, even if the command before ended with an error. For another"
                    " certificate, choose another --output.",
                )
    return None


def finished_certificate(entered: Numbered) -> Certificate | None:
    """Return the certificate that lies in the folder of a number, sealed; None if it has another number."""
    folder = Path(entered.folder)
    if not entered.folder or not is_sealed(folder) or not (folder / CERTIFICATE).is_file():
        return None
    data = read_bounded(folder / CERTIFICATE)
    certificate = Certificate.from_json(data, str(folder / CERTIFICATE))
    return certificate if certificate.number == entered.number else None


def _wanted(source: Source, lab: LabConfig, folder: Path, amends: str, further: str) -> Wanted:
    return Wanted(
        number_format=lab.numbers.format,
        simulated=bool(source.results["run"]["simulated"]),
        run_seal=source.run.seal_sha256,
        run_id=source.run.id,
        folder=str(folder),
        amends=amends,
        also=further,
        ended_utc=facts_of_run.utc_seconds(source.results["run"]["finished_utc"]),
    )


def _enter(ledger: Ledger, certificate: Certificate, seal: str) -> None:
    serial, customer = certificate.item.camera.serial, certificate.customer.name
    enter_issued(ledger, certificate.number, seal=seal, serial=serial, customer=customer)
