"""Print what verification found, and the keys of this bench; ask for a passphrase."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from bench.base.errors import EvidenceError, UsageError
from bench.commands.output import print_json

if TYPE_CHECKING:
    from bench.evidence.verify import Verification


def show_verification(verification: Verification, *, as_json: bool) -> int:
    """Tell whether a run folder is what was sealed; return the exit status."""
    if as_json:
        print_json(verification.to_dict())
    elif verification.ok:
        click.echo(
            f"Verified: {verification.files} files as sealed by {verification.signer} ({verification.fingerprint})."
        )
        if verification.run_id is not None:
            simulated = " SIMULATED devices." if verification.simulated else ""
            camera = verification.camera_serial or "without number"
            click.echo(f"Run {verification.run_id}, camera {camera}.{simulated}")
        for remark in verification.remarks:
            click.echo(f"Not checked: {remark}.")
    else:
        click.echo("NOT VERIFIED:", err=True)
        for fault in verification.faults:
            click.echo(f"  {fault}", err=True)
    return 0 if verification.ok else 1


def ask_passphrase(key: Path) -> bytes:
    """Ask for a key's passphrase at the terminal."""
    if not sys.stdin.isatty():
        raise EvidenceError(
            "The signing key has a passphrase, and there is no terminal to ask for it.",
            where=str(key),
            remedy="Run at a terminal, or use a key without one for unattended runs.",
        )
    answer: str = click.prompt(f"Passphrase of {key}", hide_input=True, err=True)
    return answer.encode()


def show_keys() -> int:
    """Show the bench's key and the keys it trusts."""
    from bench.base.home import home_folder
    from bench.evidence.keys import KEY_FILE, SIGNERS_FILE, load_key, read_signers
    from bench.evidence.sshsig import fingerprint

    home = home_folder()
    if not (home / KEY_FILE).exists():
        click.echo("This bench has no key yet; one is made at the first run, or by `starbench keys create`.")
    else:
        key = load_key(home, ask_passphrase=ask_passphrase)
        click.echo(
            f"Key:         {home / KEY_FILE}\nFingerprint: {key.fingerprint}\nGive to those who verify:"
        )
        click.echo(f"  {key.signers_line}")
    if (home / SIGNERS_FILE).exists():
        click.echo(f"Trusted here ({home / SIGNERS_FILE}):")
        for signer in read_signers(home / SIGNERS_FILE):
            click.echo(f"  {signer.principal}  {fingerprint(signer.public_key)}")
    return 0


def make_key(principal: str | None, *, protect: bool) -> int:
    """Make the bench's key."""
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
    click.echo(f"Made {key.fingerprint}. Give to those who verify:\n  {key.signers_line}")
    return 0


def trust_key(line: str) -> int:
    """Trust another bench's key."""
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
