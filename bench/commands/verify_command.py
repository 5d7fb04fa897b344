"""The command `verify`: arguments, options and exit statuses; joins the verifier with what derives files again."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

import click

from bench.commands.options import JSON, ExistingFile, RunFolder

if TYPE_CHECKING:
    from bench.evidence.findings import Derivation


@click.command()
@click.argument("folder", metavar="FOLDER", type=RunFolder(journal=False))
@click.option(
    "--allowed-signers", type=ExistingFile(), help="File of trusted keys.  [default: this bench's own]"
)
@click.option("--serial", help="Serial number that the calibrated camera must have.")
@click.option(
    "--again",
    is_flag=True,
    help="Also find the stars in the recordings again, calibrate again, and compare every number.",
)
@JSON
def verify(folder: Path, allowed_signers: Path | None, serial: str | None, again: bool, as_json: bool) -> int:
    """Check a sealed FOLDER: a run, a certificate or recalculated results.

    The signature, every file and the journal are checked; results, exports and report are derived again and compared.
    """
    from bench.base.home import home_folder
    from bench.commands.evidence_output import show_verification
    from bench.evidence.keys import SIGNERS_FILE, read_signers
    from bench.evidence.verify import verify_folder

    signers = read_signers(allowed_signers or home_folder() / SIGNERS_FILE)
    when: datetime | None = None
    found = verify_folder(
        folder, signers, when=when, camera_serial=serial, derivations=derivations(again=again)
    )
    return show_verification(found, as_json=as_json)


def derivations(*, again: bool) -> dict[str, list[Derivation]]:
    """Return what derives the files of each kind of sealed folder again.

    Parameters
    ----------
    again
        Whether to calibrate again from the recordings too.

    Returns
    -------
    dict
        Functions by kind of folder, for `bench.evidence.verify.verify_folder`.
    """
    from bench.results.derive_again import check_results_folder, check_run
    from bench.results.reproduce import check_recordings

    return {
        "run": [check_run, *([check_recordings] if again else [])],
        "results": [check_results_folder],
    }
