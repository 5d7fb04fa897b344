"""A person's authorisation of a sealed folder: make and check ``SHA256SUMS.authorised.sig``.

It is the person's SSH signature of ``SHA256SUMS.sig``, namespace ``starbench-authorisation@v1``: bound to the seal, and
by it to every file. It is made with the person's own key, which no bench has (ISO/IEC 17025:2017, 7.8.2.1 o).
"""

from __future__ import annotations

import base64
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import datetime
from functools import lru_cache
from pathlib import Path

from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import ec, rsa
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from bench.base.errors import BenchError, EvidenceError, StorageError
from bench.evidence.findings import Findings
from bench.evidence.key_trust import Judgement, Moments, Trust, judge_key
from bench.evidence.seal import AUTHORISATION, add_beside, read_beside
from bench.evidence.signers import AUTHORISATION_NAMESPACE, read_public_key, refuse_readable_by_others
from bench.evidence.sshsig import (
    SOCKET_VARIABLE,
    Ed25519Signer,
    NotInstalled,
    OpenSshKey,
    SigningKey,
    SshSignature,
    agent_lines,
    check_key,
    fingerprint,
    is_valid,
    read_signature,
)
from bench.record.journal import Entry, read_journal
from bench.record.ledger import LEDGER, Ledger
from bench.record.run_folder import MANIFEST, SIGNATURE
from bench.record.storage import read_json, sha256_of, storage_errors

# A person's own key: in a file, or in ssh-agent. It never belongs to a bench.

_MOST_BYTES = 1 << 20


def load_file_key(path: Path, ask_passphrase: Callable[[Path], bytes]) -> SigningKey:
    """Load a person's key from a file in OpenSSH's format or PEM (PKCS#8), which other users cannot read."""
    with storage_errors(path):
        refuse_readable_by_others(path)
        with path.open("rb") as stream:
            data = stream.read(_MOST_BYTES)
    load = serialization.load_ssh_private_key if b"OPENSSH" in data else serialization.load_pem_private_key
    passphrase = b""
    try:
        try:
            private = load(data, password=None)
        except TypeError:  # cryptography raises it if the key is protected
            passphrase = ask_passphrase(path)
            private = load(data, password=passphrase)
        return _signing_key(private, path, passphrase)
    except (ValueError, UnsupportedAlgorithm) as error:
        why = "the passphrase is wrong, or the file is damaged" if passphrase else _reason(error)
        raise EvidenceError(
            f"The key cannot be used: {why}.",
            where=str(path),
            remedy="Try again. A key in a token is used by ssh-agent: name its file .pub.",
        ) from error


def _signing_key(private: object, path: Path, passphrase: bytes) -> SigningKey:
    """Return a key that was read. Raises ValueError if it cannot sign here."""
    if isinstance(private, Ed25519PrivateKey):
        return Ed25519Signer(private)
    if not isinstance(private, ec.EllipticCurvePrivateKey | rsa.RSAPrivateKey):
        raise ValueError("its type of key is not supported")  # noqa: TRY004 - not a wrong argument, but a wrong file
    public = private.public_key().public_bytes(
        serialization.Encoding.OpenSSH, serialization.PublicFormat.OpenSSH
    )
    blob = base64.b64decode(public.split()[1])
    check_key(blob)
    return OpenSshKey(blob, path, passphrase)


def find_key(name: str | None, agent: str | None, ask_passphrase: Callable[[Path], bytes]) -> SigningKey:
    """Find a key by its file, by its public key's, or by ``SHA256:...`` in ssh-agent; None is the only key there."""
    if name is None or name.startswith("SHA256:"):
        return _agent_key(name, agent)
    path = Path(name)
    with storage_errors(path), path.open("rb") as stream:
        text = stream.read(_MOST_BYTES)
    try:
        public_key = read_public_key(text.decode(errors="replace"))
    except ValueError:
        return load_file_key(path, ask_passphrase)
    return _agent_key(fingerprint(public_key), agent)


def agent_keys(agent: str) -> list[OpenSshKey]:
    """List the keys of an agent that can be used here. Keys of other types and certificates are left out."""
    found = []
    for line in agent_lines(agent):
        try:
            blob = read_public_key(line)
        except ValueError:
            continue
        comment = "".join(line.split(maxsplit=2)[2:])
        found.append(OpenSshKey(blob, agent=agent, comment=comment))
    return found


def _agent_key(wanted: str | None, agent: str | None) -> OpenSshKey:
    """Return the key of the agent with a fingerprint, or the only one."""
    if agent is None:
        raise EvidenceError(
            f"There is no ssh-agent: {SOCKET_VARIABLE} is not set.",
            remedy="Name the file of the private key with --key, or start ssh-agent and add the key with ssh-add.",
        )
    keys = agent_keys(agent)
    found = [key for key in keys if wanted in {None, fingerprint(key.public_key)}]
    if len(found) == 1:
        return found[0]
    held = ", ".join(f"{fingerprint(key.public_key)} ({key.comment})" for key in keys[:5]) or "none"
    what = f"ssh-agent does not hold the key {wanted}." if wanted else f"ssh-agent holds {len(keys)} keys."
    raise EvidenceError(
        what,
        where=agent,
        remedy=f"Its keys: {held}. Name one with --key SHA256:..., or add yours with ssh-add.",
    )


def _reason(error: Exception) -> str:
    """Return the first sentence of a message of the library, without its end."""
    return str(error).split(". ", maxsplit=1)[0].rstrip(".") or "wrong passphrase"


# Authorisations in the bench's ledger: a line for each, so that one that was removed afterwards is noticed.
#
# The signature of a person lies beside the seal, and no list names it: whoever deletes the file turns
# AUTHORISED into SEALED. The ledger of the bench on which the person signed knows the seal and the
# signature by their SHA-256. A bench without a ledger enters nothing; the ledger of another bench knows
# nothing of the folder.

FOLDER_AUTHORISED = "folder_authorised"
_SHOWN = 16


@dataclass(frozen=True)
class Authorised:
    """An authorisation that the ledger names."""

    signature: str  # SHA-256 of the file with the person's signature
    person: str
    fingerprint: str
    folder: str  # The folder, where it lay then
    utc: str  # When the line was written, ISO 8601

    def __str__(self) -> str:
        return f"{self.person} ({self.fingerprint}) on {self.utc[:_SHOWN].replace('T', ' ')} UTC"


Known = Mapping[str, Sequence[Authorised]]
"""Authorisations by the SHA-256 of the seal's list of files, in the order of the ledger."""
NOTHING_KNOWN: Known = {}


def enter_authorisation(ledger: Ledger, folder: Path, person: str, fingerprint: str) -> bool:
    """Write into the ledger that a person has authorised this folder. False if the bench has no ledger."""
    if not ledger.path.exists():
        return False
    with storage_errors(folder):
        hashes = {"seal": sha256_of(folder / MANIFEST), "signature": sha256_of(folder / AUTHORISATION)}
    facts = {"folder": str(folder.resolve()), "person": person, "fingerprint": fingerprint}
    ledger.append(FOLDER_AUTHORISED, **hashes, **facts)
    return True


def known_authorisations(home: Path) -> Known:
    """Return the authorisations that this bench's ledger names; empty if it is missing or cannot be read."""
    path = home / LEDGER
    try:
        status = path.stat()
    except OSError:
        return NOTHING_KNOWN
    return _read(path, status.st_mtime_ns, status.st_size)


@lru_cache(maxsize=4)
def _read(path: Path, _changed_ns: int, _size: int) -> Known:
    """Read the ledger once for each of its states: a page that is shown asks every second."""
    with suppress(BenchError):
        return _authorisations(read_journal(path)[0])
    return NOTHING_KNOWN


def _authorisations(entries: Sequence[Entry]) -> Known:
    found: dict[str, list[Authorised]] = {}
    for entry in entries:
        if entry.event == FOLDER_AUTHORISED:
            signature, person, fingerprint, folder = (
                str(entry.data.get(name, "")) for name in ("signature", "person", "fingerprint", "folder")
            )
            one = Authorised(signature, person, fingerprint, folder, entry.utc)
            found.setdefault(str(entry.data.get("seal", "")), []).append(one)
    return found


def compare_authorisation(folder: Path, known: Known) -> Findings:
    """Compare a folder's authorisation with the ledger's: nothing if they agree, or if it names none for this seal.

    A fault if it was removed or replaced; a remark if a copy, which is perhaps older, does not have it.
    """
    found = Findings()
    manifest, signature = folder / MANIFEST, folder / AUTHORISATION
    with storage_errors(folder):
        if not known or not manifest.is_file():
            return found
        named = known.get(sha256_of(manifest), ())
        if not named or (signature.is_file() and sha256_of(signature) in {one.signature for one in named}):
            return found
        is_there, here = signature.exists(), folder.resolve()
    last = named[-1]
    if is_there:
        what = f"the ledger names another authorisation than {AUTHORISATION}: by {last}"
        found.fault("authorisation", AUTHORISATION, what)
    elif here not in {Path(one.folder).resolve() for one in named} and Path(last.folder).is_dir():
        found.remarks.append(
            f"the ledger names an authorisation that this copy does not have: by {last}, in {last.folder}"
        )
    else:
        again = f"Copy {AUTHORISATION} back, or let the person authorise again"
        what = f"the ledger names an authorisation that is missing: by {last}. {again}"
        found.fault("authorisation", AUTHORISATION, what)
    return found


def lost_authorisations(known: Known) -> list[str]:
    """Compare all folders that the ledger names as authorised, as far as they are still there."""
    found = []
    for folder in sorted({one.folder for named in known.values() for one in named if one.folder}):
        with suppress(BenchError):
            found += [f"{folder}: {one.what}." for one in compare_authorisation(Path(folder), known).faults]
    return found


_CERTIFICATE = "certificate.json"


@dataclass(frozen=True)
class NamedPerson:
    """The person whom a certificate names."""

    # name, fingerprint: Name, and fingerprint of the person's key.
    name: str
    fingerprint: str


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
            remedy="Check it with `starbench verify`. To amend a certificate, use `starbench certificate issue` with"
            " its folder.",
        )


def named_person(folder: Path) -> NamedPerson | None:
    """Return the person whom a certificate names for its authorisation; None if the folder is no certificate."""
    path = folder / _CERTIFICATE
    if not path.is_file():
        return None
    try:
        found = read_json(path)["authorised_by"]
        return NamedPerson(str(found["name"]), str(found["key_fingerprint"]))
    except (StorageError, ValueError, LookupError, TypeError) as error:
        raise EvidenceError(f"{_CERTIFICATE} does not name the person who is to authorise it") from error


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
