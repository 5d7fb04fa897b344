"""The command `verify`: arguments, options and exit statuses; joins the verifier with what derives files again."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import click

from bench.commands.options import JSON, ExistingFile, OutputFolder, RunFolder
from bench.commands.worker_options import open_workers, worker_options

if TYPE_CHECKING:
    from bench.evidence.findings import Derivation, Findings


@click.command()
@click.argument("folders", metavar="FOLDER...", nargs=-1, required=True, type=RunFolder(journal=False))
@click.option(
    "--allowed-signers", type=ExistingFile(), help="File of trusted keys.  [default: this bench's own]"
)
@click.option(
    "--revoked-keys",
    type=ExistingFile(),
    help="File of revoked keys.  [default: the one beside the trusted keys]",
)
@click.option(
    "--tsa-certificates",
    type=ExistingFile(),
    help="Root certificates of trusted time stamping authorities, PEM.  [default: this bench's own]",
)
@click.option(
    "--at",
    metavar="DATE",
    type=click.DateTime(["%Y-%m-%d", "%Y-%m-%dT%H:%M:%S", "%Y-%m-%d %H:%M"]),
    help="The keys must have been valid at this time (UTC): 2026-03-01 or 2026-03-01T12:00:00.  [default: the time of"
    " the seal, by the bench's own clock]",
)
@click.option("--serial", help="Serial number that the calibrated camera must have.")
@click.option(
    "--again",
    is_flag=True,
    help="Also find the stars in the recordings again, calibrate again, and compare every number. This takes longer.",
)
@worker_options
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
    revoked_keys: Path | None,
    tsa_certificates: Path | None,
    at: datetime | None,
    serial: str | None,
    again: bool,
    scheduler: str | None,
    workers: int | None,
    memory: int,
    output: Path | None,
    as_json: bool,
) -> int:
    """Check sealed FOLDERs: runs, certificates or recalculated results.

    The command checks the signatures, every file and the journal. It derives results, exports and report again from the
    other files, and compares every byte. With --again it begins with the recordings: use it if the numbers matter.
    Several folders are checked at the same time, on all processors.
    """
    from bench.base.home import home_folder
    from bench.commands.evidence_output import show_verification
    from bench.evidence.key_trust import read_trust
    from bench.evidence.verify import verify_folder

    trust = read_trust(
        home_folder(),
        allowed_signers=allowed_signers,
        revoked_keys=revoked_keys,
        tsa_certificates=tsa_certificates,
    )
    moment = at.replace(tzinfo=UTC) if at else None
    if len(folders) > 1 or scheduler or output:
        from bench.cluster.verifications import Check
        from bench.commands.verify_many import verify_many
        from bench.results.forms import forms

        who = open_workers(scheduler, workers, memory, most=len(folders))
        check = Check(trust, moment, serial, again, forms()["program"])
        return verify_many(folders, check, who, output, _checks_of_this_bench, as_json=as_json)
    found = verify_folder(
        folders[0],
        trust,
        at=moment,
        camera_serial=serial,
        derivations=derivations(again=again),
    )
    return show_verification(found, as_json=as_json)


def derivations(*, again: bool) -> dict[str, list[Derivation]]:
    """Return what derives the files of each kind of sealed folder again.

    again: Whether to calibrate again from the recordings too.
    Returns: Functions by kind of folder, for `bench.evidence.verify.verify_folder`.
    """
    from bench.results.derive_again import check_results_folder, check_run
    from bench.results.reproduce import check_recordings
    from bench.results.reproduce_offline import check_recalculated

    return {
        "run": [_check_ledger, check_run, *([check_recordings] if again else []), _check_authorisation],
        "results": [check_results_folder, *([check_recalculated] if again else []), _check_authorisation],
        "certificate": [_check_certificate, _check_authorisation],
    }


def _checks_of_this_bench(folder: Path, kind: str) -> Findings:
    """Compare a folder with the ledger of this bench, which no worker has."""
    from bench.evidence.findings import Findings

    found = Findings()
    for check in {"certificate": [_check_certificate], "run": [_check_ledger]}.get(kind, []):
        found.add(check(folder))
    found.add(_check_authorisation(folder))
    return found


def _check_authorisation(folder: Path) -> Findings:
    """Compare a folder with the authorisation that the ledger of this bench names. It is the last check of a folder."""
    from bench.base.home import home_folder
    from bench.evidence.findings import Findings
    from bench.evidence.ledger_authorisation import compare_authorisation, known_authorisations
    from bench.evidence.seal import AUTHORISATION

    found = Findings()
    compared = compare_authorisation(folder, known_authorisations(home_folder()))
    if compared.fault:
        found.fault("authorisation", AUTHORISATION, compared.fault)
    if compared.note:
        found.remarks.append(compared.note)
    return found


def _check_certificate(folder: Path) -> Findings:
    """Derive a certificate again, and compare it with the ledger of this bench."""
    from bench.certificate.check import check_certificate
    from bench.results.previous_calibration import bench_ledger

    return check_certificate(folder, bench_ledger())


def _check_ledger(folder: Path) -> Findings:
    """Compare the number and the head of a run with the ledger of this bench, if the run is in it."""
    from bench.evidence.findings import Findings
    from bench.evidence.ledger_check import ledger_faults_of_run
    from bench.records.history import replay
    from bench.records.journal import read_journal
    from bench.records.run_folder import JOURNAL
    from bench.results.previous_calibration import bench_ledger

    found, ledger = Findings(), bench_ledger()
    for what in ledger_faults_of_run(folder, ledger):
        found.fault("ledger", JOURNAL, what.rstrip("."))
    place = replay(read_journal(folder / JOURNAL)[0]).ledger
    if not found.faults and not (place and ledger.contains(place)):
        found.remarks.append("this run is not in the ledger of this bench, so no ledger confirms its number")
    return found
