"""`certificate authorise`: a sealed folder is verified and shown to the person, who confirms and signs it."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bench.base.errors import BenchError, EvidenceError, StorageError, UsageError
from bench.base.home import home_folder
from bench.commands.options import ExistingFile, ExistingFolder, epilog
from bench.commands.output import JSON, STOPPED, ask_passphrase, show, wants_json
from bench.records.reading import read_json
from bench.records.run_folder import MANIFEST, RESULTS, SIGNATURE
from bench.records.storage import storage_errors

if TYPE_CHECKING:
    from bench.evidence.key_trust import Trust

_FROM_ENVIRONMENT = "STARBENCH_PASSPHRASE"
_KINDS = {"certificate": "Certificate", "run": "Run", "results": "Recalculated results", "files": "Files"}


@click.command(
    "authorise",
    epilog=epilog(
        "starbench certificate authorise certificates/2026-0042 --key ~/.ssh/id_ed25519",
        "starbench certificate authorise certificates/2026-0042 --key SHA256:...",
    ),
)
@click.argument("folder", metavar="FOLDER", type=ExistingFolder())
@click.option(
    "--key",
    metavar="FILE|SHA256:...",
    help="Your private key; or, for a key in ssh-agent, its public key or fingerprint.  [default: the key that the"
    " certificate names, else the only one in ssh-agent]",
)
@click.option(
    "--allowed-signers", type=ExistingFile(), help="File of trusted keys.  [default: this bench's own]"
)
@click.option("--yes", is_flag=True, help="Do not ask; for scripts.")
@JSON
def authorise(folder: Path, key: str | None, allowed_signers: Path | None, yes: bool) -> int:
    """Authorise a sealed FOLDER (certificate, run or results) with your own key.

    The folder is verified and shown, and you confirm. Your signature of its seal is added; nothing else changes. A
    passphrase is asked for, or taken from the variable STARBENCH_PASSPHRASE.
    """
    from bench.evidence.authorisation import (
        authorise as sign,
    )
    from bench.evidence.authorisation import (
        named_person,
        require_authorisable,
        require_unauthorised,
    )
    from bench.evidence.key_trust import read_trust
    from bench.evidence.openssh import agent_socket
    from bench.evidence.person_key import find_key
    from bench.evidence.ssh_keys import fingerprint

    if wants_json() and not yes:
        raise UsageError("--json cannot ask for confirmation.", remedy="Add --yes.")
    require_unauthorised(folder)
    with storage_errors(folder):
        seal = (folder / SIGNATURE).read_bytes()
    trust = read_trust(home_folder(), allowed_signers=allowed_signers)
    _refuse_unverified(folder, trust)
    named = named_person(folder)
    own = find_key(key or (named.fingerprint if named else None), agent_socket(), _passphrase)
    now = datetime.now(UTC)
    person = require_authorisable(folder, own.public_key, trust, now)
    facts = facts_of(folder)
    if not wants_json():
        _echo_facts([*facts.items(), ("You are", f"{person} ({fingerprint(own.public_key)})")])
    if not yes and not click.confirm("Do you authorise this?", err=True):
        click.echo("Not authorised.", err=True)
        return STOPPED
    sign(folder, own, trust, now, seal)
    in_ledger = _enter(folder, person, fingerprint(own.public_key))
    fingerprint_text = fingerprint(own.public_key)
    show(
        {
            "schema": "starbench/authorised/1",
            "folder": str(folder),
            "state": "AUTHORISED",
            "person": person,
            "fingerprint": fingerprint_text,
            "facts": facts,
            "in_ledger": in_ledger,
        },
        f"AUTHORISED by {person}. To prove when: starbench certificate timestamp {folder} --tsa URL",
    )
    return 0


def _enter(folder: Path, person: str, fingerprint: str) -> bool:
    """Enter the authorisation in the ledger of this bench; say on standard error if that is not possible."""
    from bench.evidence.ledger_authorisation import enter_authorisation
    from bench.results.previous_calibration import bench_ledger

    try:
        if enter_authorisation(bench_ledger(), folder, person, fingerprint):
            return True
        why = "this computer has no ledger"
    except BenchError as error:
        why = str(error)
    click.echo(f"Not entered in a ledger, so nobody would notice that it was removed: {why}", err=True)
    return False


def facts_of(folder: Path) -> dict[str, str]:
    """Return what a person must see before signing: kind, number, item, run, and the seal's hash.

    Returns: Text by name, in the order in which it is shown.
    """
    from bench.evidence.instructions import kind_of

    kind = kind_of(folder)
    certificate = _read_json(folder / "certificate.json")
    results = _read_json(folder / RESULTS)
    run = _part(certificate, "run") or _part(results, "run")
    camera = _part(_part(certificate, "item"), "camera") or _part(_part(results, "devices"), "camera")
    lens = _part(_part(certificate, "item"), "lens")
    number = f" {certificate['number']}" if certificate.get("number") else ""
    place = run.get("ledger_number", _part(run, "ledger").get("number"))
    simulated = certificate.get("simulated", _part(results, "run").get("simulated"))
    facts = {
        "Kind": f"{_KINDS[kind]}{number}",
        "Customer": str(_part(certificate, "customer").get("name", "")),
        "Camera": _words(camera, ("maker", "model", "serial")),
        "Lens": _words(lens, ("maker", "model", "serial")),
        "Run": " ".join(filter(None, (str(run.get("id", "")), f"(ledger number {place})" if place else ""))),
        "Devices": "SIMULATED" if simulated else "",
        "Folder": str(folder),
        "Seal": f"SHA-256 of {MANIFEST}: {hashlib.sha256((folder / MANIFEST).read_bytes()).hexdigest()}",
    }
    return {name: text for name, text in facts.items() if text}


def _refuse_unverified(folder: Path, trust: Trust) -> None:
    """Refuse a folder in which the verification finds a fault: a person must not sign it."""
    from bench.commands.verify import derivations
    from bench.evidence.verify import verify_folder

    found = verify_folder(folder, trust, derivations=derivations(trust, again=False))
    others = [fault for fault in found.faults if fault.kind != "authorisation"]
    for fault in found.faults:
        if fault not in others:  # there is none yet, so the ledger names one that was removed
            click.echo(f"Note: {fault}.", err=True)
    if others:
        faults = "; ".join(str(fault) for fault in others[:5])
        raise EvidenceError(
            f"This folder is not valid, so it is not authorised: {faults}.",
            where=str(folder),
            remedy="See all faults with `starbench verify`.",
        )
    for what in found.not_compared:
        click.echo(f"Not compared: {what}", err=True)


def _passphrase(key: Path) -> bytes:
    """Return the passphrase from the environment, or ask for it."""
    if (given := os.environ.get(_FROM_ENVIRONMENT)) is not None:
        return given.encode()
    try:
        return ask_passphrase(key)
    except EvidenceError as error:
        raise EvidenceError(
            "The key has a passphrase, and there is no terminal to ask for it.",
            where=str(key),
            remedy=f"Put it into the variable {_FROM_ENVIRONMENT}, or add the key to ssh-agent.",
        ) from error


def _echo_facts(rows: Sequence[tuple[str, str]]) -> None:
    width = max(len(name) for name, _ in rows)
    for name, text in rows:
        click.echo(f"{name:{width}}  {text}", err=True)


def _read_json(path: Path) -> dict[str, Any]:
    """Return a JSON object; empty if there is none. The folder has been verified."""
    try:
        found = read_json(path)
    except (StorageError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}


def _part(values: dict[str, Any], name: str) -> dict[str, Any]:
    found = values.get(name)
    return found if isinstance(found, dict) else {}


def _words(values: dict[str, Any], names: Sequence[str]) -> str:
    words = " ".join(str(values[name]) for name in names if values.get(name))
    return "".join(c if c.isprintable() else "?" for c in words)
