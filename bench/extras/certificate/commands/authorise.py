"""`certificate authorise` and `certificate timestamp`: what is added beside the seal of a folder."""

from __future__ import annotations

import hashlib
import os
import shlex
from collections.abc import Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import click

from bench.base.encoding import printable_only
from bench.base.errors import BenchError, EvidenceError, StorageError, UsageError
from bench.base.home import home_folder
from bench.base.pasteable import pasteable
from bench.commands.options import (
    ALLOWED_SIGNERS,
    TSA_CERTIFICATES,
    ExistingFile,
    ExistingFolder,
    NewFile,
    command,
    status_text,
)
from bench.commands.output import JSON, STOPPED, ask_passphrase, confirm, show, wants_json
from bench.evidence.authorisation import authorise as sign
from bench.evidence.authorisation import named_person, require_authorisable, require_unauthorised
from bench.evidence.authorisations import enter_authorisation
from bench.evidence.beside_seal import add_beside
from bench.evidence.folder_kinds import folder_kind
from bench.evidence.key_trust import Trust, read_trust
from bench.evidence.openssh import agent_socket
from bench.evidence.personal_key import find_key
from bench.evidence.seal import AUTHORISATION, AUTHORISATION_TIMESTAMP, TIMESTAMP
from bench.evidence.ssh_keys import fingerprint
from bench.evidence.sshsig import is_valid, read_signature
from bench.evidence.timestamp import (
    LABORATORY_TSA_FILE,
    STAMPED,
    TSA_FILE,
    OtherFileError,
    Stamp,
    TrustedAuthorities,
    UncheckedError,
    as_reply,
    check_reply,
    read_authorities,
)
from bench.evidence.tsa_client import ask_authority, check_url, make_request
from bench.record.ledger import bench_ledger
from bench.record.run_folder import CERTIFICATE, MANIFEST, SIGNATURE
from bench.record.storage import read_json, storage_errors, write_new
from bench.record.stored_run import StoredRun

_NAMES = {"seal": TIMESTAMP, "authorisation": AUTHORISATION_TIMESTAMP}
_FROM_ENVIRONMENT = "STARBENCH_PASSPHRASE"
_KINDS = {"certificate": "Certificate", "run": "Run", "results": "Recalculated results", "files": "Files"}


@command(
    "starbench certificate timestamp certificates/2026-0042 --tsa https://tsa.example/tsr",
    "starbench certificate timestamp certificates/2026-0042 --request request.tsq",
    "starbench certificate timestamp certificates/2026-0042 --token reply.tsr",
    name="timestamp",
)
@click.argument("folder", metavar="FOLDER", type=ExistingFolder())
@click.option("--tsa", metavar="URL", help="Ask this time stamping authority over the network.")
@click.option("--token", type=ExistingFile(), help="Add this reply or token of an authority.")
@click.option("--request", "request_file", type=NewFile(), help="Write a request to this file; add nothing.")
@click.option(
    "--of",
    "what",
    type=click.Choice(["seal", "authorisation"]),
    help="Which signature to stamp.  [default: the authorisation if there is one, else the seal]",
)
@TSA_CERTIFICATES
@JSON
def timestamp(
    folder: Path,
    tsa: str | None,
    token: Path | None,
    request_file: Path | None,
    what: str | None,
    tsa_certificates: Path | None,
) -> int:
    """Add a time stamp (RFC 3161) to a sealed or authorised FOLDER.

    Without a network: write a request with --request, take it to an authority, and add its reply with --token. A time
    stamp of the authorisation proves the time of the seal too.
    """
    if sum(option is not None for option in (tsa, token, request_file)) != 1:
        raise click.UsageError("Give one of --tsa, --token and --request.")
    if request_file is not None:
        return _write_request(folder, what, request_file)
    return _stamp_folder(folder, what, tsa, token, tsa_certificates)


def _write_request(folder: Path, what: str | None, path: Path) -> int:
    """Write a request for a time stamp; ``what`` is None for the authorisation if there is one, else the seal."""
    name = _free_names(folder, what)[0]
    write_new(path, make_request(_signed(folder, name), nonce=False).data)
    show(
        {"schema": "starbench/request/1", "request": str(path), "of": STAMPED[name]},
        f"Request for a time stamp of {STAMPED[name]}: {path}\nSend it to an authority, for example with:\n"
        f"  curl -H 'Content-Type: application/timestamp-query' --data-binary @{shlex.quote(str(path))}"
        " -o reply.tsr URL\n"
        f"Then: {pasteable('certificate', 'timestamp', folder, '--token', 'reply.tsr')}",
    )
    return 0


def _stamp_folder(
    folder: Path, what: str | None, tsa: str | None, token: Path | None, tsa_certificates: Path | None
) -> int:
    """Add a time stamp beside the seal, after checking it; ``tsa_certificates`` None are this bench's.

    ``what`` is ``seal`` or ``authorisation``; None for the authorisation if there is one, or for what the token is of.
    """
    if tsa is not None:
        check_url(tsa)
    authorities = read_authorities(home_folder(), tsa_certificates)
    names = _free_names(folder, what)
    try:
        if token is not None:
            with storage_errors(token), token.open("rb") as stream:
                reply = as_reply(stream.read(1 << 20))
        else:
            names = names[:1]
            reply = ask_authority(str(tsa), make_request(_signed(folder, names[0]), nonce=True))
        stamp = _check_one(reply, folder, names, authorities)
    except UncheckedError as error:
        raise EvidenceError(
            f"The time stamp cannot be checked, so it is not added: {error.what}.",
            where=str(token or tsa),
            remedy=error.remedy
            or f"Put the authority's root certificate into {home_folder() / TSA_FILE} (or {LABORATORY_TSA_FILE} for the"
            " laboratory's own), or name its file with --tsa-certificates.",
        ) from error
    except EvidenceError as error:
        raise EvidenceError(
            f"This time stamp is not added: {error.what.rstrip('.')}.",
            where=error.where or str(token or tsa),
            remedy=error.remedy or f"It must be a time stamp of {STAMPED[names[0]]} of this folder.",
        ) from error
    add_beside(folder, stamp.file, reply)
    show(
        {
            "schema": "starbench/timestamp/1",
            "file": stamp.file,
            "of": stamp.of,
            "utc": stamp.utc.isoformat(),
            "authority": stamp.authority,
            "laboratory_clock": stamp.is_laboratory,
        },
        f"{stamp.file}: {stamp.of} existed at {stamp.text}.",
    )
    return 0


def _check_one(reply: bytes, folder: Path, names: Sequence[str], authorities: TrustedAuthorities) -> Stamp:
    """Check a reply for the first of these names; for the next one only if it is a time stamp of another file."""
    for name in names[:-1]:
        with suppress(OtherFileError):
            return check_reply(reply, _signed(folder, name), authorities, name)
    return check_reply(reply, _signed(folder, names[-1]), authorities, names[-1])


def _free_names(folder: Path, what: str | None) -> list[str]:
    """Return the files of time stamps that can be made; refuses what is not there to stamp, or is stamped already."""
    if not (folder / MANIFEST).is_file() or not (folder / SIGNATURE).is_file():
        raise EvidenceError(
            "This folder is not sealed, so there is nothing to stamp.",
            where=str(folder),
            remedy="Finish the run, or issue the certificate, which seals it.",
        )
    is_authorised = (folder / AUTHORISATION).is_file()
    if what == "authorisation" and not is_authorised:
        raise EvidenceError(
            "This folder is not authorised.",
            where=str(folder),
            remedy=f"Authorise it: {pasteable('certificate', 'authorise', folder)}",
        )
    names = [_NAMES[what]] if what else [*([AUTHORISATION_TIMESTAMP] if is_authorised else []), TIMESTAMP]
    free = [name for name in names if not (folder / name).exists()]
    if not free:
        raise EvidenceError(
            f"There is a time stamp already ({' and '.join(names)}); it is never replaced.",
            where=str(folder),
            remedy=f"Check it: {pasteable('verify', folder)}",
        )
    return free


def _signed(folder: Path, name: str) -> bytes:
    """Return the signature to stamp; refuses one that does not hold, because its time would be worthless."""
    of = STAMPED[name]
    with storage_errors(folder):
        data = (folder / of).read_bytes()
        signed = (folder / (MANIFEST if of == SIGNATURE else SIGNATURE)).read_bytes()
    if not is_valid(read_signature(data), signed):
        raise EvidenceError(
            f"{of} is not a valid signature, so it is not stamped.",
            where=str(folder),
            remedy=f"See all faults: {pasteable('verify', folder)}",
        )
    return data


@command(
    "starbench certificate authorise certificates/2026-0042 --key ~/.ssh/id_ed25519",
    "starbench certificate authorise certificates/2026-0042 --key SHA256:...",
    status=status_text("0 authorised, 1 failed{invalid}, 3 you did not confirm{ctrl_c}"),
    name="authorise",
)
@click.argument("folder", metavar="FOLDER", type=ExistingFolder())
@click.option(
    "--key",
    metavar="FILE|SHA256:...",
    help="Your private key; or, for a key in ssh-agent, its public key or fingerprint.  [default: the key that the"
    " certificate names, else the only one in ssh-agent]",
)
@ALLOWED_SIGNERS
@click.option("--yes", is_flag=True, help="Do not ask; for scripts.")
@JSON
def authorise(folder: Path, key: str | None, allowed_signers: Path | None, yes: bool) -> int:
    """Authorise a sealed FOLDER (certificate, run or results) with your own key.

    The folder is verified and shown, and you confirm. Your signature of its seal is added; nothing else changes. A
    passphrase is asked for, or taken from the variable STARBENCH_PASSPHRASE.
    """
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
    if not yes and not confirm("Do you authorise this?"):
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
        f"AUTHORISED by {person}. To prove when: {pasteable('certificate', 'timestamp', folder, '--tsa', 'URL')}",
    )
    return 0


def _enter(folder: Path, person: str, fingerprint: str) -> bool:
    """Enter the authorisation in the ledger of this bench; say on standard error if that is not possible."""
    try:
        if enter_authorisation(bench_ledger(), folder, person, fingerprint):
            return True
        why = "this computer has no ledger"
    except BenchError as error:
        why = str(error)
    click.echo(f"Not entered in a ledger, so nobody would notice that it was removed: {why}", err=True)
    return False


def facts_of(folder: Path) -> dict[str, str]:
    """Return what a person must see before signing, in order: kind, number, item, run, and the seal's hash."""
    kind = folder_kind(folder).name
    certificate = _read_json(folder / CERTIFICATE)
    results = _results(folder)
    run = _part(certificate, "run") or _part(results, "run")
    camera = _part(_part(certificate, "item"), "camera") or _part(_part(results, "devices"), "camera")
    lens = _part(_part(certificate, "item"), "lens")
    number = f" {certificate['number']}" if certificate.get("number") else ""
    place = run.get("ledger_number", _part(run, "ledger").get("number"))
    simulated = certificate.get("simulated", _part(results, "run").get("simulated"))
    facts = {
        "Kind": f"{_KINDS.get(kind, kind.capitalize())}{number}",
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
    from bench.commands.verify import verify_one

    verification = verify_one(folder, trust, again=False)
    others = [fault for fault in verification.faults if fault.kind != "authorisation"]
    for fault in verification.faults:
        if fault not in others:  # there is none yet, so the ledger names one that was removed
            click.echo(f"Note: {fault}.", err=True)
    if others:
        faults = "; ".join(str(fault) for fault in others[:5])
        raise EvidenceError(
            f"This folder is not valid, so it is not authorised: {faults}.",
            where=str(folder),
            remedy=f"See all faults: {pasteable('verify', folder)}",
        )
    for what in verification.not_compared:
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
        content = read_json(path)
    except (StorageError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}


def _results(folder: Path) -> Mapping[str, Any]:
    """Return results.json; empty if there is none. The folder has been verified."""
    try:
        return StoredRun(folder).results_as_written
    except BenchError:
        return {}


def _part(values: Mapping[str, Any], name: str) -> dict[str, Any]:
    part = values.get(name)
    return part if isinstance(part, dict) else {}


def _words(values: Mapping[str, Any], names: Sequence[str]) -> str:
    return printable_only(" ".join(str(values[name]) for name in names if values.get(name)))
