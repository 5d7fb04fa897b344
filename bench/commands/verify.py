"""The command `verify`: joins the verifier with the ledger and with --again, for one sealed folder or for many."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

import click

from bench.base.home import home_folder
from bench.base.pasteable import pasteable
from bench.base.program import forms
from bench.commands.options import (
    ALLOWED_SIGNERS,
    MOMENT,
    MOMENT_FORM,
    TSA_CERTIFICATES,
    OutputFolder,
    RunFolder,
    command,
    status_text,
)
from bench.commands.output import JSON, print_line, show, wants_json
from bench.commands.workers import WORKERS, CountLine, PartsLine, kept_work, open_workers
from bench.evidence.authorisations import compare_authorisation, known_authorisations
from bench.evidence.findings import Derivation, Findings, Verification
from bench.evidence.folder_kinds import folder_kind
from bench.evidence.key_trust import Trust, read_trust
from bench.evidence.ledger_check import ledger_faults_of_run
from bench.evidence.verify import verify_folder
from bench.record.ledger import bench_ledger
from bench.record.run_folder import JOURNAL
from bench.record.stored_run import StoredRun
from bench.work.kept_rows import KeptRows
from bench.work.verifications import DERIVED_KINDS, VERIFIED, Check, Checked, check_one, derivations_of
from bench.work.workers import Finished, Workers, map_work

NOT_COMPARED = 4
"""Exit status of `verify`: no fault was found, but parts were not compared, or this version does not confirm them."""
_COMPARED = "The results were made again from the recordings and compared."
_WORDS = {"ok": "verified", "incomplete": "not confirmed completely", "failed": "NOT VERIFIED"}


@command(
    "starbench verify runs/cam7",
    "starbench verify runs/cam7 --serial 00051234 --allowed-signers lab_signers --again",
    "starbench verify runs/* --again --workers 4 -o checked",
    status=status_text(
        "0 valid, 1 not valid{invalid}, 4 seal valid, but parts were not compared or not confirmed{ctrl_c}"
    ),
)
@click.argument("folders", metavar="FOLDER...", nargs=-1, required=True, type=RunFolder(journal=False))
@ALLOWED_SIGNERS
@TSA_CERTIFICATES
@click.option(
    "--at",
    metavar=MOMENT_FORM,
    type=MOMENT,
    help="The keys must have been valid at this time (UTC): 2026-03-01 or 2026-03-01T12:00:00.  [default: the time of"
    " the seal, by the bench's own clock]",
)
@click.option("--serial", help="Serial number that the calibrated camera must have.")
@click.option(
    "--again",
    is_flag=True,
    help="Also make the results again from the recordings, and compare every number and file. This takes longer.",
)
@WORKERS
@click.option(
    "--output",
    "-o",
    type=OutputFolder(),
    help="With several FOLDERs: folder that keeps what is done. After an interruption, repeat the command: it"
    " continues.",
)
@JSON
def verify(
    folders: tuple[Path, ...],
    allowed_signers: Path | None,
    tsa_certificates: Path | None,
    at: datetime | None,
    serial: str | None,
    again: bool,
    workers: int | str | None,
    output: Path | None,
) -> int:
    """Check sealed FOLDERs: runs, certificates or recalculated results.

    The command checks the signatures, every file, the journal and the ledger. A key in the file revoked_keys beside the
    trusted keys is refused. The command does not compare numbers. With --again it makes the results again from the
    recordings, and compares every number and file: use it if the numbers matter.
    Several folders are checked at the same time, on all processors.
    """
    trust = read_trust(home_folder(), allowed_signers=allowed_signers, tsa_certificates=tsa_certificates)
    moment = at.replace(tzinfo=UTC) if at else None
    if len(folders) > 1 or isinstance(workers, str) or output:
        who = open_workers(workers, most=len(folders))
        check = Check(trust, moment, serial, again, forms()["program"])
        return _verify_many(folders, check, who, output)
    return show_verification(verify_one(folders[0], trust, again=again, at=moment, camera_serial=serial))


def verify_one(
    folder: Path, trust: Trust, *, again: bool, at: datetime | None = None, camera_serial: str | None = None
) -> Verification:
    """Verify a folder with the ledger of this bench, and with ``again`` with its recordings."""
    checks = derivations(folder, trust, again=again)
    return verify_folder(folder, trust, at=at, camera_serial=camera_serial, derivations=checks, again=again)


def show_verification(verification: Verification) -> int:
    """Print what a verification found; exit status 0 without fault, 1 with one, 4 if not everything was compared."""
    lines = _valid_lines(verification) if verification.ok else _fault_lines(verification)
    show(verification.to_dict, lines, err=not verification.ok)
    if not verification.ok:
        return 1
    return 0 if verification.complete else NOT_COMPARED


def _fault_lines(verification: Verification) -> Iterator[str]:
    yield "NOT VERIFIED:"
    for fault in verification.faults:
        yield f"  {fault}"
    yield from verification.statements
    yield f"State by its signatures alone: {verification.state}"


def _valid_lines(verification: Verification) -> Iterator[str]:
    numbers = _COMPARED if verification.complete else ""
    if not verification.again:
        numbers = _not_compared(f"`{pasteable('verify', verification.folder, '--again')}`")
    sealed = f"sealed by {verification.signer} ({verification.fingerprint})"
    signed = f"{verification.state}: {verification.files} files, {sealed}."
    yield f"{signed} {numbers}".rstrip()
    if verification.stated is not None:
        yield f"Sealed {verification.stated:%Y-%m-%d %H:%M:%S} UTC by the bench's own clock."
    yield from verification.statements
    if verification.run_id is not None:
        simulated = " SIMULATED devices." if verification.simulated else ""
        camera = verification.camera_serial or "without number"
        yield f"{folder_kind(Path(verification.folder)).shown} {verification.run_id}, camera {camera}.{simulated}"
    yield from (f"Note: {remark}." for remark in verification.remarks)
    if verification.not_compared:
        yield "NOT COMPARED. Only the seal protects these parts; whoever holds its key could change them:"
        yield from (f"  {what}" for what in verification.not_compared)
    if verification.not_confirmed:
        yield "NOT CONFIRMED by this version, which makes these parts otherwise:"
        yield from (f"  {what}." for what in verification.not_confirmed)


def _not_compared(how: str) -> str:
    return f"The numbers were not compared with the recordings. {how} does that."


def _verify_many(folders: Sequence[Path], check: Check, workers: Workers, output: Path | None) -> int:
    """Check folders by workers, a line each; the exit status is as for one; ``output`` keeps what was made again."""
    chosen = list(dict.fromkeys(folder.absolute() for folder in folders))
    line = CountLine(len(chosen), "folders", quiet=wants_json())
    rows: dict[int, dict[str, Any]] = {}
    states: Counter[str] = Counter()
    with kept_work(workers, output, VERIFIED, line, "checked") as kept:
        work = ((folder, check, kept.get(str(folder)) if kept else None) for folder in chosen)
        for number, end in map_work(check_one, work, workers):
            state, text, rows[number] = _ended(chosen[number], end, kept, check)
            states[state] += 1
            line.clear()
            print_line(text, err=wants_json())
            line.count()
    counted = ", ".join(f"{states[state]} {word}" for state, word in _WORDS.items() if states[state])
    numbers = "" if check.again else f" {_not_compared('--again')}"
    show(
        {"folders": [rows[number] for number in sorted(rows)], **states},
        f"{len(chosen)} folders: {counted}.{numbers}",
    )
    return 1 if states["failed"] else NOT_COMPARED if states["incomplete"] else 0


def _ended(
    folder: Path, end: Finished, kept: KeptRows | None, check: Check
) -> tuple[str, str, dict[str, Any]]:
    """Return state, line and JSON of a folder."""
    if end.failure is not None:
        why = f"{end.failure.message}{end.defect and chr(10) + end.defect}"
        row = {"folder": str(folder), "ok": False, "complete": False, "failure": end.failure.to_dict()}
        return "failed", f"{folder.name}: NOT VERIFIED. {why}", row
    checked: Checked = end.value
    if kept is not None and checked.row is not None and not checked.before:
        kept.add(str(folder), checked.row)
    verification = checked.verification
    if verification.ok:
        findings = Findings()
        findings.derive(folder, _checks_of_this_bench(folder, check.trust, again=check.again))
        findings.add(check_authorisation(folder))
        verification.add(findings)
    if not verification.ok:
        faults = " ".join(f"{fault}." for fault in verification.faults)
        return "failed", f"{folder.name}: NOT VERIFIED. {faults}", verification.to_dict()
    camera = f", camera {verification.camera_serial}" if verification.camera_serial else ""
    simulated = ", SIMULATED devices" if verification.simulated else ""
    text = f"{folder.name}: {verification.state}, {verification.files} files, sealed by {verification.signer}"
    text += f"{camera}{simulated}."
    for words, parts in (("COMPARED", verification.not_compared), ("CONFIRMED", verification.not_confirmed)):
        text += f" NOT {words}: {'; '.join(parts)}." if parts else ""
    return "ok" if verification.complete else "incomplete", text, verification.to_dict()


def again_line(folder: Path) -> PartsLine:
    """Return the line for a folder whose sources are measured again, and which is then calculated again."""
    things = "recordings measured again" if folder_kind(folder).name == "run" else "views found again"
    return PartsLine(things, "the results are calculated again", quiet=wants_json())


def derivations(folder: Path, trust: Trust, *, again: bool) -> list[Derivation]:
    """Return the further checks of a folder for `verify_folder`: ledger, recordings, with ``again`` the numbers."""

    def of_folder(folder: Path) -> Findings:
        findings = Findings()
        with again_line(folder).shown() as reached:
            findings.derive(folder, derivations_of(folder, again=again, progress=reached))
        return findings

    checks = _checks_of_this_bench(folder, trust, again=again)
    if folder_kind(folder).name in DERIVED_KINDS:
        checks.append(of_folder)
    return [*checks, check_authorisation] if checks else []


def _checks_of_this_bench(folder: Path, trust: Trust, *, again: bool) -> list[Derivation]:
    """Return the checks that no worker makes: by the ledger of this bench, or those that the kind of folder brings."""
    kind = folder_kind(folder)
    if kind.name == "run":
        return [_check_ledger]
    return list(kind.checks(partial(verify_one, trust=trust, again=True) if again else None))


def check_authorisation(folder: Path) -> Findings:
    """Compare a folder with the authorisation that the ledger of this bench names. It is the last check of a folder."""
    return compare_authorisation(folder, known_authorisations(home_folder()))


def _check_ledger(folder: Path) -> Findings:
    """Compare the number and the head of a run with the ledger of this bench, if the run is in it."""
    findings, ledger = Findings(), bench_ledger()
    for what in ledger_faults_of_run(folder, ledger):
        findings.fault("ledger", JOURNAL, what.rstrip("."))
    place = StoredRun(folder).history.ledger
    if not findings.faults and not (place and ledger.entered(place)):
        findings.remarks.append(
            "this run is not in the ledger of this bench, so no ledger confirms its number"
        )
    return findings
