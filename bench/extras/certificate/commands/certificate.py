"""The group `certificate`: new, issue (also to amend), show, void; `certificate_authorise` has the others."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bench.base.bounded_json import parse_json
from bench.base.errors import EvidenceError, UsageError
from bench.base.home import home_folder
from bench.base.pasteable import pasteable
from bench.commands.options import (
    OPERATOR,
    ExistingFile,
    ExistingFolder,
    Family,
    NewFile,
    OutputFolder,
    epilog,
)
from bench.commands.output import JSON, ask_passphrase, print_findings, print_line, show
from bench.evidence.findings import Verification
from bench.evidence.key_trust import Trust, read_trust
from bench.evidence.keys import BenchKey, usable_key
from bench.evidence.ledger_check import is_sealed_by, own_public_keys
from bench.evidence.states import standing_of
from bench.extras.certificate.certificate_data import Certificate
from bench.extras.certificate.commands.authorise import authorise, timestamp
from bench.extras.certificate.series import Numbered, amending, declare_void, numbers, one_at_a_time
from bench.record.ledger import Ledger, bench_ledger
from bench.record.run_folder import CERTIFICATE, MANIFEST
from bench.record.storage import read_bounded, sha256_of, write_new

if TYPE_CHECKING:
    from bench.extras.certificate.issue import Issued, Issuer


_UNKNOWN = "UNKNOWN"
"""State of a certificate while lines of the ledger are missing."""
_NOT_FOUND = "NOT FOUND"
"""State of a certificate that was issued, and that is not in its folder."""


@click.group(
    cls=Family,
    epilog=epilog(
        "starbench certificate new lab.yaml",
        "starbench certificate issue runs/cam7 --config lab.yaml -o certificates/2026-0042",
        "starbench certificate authorise certificates/2026-0042 --key ~/.ssh/id_ed25519",
    ),
)
def certificate() -> None:
    """Issue, amend, list, authorise and time-stamp calibration certificates."""


@certificate.command("new", epilog=epilog("starbench certificate new lab.yaml"))
@click.argument("path", type=NewFile())
def new(path: Path) -> int:
    """Create an example of lab.yaml at PATH, with comments. Replace every REPLACE in it."""
    from bench.extras.certificate.lab_config import EXAMPLE

    write_new(path, EXAMPLE.read_bytes())
    print_line(
        f"Written: {path}. Replace every REPLACE in it;"
        f" then: {pasteable('certificate', 'issue', 'RUN', '-c', path, '-o', 'FOLDER')}"
    )
    return 0


@certificate.command(
    "issue",
    epilog=epilog(
        "starbench certificate issue runs/cam7 --config lab.yaml -o certificates/2026-0042",
        "starbench certificate issue certificates/2026-0042 -c lab.yaml -o new --reason 'wrong address'",
    ),
)
@click.argument("folder", metavar="RUN|CERTIFICATE", type=ExistingFolder())
@click.option(
    "--config",
    "-c",
    "lab_file",
    required=True,
    type=ExistingFile(),
    metavar="LAB.YAML",
    help="What the run cannot know: laboratory, customer, item and more. `starbench certificate new` writes an"
    " example.",
)
@click.option("--output", "-o", required=True, type=OutputFolder(), help="New folder for the certificate.")
@click.option(
    "--reason",
    metavar="TEXT",
    help="Why the certificate is amended (it is printed), or why a run gets a further certificate.",
)
@click.option(
    "--despite-fail",
    "despite",
    metavar="TEXT",
    help="Why limits of LAB.YAML are certified as kept though the run says FAIL by its own; it is printed.",
)
@click.option(
    "--no-again",
    is_flag=True,
    help="Do not make the results again from the recordings. The certificate states it.",
)
@JSON
def issue(
    folder: Path,
    lab_file: Path,
    output: Path,
    reason: str | None,
    despite: str | None,
    no_again: bool,
) -> int:
    """Issue the calibration certificate of a sealed RUN, by ISO/IEC 17025, or amend the one in the folder CERTIFICATE.

    The run is verified first, and its results are made again from the recordings. If neither the run nor LAB.YAML
    answers a clause of the standard, no certificate is issued; the command names the clause and the missing key of
    LAB.YAML. A new certificate is SEALED. A person then authorises it with `starbench certificate authorise`.

    An amended certificate has a new number. It names the old one by number and hash, and lists every field that
    changed. The old one stays as it is; `starbench verify` says that it is superseded.
    """
    from bench.extras.certificate.amend import amend
    from bench.extras.certificate.issue import issue as issue_first

    is_amended = (folder / CERTIFICATE).is_file()
    why = "" if despite is None else _stated(despite, "--despite-fail")
    laboratory = _laboratory(again=not no_again and not is_amended)
    if is_amended:
        if reason is None:
            raise click.UsageError("Missing option '--reason': why the certificate is amended.")
        issued = amend(folder, lab_file, output, laboratory, reason=_stated(reason), despite=why)
    else:
        also = "" if reason is None else _stated(reason)
        issued = issue_first(
            folder,
            lab_file,
            output,
            laboratory,
            also=also,
            despite=why,
        )
    made = issued.certificate
    show(
        lambda: {
            "schema": "starbench/issued/1",
            "number": made.number,
            "state": "SEALED",
            "folder": str(issued.folder),
            "seal": issued.seal,
            "completed": list(issued.completed),
            "certificate": json.loads(made.to_json()),
        },
        _issued_lines(issued),
    )
    return 0


def _issued_lines(issued: Issued) -> Iterator[str]:
    for number in issued.completed:
        yield f"{number} was complete, but not in the ledger; entered now."
    yield from _summary(issued.certificate, "SEALED")
    yield from ("", f"Folder: {issued.folder}")
    yield (
        f"SEALED, not authorised. {issued.certificate.authorised_by.name} authorises it:"
        f" {pasteable('certificate', 'authorise', issued.folder)}"
    )


@certificate.command(
    "void", epilog=epilog("starbench certificate void SB-2026-00042 --reason 'the disk broke'")
)
@click.argument("number")
@click.option("--reason", required=True, help="Why the number is not used; it is kept in the ledger.")
@OPERATOR
@JSON
def void(number: str, reason: str, by: str | None) -> int:
    """Declare the NUMBER of a certificate void.

    The number was reserved by a command that was stopped or failed, so no certificate has it.
    """
    from bench.extras.certificate.issue import complete_open
    from bench.run.control import operator_at_terminal

    text = _stated(reason)
    ledger = bench_ledger()
    with one_at_a_time(ledger.home):
        done = complete_open(ledger)  # the certificate of this number may lie sealed in its folder
        if number in done:
            folder = numbers(ledger.entries())[number].folder
            raise EvidenceError(
                f"{number} is issued: its certificate was complete, and only its line in the ledger was missing."
                " The line is entered now.",
                where=str(ledger.path),
                remedy=f"To replace it: {amending(folder)}.",
            )
        entered = declare_void(ledger, number, reason=text, by=by or operator_at_terminal())
    show(
        {"number": entered.number, "state": "VOID", "reason": entered.reason},
        f"{entered.number} is void: {entered.reason}",
    )
    return 0


@certificate.command(
    "show", epilog=epilog("starbench certificate show", "starbench certificate show certificates/2026-0042")
)
@click.argument("folder", metavar="FOLDER", required=False, type=ExistingFolder())
@JSON
def show_command(folder: Path | None) -> int:
    """Show the certificate in FOLDER: its state, item, results and conformity; without FOLDER, list all of this bench.

    The list comes from the ledger: the state of each number, the camera, the customer and the date.
    """
    from bench.commands.ledger import ledger_findings

    ledger = bench_ledger()
    if folder is None:
        faults, notes = ledger_findings(ledger)
        rows = _rows(ledger, is_known=not faults)
        data = {"schema": "starbench/certificates/1", "certificates": rows, "faults": faults, "notes": notes}
        show(data, [*_list_lines(rows), *(f"Note: {note}" for note in notes)])
        return print_findings(faults)

    path = folder / CERTIFICATE
    if not path.is_file():
        raise UsageError(
            "This folder holds no certificate.",
            where=str(folder),
            remedy=f"Name the folder of a {CERTIFICATE}.",
        )
    content = read_bounded(path)
    certificate = Certificate.from_json(content, str(path))
    state = str(standing_of(folder, read_trust(home_folder()), datetime.now(UTC)).state.value)
    is_own = is_sealed_by(folder, own_public_keys(ledger.home))
    faults, notes = ledger_findings(ledger) if is_own else ([], [])
    known = None if faults else numbers(ledger.entries()).get(certificate.number)
    if faults:
        state = _UNKNOWN
    elif known is not None and known.superseded_by:
        state = f"SUPERSEDED by {known.superseded_by}"
    elif known is not None and known.how == "void":
        state = "VOID"
    show(
        lambda: {"state": state, "certificate": parse_json(content), "faults": faults, "notes": notes},
        [*_summary(certificate, state), *(f"Note: {note}" for note in notes)],
    )
    return print_findings(faults)


def _rows(ledger: Ledger, *, is_known: bool) -> list[dict[str, Any]]:
    """Return the numbers in the ledger; their states are known only if no line of it is missing."""
    trust, now = read_trust(home_folder()), datetime.now(UTC)
    return [
        {
            "number": number.number,
            "state": _listed_state(number, trust, now, is_known=is_known),
            "camera": number.serial,
            "customer": number.customer,
            "issued_utc": number.issued_utc,
            "run": number.run_id,
            "amends": number.amends,
            "superseded_by": number.superseded_by,
            "folder": number.folder,
            "reason": number.reason,
        }
        for number in numbers(ledger.entries()).values()
    ]


def _list_lines(rows: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    if not rows:
        yield "The ledger of this bench has no certificates."
        return
    names = ("number", "state", "camera", "customer")
    widths = [max(len(name), *(len(row[name]) for row in rows)) for name in names]
    yield "  ".join(name.ljust(width) for name, width in zip(names, widths, strict=True)) + "  date"
    for row in rows:
        cells = [row[name].ljust(width) for name, width in zip(names, widths, strict=True)]
        more = f"  replaced by {row['superseded_by']}" if row["superseded_by"] else ""
        more = more or (f"  {row['reason']}" if row["reason"] else "")
        yield "  ".join(cells) + f"  {row['issued_utc'][:10]}{more}"


def _summary(certificate: Certificate, state: str) -> list[str]:
    item, by = certificate.item, certificate.authorised_by
    camera = f"{item.camera.maker} {item.camera.model}, {item.camera.serial}"
    lens = f"{item.lens.maker} {item.lens.model}, {item.lens.serial or 'without number'}"
    lines = [
        f"{certificate.title} {certificate.number}",
        f"State:      {state}",
        f"Laboratory: {certificate.laboratory.name}",
        f"Customer:   {certificate.customer.name}",
        f"Item:       {camera}; lens {lens}",
        f"Calibrated: {certificate.begun_utc[:10]}; issued {certificate.issued_utc[:10]}; run {certificate.run.id}",
        f"To be authorised by {by.name}, {by.role} ({by.key})",
        "",
        *(f"  {result.symbol:<4} {result.text}  (k = {result.k:.2f})" for result in certificate.results),
        *(f"  {further.name}: {further.text}" for further in certificate.further),
    ]
    lines += [
        f"  Conformity of {statement.symbol}, {statement.specification}: {statement.verdict}"
        for statement in certificate.conformity
    ]
    if certificate.amends:
        lines.append(f"Replaces {certificate.amends.number}: {certificate.amends.reason}")
        lines += [
            f"  {change.field}: {change.before!r} -> {change.after!r}"
            for change in certificate.amends.changes
        ]
    return lines


def _listed_state(entered: Numbered, trust: Trust, now: datetime, *, is_known: bool) -> str:
    if entered.how != "issued":
        return {"reserved": "DRAFT", "void": "VOID", "lost": "LOST"}[entered.how]
    if entered.superseded_by:
        return "SUPERSEDED"
    if not is_known:  # a lost line may have replaced it
        return _UNKNOWN
    try:
        if sha256_of(Path(entered.folder) / MANIFEST) != entered.seal:
            return _NOT_FOUND
        return str(standing_of(Path(entered.folder), trust, now).state.value)
    except OSError:
        return _NOT_FOUND


def _laboratory(*, again: bool) -> Issuer:
    from bench.extras.certificate.issue import Issuer

    def key() -> BenchKey:
        return usable_key(home_folder(), datetime.now(UTC), ask_passphrase=ask_passphrase)

    return Issuer(bench_ledger(), key, lambda: datetime.now(UTC), partial(verify_sealed, again=again))


def verify_sealed(folder: Path, *, again: bool) -> Verification:
    """Verify a folder as the command `verify` does."""
    from bench.commands.verify import verify_one

    return verify_one(folder, read_trust(home_folder()), again=again)


def _stated(reason: str, option: str = "--reason") -> str:
    """Return a reason; raise UsageError if it is empty."""
    if not reason.strip():
        raise UsageError("The reason is empty.", remedy=f"Say why, with {option} TEXT.")
    return reason.strip()


for _command in (authorise, timestamp):
    certificate.add_command(_command)
