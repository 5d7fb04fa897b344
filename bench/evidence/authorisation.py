"""A person's authorisation of a sealed folder: make and check ``SHA256SUMS.authorised.sig``.

It is the person's SSH signature of ``SHA256SUMS.sig``, namespace ``starbench-authorisation@v1``: bound to the seal, and
by it to every file. It is made with the person's own key, which no bench has (ISO/IEC 17025:2017, 7.8.2.1 o).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path

from bench.base.errors import EvidenceError, StorageError
from bench.base.pasteable import pasteable
from bench.evidence.beside_seal import add_beside, read_beside
from bench.evidence.key_trust import Judgement, Moments, Trust, judge_key
from bench.evidence.openssh import NotInstalled
from bench.evidence.seal import AUTHORISATION
from bench.evidence.signers import AUTHORISATION_NAMESPACE
from bench.evidence.ssh_keys import fingerprint
from bench.evidence.sshsig import SigningKey, SshSignature, is_valid, read_signature
from bench.record.run_folder import CERTIFICATE, MANIFEST, SIGNATURE
from bench.record.storage import read_json, storage_errors


@dataclass(frozen=True)
class NamedPerson:
    """The person whom a certificate names."""

    name: str  # Of the person
    fingerprint: str  # Of the person's key


def check_authorisation(folder: Path, trust: Trust, moments: Moments, seal_key: bytes | None) -> Judgement:
    """Check the authorisation beside a seal (none: an empty judgement); ``seal_key`` None if no seal could be read."""
    try:
        data = read_beside(folder, AUTHORISATION)
        if data is None:
            return Judgement()
        signed = read_beside(folder, SIGNATURE)
        signature = read_signature(data)
    except EvidenceError as error:
        return Judgement(fault=error.what)
    public_key = signature.public_key
    try:
        why = _not_signed(signature, signed) or _wrong_person(folder, public_key, seal_key, trust)
    except NotInstalled as error:
        return Judgement(unchecked=f"{error.what.rstrip('.')}: {error.remedy.rstrip('.')}")
    judged = Judgement(fault=why) if why else judge_key(public_key, AUTHORISATION_NAMESPACE, trust, moments)
    return replace(judged, fingerprint=fingerprint(public_key))


def _not_signed(signature: SshSignature, signed: bytes | None) -> str:
    """Return why a signature does not authorise these bytes; empty if it does."""
    if signed is None:
        return "authorised before sealed: there is no seal that it could sign"
    if signature.namespace != AUTHORISATION_NAMESPACE:
        return f"the signature is for {signature.namespace!r}, not an authorisation"
    return "" if is_valid(signature, signed) else f"the signature does not match this {SIGNATURE}"


def authorise(folder: Path, key: SigningKey, trust: Trust, now: datetime, seal: bytes | None = None) -> str:
    """Authorise a sealed folder with a trusted person's key; ``seal`` is the bytes that were verified and shown."""
    person = require_authorisable(folder, key.public_key, trust, now)
    with storage_errors(folder):
        signed = (folder / SIGNATURE).read_bytes()
    if seal is not None and seal != signed:
        raise EvidenceError(
            "The seal was replaced while the folder was checked; nothing was signed.",
            where=str(folder),
            remedy="Find out who writes to this folder, and begin again.",
        )
    armoured = key.sign(signed, AUTHORISATION_NAMESPACE)
    if not is_valid(read_signature(armoured), signed):
        raise EvidenceError(
            f"The signature by {fingerprint(key.public_key)} is not valid; it was not written.",
            where=str(folder),
            remedy="Touch the token if it asks, and try again.",
        )
    add_beside(folder, AUTHORISATION, armoured)
    return person


def require_authorisable(folder: Path, public_key: bytes, trust: Trust, now: datetime) -> str:
    """Refuse a folder that is not sealed, is authorised already, or that this key may not authorise."""
    require_unauthorised(folder)
    with storage_errors(folder):
        seal_key = read_signature((folder / SIGNATURE).read_bytes()).public_key
        why = _wrong_person(folder, public_key, seal_key, trust)
    if not why:
        judged = judge_key(public_key, AUTHORISATION_NAMESPACE, trust, Moments(now, None, now, now, now))
        why = judged.fault
        if judged.principal is not None:
            return judged.principal
    raise EvidenceError(
        f"{why[0].upper()}{why[1:]}.",
        where=str(folder),
        remedy="Use the key of the person who authorises; `starbench keys trust --person` makes a person's key known.",
    )


def require_unauthorised(folder: Path) -> None:
    """Refuse a folder that is not sealed, or is authorised already."""
    if not (folder / MANIFEST).is_file() or not (folder / SIGNATURE).is_file():
        raise EvidenceError(
            "This folder is not sealed. A person authorises what is sealed, so that it cannot change afterwards.",
            where=str(folder),
            remedy="Finish the run, or issue the certificate, which seals it; then authorise it.",
        )
    if (folder / AUTHORISATION).exists():
        raise EvidenceError(
            "This folder is authorised already; an authorisation is never replaced.",
            where=str(folder),
            remedy="To amend a certificate, use `starbench certificate issue` with its folder. To check it: "
            f"{pasteable('verify', folder)}",
        )


def named_person(folder: Path) -> NamedPerson | None:
    """Return the person whom a certificate names for its authorisation; None if the folder is no certificate."""
    path = folder / CERTIFICATE
    if not path.is_file():
        return None
    try:
        person = read_json(path)["authorised_by"]
        return NamedPerson(str(person["name"]), str(person["key_fingerprint"]))
    except (StorageError, ValueError, LookupError, TypeError) as error:
        raise EvidenceError(f"{CERTIFICATE} does not name the person who is to authorise it") from error


def _wrong_person(folder: Path, public_key: bytes, seal_key: bytes | None, trust: Trust) -> str:
    """Return why a key is not that of the person who may authorise; empty if it may be."""
    if public_key == seal_key:
        return "this is the bench's own key, which sealed the folder; a person must authorise it"
    if any(signer.is_bench for signer in trust.signers if signer.public_key == public_key):
        return "this is the key of a bench; a person must authorise"
    try:
        person = named_person(folder)
    except EvidenceError as error:
        return error.what
    if person is not None and person.fingerprint != fingerprint(public_key):
        return (
            f"the certificate names {person.name} with the key {person.fingerprint}; this key is"
            f" {fingerprint(public_key)}"
        )
    return ""
