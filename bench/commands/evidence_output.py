"""Print the result of a verification and the keys of this bench; ask for a passphrase."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from bench.base.errors import EvidenceError, UsageError
from bench.commands.output import print_json

if TYPE_CHECKING:
    from bench.evidence.findings import Verification


NOT_COMPARED = 4
"""Exit status of `verify`: no fault was found, but parts of the folder could not be derived again and compared."""


def show_verification(verification: Verification, *, as_json: bool) -> int:
    """Print what the verification of a sealed folder found.

    Parameters
    ----------
    verification
        Result of the verification.
    as_json
        Whether to print JSON.

    Returns
    -------
    int
        Exit status: 0 no fault, and everything was compared; 1 a fault; 4 no fault, but not everything was compared.
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
        click.echo(f"Run {found.run_id}, camera {camera}.{simulated}")
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

    Parameters
    ----------
    key
        File of the key; shown in the question.

    Returns
    -------
    bytes
        The passphrase, UTF-8.

    Raises
    ------
    EvidenceError
        If there is no terminal.
    """
    if not sys.stdin.isatty():
        raise EvidenceError(
            "The signing key has a passphrase, and there is no terminal to ask for it.",
            where=str(key),
            remedy="Run at a terminal, or use a key without a passphrase for unattended runs.",
        )
    answer: str = click.prompt(f"Passphrase of {key}", hide_input=True, err=True)
    return answer.encode()


def show_keys() -> int:
    """Print this bench's key and the keys that it trusts.

    Returns
    -------
    int
        Exit status, 0.
    """
    from bench.base.home import home_folder
    from bench.evidence.keys import KEY_FILE, SIGNERS_FILE, load_key, read_signers
    from bench.evidence.sshsig import fingerprint

    home = home_folder()
    if not (home / KEY_FILE).exists():
        click.echo(
            "This bench has no key yet; the first run creates one, and so does `starbench keys create`."
        )
    else:
        key = load_key(home, ask_passphrase=ask_passphrase)
        click.echo(
            f"Key:         {home / KEY_FILE}\nFingerprint: {key.fingerprint}\n"
            "Line for the allowed_signers file of those who verify:"
        )
        click.echo(f"  {key.signers_line}")
    if (home / SIGNERS_FILE).exists():
        click.echo(f"Trusted here ({home / SIGNERS_FILE}):")
        for signer in read_signers(home / SIGNERS_FILE):
            click.echo(f"  {signer.principal}  {fingerprint(signer.public_key)}")
    return 0


def make_key(principal: str | None, *, protect: bool) -> int:
    """Create this bench's signing key.

    Parameters
    ----------
    principal
        Name of the signer, as name@place; bench@ and the host name where None.
    protect
        Whether to ask for a passphrase that protects the key.

    Returns
    -------
    int
        Exit status, 0.
    """
    from bench.base.home import home_folder
    from bench.evidence.keys import create_key
    from bench.records.storage import make_folder

    passphrase: str | None = None
    if protect:
        passphrase = click.prompt("Passphrase", hide_input=True, confirmation_prompt=True, err=True)
    make_folder(home_folder())
    key = create_key(
        home_folder(), principal=principal, passphrase=passphrase.encode() if passphrase else None
    )
    click.echo(f"Created {key.fingerprint}. Line for the allowed_signers file of those who verify:")
    click.echo(f"  {key.signers_line}")
    return 0


def trust_key(line: str) -> int:
    """Trust the key of another bench.

    Parameters
    ----------
    line
        Line that `starbench keys show` prints on the other bench.

    Returns
    -------
    int
        Exit status, 0.

    Raises
    ------
    UsageError
        If the line is not a key.
    """
    from bench.base.home import home_folder
    from bench.evidence.keys import trust
    from bench.evidence.sshsig import fingerprint
    from bench.records.storage import make_folder

    make_folder(home_folder())
    try:
        signer = trust(home_folder(), line)
    except EvidenceError as error:
        raise UsageError(error.what, where=error.where, remedy=error.remedy) from error
    click.echo(f"Trusted: {signer.principal}  {fingerprint(signer.public_key)}")
    return 0
