"""Derive a certificate again from its own folder, and compare it with the laboratory's ledger. Nothing is written."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from operator import attrgetter
from pathlib import Path

from bench.base.errors import BenchError, UsageError
from bench.evidence.findings import UNREADABLE, Findings
from bench.evidence.ledger_check import is_sealed_by, own_public_keys, sealed_strangers
from bench.extras.certificate.amend import changes_of, plots_in
from bench.extras.certificate.certificate_data import DCC, PDF, Certificate, sha256
from bench.extras.certificate.certificate_folder import LAB, PLOTS, certificate_files, require_libraries
from bench.extras.certificate.clauses import faults_of_lab
from bench.extras.certificate.compose import FURTHER, Identity, compose
from bench.extras.certificate.dcc_xml import SIGNATURE
from bench.extras.certificate.lab_config import LabConfig
from bench.extras.certificate.limits import passes_over_fail
from bench.extras.certificate.sealed_run import is_statement, other_writer, stated_run
from bench.extras.certificate.series import SIMULATED, Numbered, is_number_format, number_pattern, numbers
from bench.record.ledger import LEDGER, Ledger
from bench.record.run_folder import CERTIFICATE, MANIFEST, RESULTS, SEQUENCE_COPY, STATION_COPY
from bench.record.storage import read_bounded, sha256_of
from bench.record.stored_run import results_of
from sequences.errors import DocumentFaults
from sequences.reader import Located, check_document

_FILES = frozenset({CERTIFICATE, RESULTS, LAB, DCC, PDF, "VERIFY.txt"})
_KIND = "certificate"
_IN_EVERY_VERSION = (
    "simulated",
    "series",
    "laboratory",
    "customer",
    "item",
    "received",
    "begun_utc",
    "ended_utc",
    "method",
    "traceability",
    "customer_supplied",
    "external",
    "opinions",
    "authorised_by",
)
"""Fields that come from the run and from lab.yaml without words or rounding of the program."""


def check_certificate(folder: Path, ledger: Ledger | None = None) -> Findings:
    """Derive the files again and compare every byte; compare number and run with the ledger, if it has the number."""
    findings = Findings()
    names = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
    for name in sorted(_FILES - names):
        findings.fault("missing", name, "a certificate has this file")
    for name, svg in plots_in(folder).items():
        if not svg.endswith("</svg>"):
            findings.fault(_KIND, f"{PLOTS}/{name}.svg", "something follows the plot")
    if findings.faults:
        return findings
    try:
        certificate = Certificate.from_json(read_bounded(folder / CERTIFICATE))
        _derive(folder, certificate, findings)
    except BenchError as error:
        findings.fault(_KIND, error.where or CERTIFICATE, error.what.rstrip("."))
        return findings
    except UNREADABLE as error:
        findings.fault(_KIND, RESULTS, f"the certificate cannot be derived from it ({error!r})")
        return findings
    if ledger is not None:
        _compare_with_ledger(folder, certificate, ledger, findings)
    return findings


def _derive(folder: Path, certificate: Certificate, findings: Findings) -> None:
    """Compose the certificate again from what it states and from its results, and render PDF and DCC."""
    results = read_bounded(folder / RESULTS)
    if sha256(results) != certificate.run.results_sha256:
        findings.fault(_KIND, RESULTS, "these are not the results that the certificate names")
    content = results_of(results, folder / RESULTS)
    try:
        lab = check_document(read_bounded(folder / LAB), LAB, LabConfig)
    except DocumentFaults as error:
        findings.fault(_KIND, LAB, "; ".join(str(fault) for fault in error.faults[:5]))
        return
    for fault in faults_of_lab(lab, content, certificate.run.sequence_sha256)[:5]:
        findings.fault(_KIND, LAB, str(fault))
    _check_number(certificate, lab.value, findings)
    other = other_writer(certificate.run.software)
    for what in _issue_faults(certificate, other):
        findings.fault(_KIND, CERTIFICATE, what)
    if findings.faults:
        return
    written = certificate.run.software[len(content["run"]["software"]) :]
    run = replace(certificate.run, **stated_run(content, results, written))
    also, despite = certificate.statement("also"), certificate.statement("limits_reason")
    if not other and also and not also.startswith(FURTHER):
        findings.fault(
            _KIND, CERTIFICATE, "it does not state as issuing does why the run has a further certificate"
        )
    stated = certificate.statement("verification")
    verdicts = certificate.statement("verdicts")
    identity = Identity(
        certificate.number, certificate.issued_utc, run, certificate.amends, also, despite, stated, verdicts
    )
    again = compose(content, lab.value, identity)
    if bool(passes_over_fail(content, lab.value, again.conformity)) != bool(despite):
        tell = findings.remarks.append if other else partial(findings.fault, _KIND, CERTIFICATE)
        tell("it does not state as issuing does that limits of the laboratory pass over a FAIL of the run")
    if again.to_json() != (folder / CERTIFICATE).read_bytes():
        where = _first_difference(certificate, again)
        if other and _same_numbers(certificate, again):
            findings.not_compared.append(f"{CERTIFICATE}, {PDF} and {DCC}: they were written with {other}")
        else:
            findings.fault(_KIND, CERTIFICATE, f"it does not follow from {RESULTS} and {LAB}: {where}")
        return
    _compare_documents(folder, again, lab, results, other, findings)


def _issue_faults(certificate: Certificate, other: str) -> Iterator[str]:
    """Yield what contradicts its issue; ``other`` tells how the program differs that issued it, or is empty."""
    if certificate.issued_utc < certificate.ended_utc:
        yield f"it was issued on {certificate.issued_utc}, before its calibration ended on {certificate.ended_utc}"
    if not other and not is_statement(certificate.statement("verification")):
        yield "it does not state what was verified before the issue as issuing does"


def _same_numbers(stated: Certificate, derived: Certificate) -> bool:
    """Return whether two certificates state the same results of the same item: every version must agree on them.

    An earlier version divided U of a result without a posterior into another u and k.
    """
    of_posterior = all(result.nu_eff is None for result in derived.results)
    fields = attrgetter(*_IN_EVERY_VERSION, *(["covariance"] if of_posterior else []))
    numbers_of = attrgetter("symbol", "unit", "value", "U", *(["u", "k"] if of_posterior else []))
    verdict_of = attrgetter("symbol", "lower", "upper", "guard_band", "verdict")
    verdicts = [verdict_of(statement) for statement in derived.conformity]
    return (
        fields(stated) == fields(derived)
        and [*map(numbers_of, stated.results)] == [*map(numbers_of, derived.results)]
        # An earlier version left the limits of the run out if the laboratory stated some.
        and all(verdict_of(statement) in verdicts for statement in stated.conformity)
    )


def _compare_documents(
    folder: Path,
    certificate: Certificate,
    lab: Located[LabConfig],
    results: bytes,
    other: str,
    findings: Findings,
) -> None:
    """Render PDF and DCC again. Another program may give other bytes; it is then named."""
    try:
        require_libraries()
    except UsageError as error:
        findings.not_compared.append(f"{PDF} and {DCC}: {error.what} {error.remedy}".rstrip("."))
        return
    stored = (folder / DCC).read_bytes()
    content = results_of(results, folder / RESULTS)
    files = certificate_files(certificate, content, results, lab.text, plots_in(folder), stored_dcc=stored)
    if SIGNATURE.search(stored):
        findings.remarks.append(
            f"the XML signature inside {DCC} is not checked here, but the seal covers it. To check it:"
            f" xmlsec1 --verify --trusted-pem AUTHORITY.pem {DCC}"
        )
    for name in (DCC, PDF):
        if files[name] == (folder / name).read_bytes():
            continue
        if other:
            findings.not_compared.append(f"{name}: it was written with {other}")
        else:
            findings.fault(_KIND, name, f"it is not what follows from {CERTIFICATE}")


def _check_number(certificate: Certificate, lab: LabConfig, findings: Findings) -> None:
    wanted = (SIMULATED if certificate.simulated else "") + lab.numbers.format
    if certificate.series != wanted or not is_number_format(wanted):
        findings.fault(_KIND, CERTIFICATE, f"its series is {certificate.series!r}, not that of {LAB}")
    elif not number_pattern(wanted).fullmatch(certificate.number):
        findings.fault(_KIND, CERTIFICATE, f"{certificate.number} is not a number of its series {wanted}")


def _first_difference(stated: Certificate, derived: Certificate) -> str:
    """Name the first field that differs."""
    try:
        changes = changes_of(derived, stated)
    except BenchError:
        return "the same values are written in another form"
    first = changes[0]
    more = f" and {len(changes) - 1} more" if len(changes) > 1 else ""
    return f"{first.field} is {first.after!r}, derived {first.before!r}{more}"


def _compare_with_ledger(folder: Path, certificate: Certificate, ledger: Ledger, findings: Findings) -> None:
    try:
        known = numbers(ledger.entries())
        runs = ledger.runs()
    except BenchError as error:
        findings.not_compared.append(f"the ledger of this bench cannot be read: {error.what.rstrip('.')}")
        return
    is_own = is_sealed_by(folder, own_public_keys(ledger.home))
    if is_own:
        _compare_with_breaks(ledger, findings)
    _compare_with_number(folder, certificate, known.get(certificate.number), findings, is_own=is_own)
    old = known.get(certificate.amends.number) if certificate.amends else None
    if old is not None and certificate.amends is not None:
        says = (old.seal, old.superseded_by)
        if says != (certificate.amends.sha256, certificate.number):
            findings.fault(
                _KIND, CERTIFICATE, f"the ledger does not say that it replaces {old.number} with this seal"
            )
    for run in runs:
        if run.seal == certificate.run.seal_sha256:
            _compare_with_run(folder, Path(run.folder), certificate, findings)


def _compare_with_number(
    folder: Path, certificate: Certificate, entered: Numbered | None, findings: Findings, *, is_own: bool
) -> None:
    """Compare with what the ledger says of the number: whether it is issued, with this seal, and not replaced."""
    if entered is None and is_own:
        what = f"this bench has sealed {certificate.number}, but its ledger does not contain it; lines were removed"
        findings.fault("ledger", LEDGER, f"{what}, so nothing tells whether it was replaced or declared void")
    elif entered is None:
        findings.remarks.append(
            f"{certificate.number} is not in the ledger of this bench, so nothing here tells whether it was replaced"
        )
    elif entered.how == "void":
        findings.fault(_KIND, CERTIFICATE, f"{entered.number} was declared void: {entered.reason}")
    elif entered.how == "issued" and entered.seal != sha256_of(folder / MANIFEST):
        findings.fault(_KIND, MANIFEST, f"the ledger has another seal for {entered.number}")
    elif entered.superseded_by:
        findings.remarks.append(f"SUPERSEDED: {entered.superseded_by} replaces this certificate")
    elif entered.how != "issued":
        findings.remarks.append(f"{entered.number} is {entered.how} in the ledger of this bench, not issued")


def _compare_with_breaks(ledger: Ledger, findings: Findings) -> None:
    """Tell what is missing in the ledger: a lost line may have replaced the certificate, or declared it void."""
    faults, explained = ledger.breaks(sealed_strangers(ledger.home))
    for what in faults:
        findings.fault(
            "ledger",
            LEDGER,
            f"{what.rstrip('.')}; a lost line may have replaced this certificate or made it void",
        )
    findings.not_compared += [
        f"whether it was replaced or declared void: {str(gap).rstrip('.')}" for gap in explained
    ]


def _compare_with_run(folder: Path, run: Path, certificate: Certificate, findings: Findings) -> None:
    """Compare with the sealed run, if it still lies where the ledger says."""
    if not (run / MANIFEST).is_file() or sha256_of(run / MANIFEST) != certificate.run.seal_sha256:
        findings.remarks.append(
            f"the run {certificate.run.id} is not in {run}, so its plots were not compared"
        )
        return
    results = read_bounded(folder / RESULTS)
    if read_bounded(run / RESULTS) != results:
        findings.fault(_KIND, RESULTS, f"the results are not those of the run {run}")
        return
    hashes = {
        SEQUENCE_COPY: certificate.run.sequence_sha256,
        STATION_COPY: certificate.run.station_sha256,
    }
    for name, stated in hashes.items():
        if stated and sha256_of(run / name) != stated:
            findings.fault(_KIND, CERTIFICATE, f"it names another {name} than that of the run {run}")
    from bench.extras.certificate.pdf import plots_of_run

    if plots_of_run(run, results_of(results, run / RESULTS)) != plots_in(folder):
        findings.not_compared.append(
            "the plots are not drawn alike from the run here: another version of Starbench, or changed plots"
        )
