"""Issue a certificate: verify the run, take a number, render, seal, and enter it in the ledger; or amend one.

A person authorises it later. All refusals come before a number is taken. An amendment has a new number and the results
of the old certificate, which it names by hash; the old one stays as it is.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from datetime import datetime
from functools import partial
from pathlib import Path

from bench.base.bounded_json import leaves, parse_json
from bench.base.errors import EvidenceError, UsageError
from bench.evidence.findings import Verification
from bench.evidence.keys import BenchKey
from bench.evidence.ledger_check import own_public_keys
from bench.evidence.seal import remove_unnamed, seal_folder
from bench.extras.certificate import run_facts
from bench.extras.certificate.beside import count_beside
from bench.extras.certificate.certificate_data import CERTIFICATE, Amends, Certificate, Change
from bench.extras.certificate.clauses import faults_of_lab
from bench.extras.certificate.compose import Identity, compose, further_statement
from bench.extras.certificate.dcc import render_dcc
from bench.extras.certificate.dcc_xml import library
from bench.extras.certificate.lab_config import LabConfig, read_lab
from bench.extras.certificate.limits import needed_reason
from bench.extras.certificate.sealed_run import Source, Verify, read_sealed_run, written_with
from bench.extras.certificate.series import (
    Numbered,
    Wanted,
    enter_issued,
    numbers,
    one_at_a_time,
    open_numbers,
    refuse_old,
    refuse_second,
    reserve,
)
from bench.record.ledger import Ledger
from bench.record.results import Results
from bench.record.run_folder import MANIFEST, RESULTS, is_sealed
from bench.record.storage import (
    make_folder,
    read_bounded,
    sha256_of,
    storage_errors,
    sync_folder,
    write_atomic,
)
from sequences.errors import DocumentFaults
from sequences.reader import Located
from sequences.tree import path_text

# The folder of a certificate: its files from the data, written as a whole and sealed under its final name.
#
# The folder is made under a hidden name beside its final one, sealed there, and renamed last. So a process
# that is killed leaves no half certificate.

PDF = "certificate.pdf"
DCC = "dcc.xml"
LAB = "lab.yaml"
PLOTS = "plots"
_UNFINISHED = ".tmp"


def require_libraries() -> None:
    """Refuse to begin without the libraries of PDF and DCC."""
    for name in ("lxml.etree", "typst"):
        library(name)


def certificate_files(
    certificate: Certificate,
    found: Results,
    results: bytes,
    lab: bytes,
    plots: Mapping[str, str],
    sign: Callable[[bytes], bytes] | None = None,
) -> dict[str, bytes]:
    """Return the files of a certificate's folder but its seal's; ``sign`` signs the DCC, None leaves it unsigned."""
    from bench.extras.certificate.pdf import render_pdf

    dcc = render_dcc(certificate)
    dcc = dcc if sign is None else sign(dcc)
    attachments = {DCC: dcc, RESULTS: results}
    return {
        CERTIFICATE: certificate.to_json(),
        RESULTS: results,
        LAB: lab,
        DCC: dcc,
        PDF: render_pdf(certificate, found, attachments, plots),
        **{f"{PLOTS}/{name}.svg": svg.encode() for name, svg in sorted(plots.items())},
    }


def refuse_occupied(folder: Path) -> None:
    """Refuse a name that is taken, or that lies in a sealed folder, before any number is taken."""
    sealed = next((parent for parent in folder.absolute().parents if is_sealed(parent)), None)
    if sealed is not None:
        raise UsageError(
            f"{sealed} is sealed; a file in it would break its seal.",
            where=str(folder),
            remedy="Choose an --output outside of it.",
        )
    if os.path.lexists(folder):
        raise UsageError(
            "A file or folder with this name already exists.",
            where=str(folder),
            remedy="Choose another --output. A certificate is never overwritten.",
        )


def write_sealed(folder: Path, files: Mapping[str, bytes], key: BenchKey) -> str:
    """Write and seal a folder, named only when it is complete; returns the SHA-256 of its SHA256SUMS."""
    part = unfinished(folder)
    make_folder(folder.parent)
    remove_unnamed(part)  # of a process that was killed while it made this folder
    refuse_occupied(folder)
    make_folder(part)
    for name, data in files.items():
        make_folder((part / name).parent)
        write_atomic(part / name, data)
    seal_folder(part, key)
    with storage_errors(folder):
        seal = sha256_of(part / MANIFEST)
        part.rename(folder)
        sync_folder(folder.parent)
    return seal


def unfinished(folder: Path) -> Path:
    """Return the name of a folder while it is being made."""
    return folder.with_name(f".{folder.name}{_UNFINISHED}")


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
    despite: str = "",
    accept_not_compared: bool = False,
) -> Issued:
    """Issue the certificate of a sealed run; raises `DocumentFaults` with all faults of lab.yaml.

    Without ``also``, the reason, a second one is refused; without ``despite``, one whose own limits pass over a FAIL of
    the run. ``accept_not_compared`` allows parts that could not be made again.
    """
    require_libraries()
    refuse_occupied(folder)
    lab = read_lab(lab_file)
    _refuse_second_early(run, laboratory.ledger, also)
    source = read_sealed_run(run, laboratory.verify, accept_not_compared=accept_not_compared)
    return make_certificate(
        source,
        lab,
        folder,
        laboratory,
        further=further_statement(also),
        despite=despite,
    )


def make_certificate(
    source: Source,
    lab: Located[LabConfig],
    folder: Path,
    laboratory: Laboratory,
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
    try:
        if faults := faults_of_lab(lab, source.found, source.run.sequence_sha256):
            raise DocumentFaults(faults, lab.tree)
        trial_identity = Identity(
            "0", "1970-01-01T00:00:00Z", source.run, None, further, despite, source.verified
        )
        trial = compose(source.found, lab.value, trial_identity)
        reason = needed_reason(source.found, lab.value, trial.conformity, despite)
        if reason != despite:  # an amended one may not need it any more
            trial_identity = replace(trial_identity, despite=reason)
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
        wanted = replace(
            _wanted(source, lab.value, folder, amends, further),
            count_beside=partial(count_beside, folder.parent, own_public_keys(laboratory.ledger.home)),
        )
        number = reserve(laboratory.ledger, wanted, now)
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
        refuse_second(found, seal, also)


def complete_open(ledger: Ledger) -> list[str]:
    """Settle open numbers: enter those whose folder is complete, and remove the half made folders of the others."""
    done = []
    for one in open_numbers(numbers(ledger.entries())):
        certificate = finished_certificate(one)
        if certificate is not None:
            with storage_errors(Path(one.folder)):
                seal = sha256_of(Path(one.folder) / MANIFEST)
            _enter(ledger, certificate, seal)
            done.append(one.number)
        elif one.folder:
            remove_unnamed(unfinished(Path(one.folder)))
    return done


def finished_certificate(one: Numbered) -> Certificate | None:
    """Return the certificate that lies in the folder of a number, sealed; None if it has another number."""
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


def _wanted(source: Source, lab: LabConfig, folder: Path, amends: str, further: str) -> Wanted:
    return Wanted(
        number_format=lab.numbers.format,
        simulated=bool(source.found["run"]["simulated"]),
        run_seal=source.run.seal_sha256,
        run_id=source.run.id,
        folder=str(folder),
        amends=amends,
        also=further,
        ended_utc=run_facts.utc_seconds(source.found["run"]["finished_utc"]),
    )


def _enter(ledger: Ledger, certificate: Certificate, seal: str) -> None:
    serial, customer = certificate.item.camera.serial, certificate.customer.name
    enter_issued(ledger, certificate.number, seal=seal, serial=serial, customer=customer)


ABSENT = "absent"
_OWN = frozenset({"number", "issued_utc", "amends"})
"""Fields that differ in every amendment."""
_PROGRAM = "run.software["
"""Programs and their versions; a new version alone is no change of the certificate."""
_MOST_CHARACTERS = 300


def amend(
    old: Path, lab_file: Path, folder: Path, laboratory: Laboratory, *, reason: str, despite: str = ""
) -> Issued:
    """Issue a certificate that replaces another one: it verifies, is the newest one, and something changes.

    ``despite`` is as for `issue`; without it, the reason of the old one remains.
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
    old, new = (_texts_by_path(one) for one in (before, after))
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
    found = {name: value for name, value in json.loads(certificate.to_json()).items() if name not in _OWN}
    texts = {
        path_text(place): value if isinstance(value, str) else json.dumps(value)
        for place, value in leaves(found)
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
            remedy="Check it with `starbench verify`. Amend the copy that the laboratory keeps.",
        )
    with storage_errors(folder):
        certificate = Certificate.from_json(read_bounded(folder / CERTIFICATE), str(folder / CERTIFICATE))
        results = read_bounded(folder / RESULTS)
        plots = plots_in(folder)
    found = parse_json(results)
    of_the_run = certificate.run.software[: len(found["run"]["software"])]
    run = replace(certificate.run, software=(*of_the_run, *written_with()))
    return certificate, Source(found, results, run, plots, certificate.statement("verification"))
