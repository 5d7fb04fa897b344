"""Print the result of a verification; ask for a passphrase."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from bench.base.errors import EvidenceError
from bench.commands.output import print_json

if TYPE_CHECKING:
    from bench.evidence.findings import Verification


NOT_COMPARED = 4
"""Exit status of `verify`: no fault was found, but parts of the folder could not be derived again and compared."""


def show_verification(verification: Verification, *, as_json: bool) -> int:
    """Print what the verification of a sealed folder found.

    as_json: Whether to print JSON.
    Returns: Exit status: 0 no fault, and everything was compared; 1 a fault; 4 no fault, but not everything
      was compared.
    """
    if as_json:
        print_json(verification.to_dict())
    elif verification.ok:
        _show_valid(verification)
    else:
        click.echo("NOT VERIFIED:", err=True)
        for fault in verification.faults:
            click.echo(f"  {fault}", err=True)
        click.echo(f"State by its signatures alone: {verification.state}", err=True)
    if not verification.ok:
        return 1
    return 0 if verification.complete else NOT_COMPARED


def _show_valid(found: Verification) -> None:
    click.echo(f"{found.state}: {found.files} files, sealed by {found.signer} ({found.fingerprint}).")
    if found.stated is not None:
        click.echo(f"Sealed {found.stated[:19].replace('T', ' ')} UTC by the bench's own clock.")
    for statement in found.statements:
        click.echo(statement)
    if found.run_id is not None:
        simulated = " SIMULATED devices." if found.simulated else ""
        camera = found.camera_serial or "without number"
        what = {"results": "Recalculated results", "certificate": "Certificate of run"}.get(found.kind, "Run")
        click.echo(f"{what} {found.run_id}, camera {camera}.{simulated}")
    for remark in found.remarks:
        click.echo(f"Note: {remark}.")
    if found.not_compared:
        click.echo(
            "NOT COMPARED. Only the seal protects these parts; whoever holds its key could change them:"
        )
        for what in found.not_compared:
            click.echo(f"  {what}")


def ask_passphrase(key: Path) -> bytes:
    """Ask for the passphrase of a key at the terminal.

    Returns: The passphrase, UTF-8.
    Raises EvidenceError: If there is no terminal.
    """
    if not sys.stdin.isatty():
        raise EvidenceError(
            "The signing key has a passphrase, and there is no terminal to ask for it.",
            where=str(key),
            remedy="Run at a terminal, or use a key without a passphrase for unattended runs.",
        )
    answer: str = click.prompt(f"Passphrase of {key}", hide_input=True, err=True)
    return answer.encode()
