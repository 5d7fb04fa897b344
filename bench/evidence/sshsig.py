"""SSH signatures (SSHSIG, PROTOCOL.sshsig of OpenSSH): what ``ssh-keygen -Y sign`` writes and ``-Y verify`` reads.

Ed25519 is signed and checked here, so that a bench needs no OpenSSH; other keys are left to ``ssh-keygen``. Which keys
are trusted is decided elsewhere.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
from dataclasses import dataclass, field
from typing import Protocol

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

from bench.base.errors import EvidenceError
from bench.evidence.openssh import is_valid_for_openssh
from bench.evidence.ssh_keys import (
    KEY_TYPE,
    check_key,
    encode_public_key,
    fingerprint,
    key_type_of,
    string,
    strings,
)

_MAGIC = b"SSHSIG"
_VERSION = 1  # SIG_VERSION of OpenSSH's PROTOCOL.sshsig
_HASHES = {b"sha512": hashlib.sha512, b"sha256": hashlib.sha256}
_BEGIN = b"-----BEGIN SSH SIGNATURE-----"
_END = b"-----END SSH SIGNATURE-----"
_LINE_LENGTH = 70  # As `ssh-keygen -Y sign` writes it
_TOUCHED = 1
"""Bit of the flags of a security token's signature: a person touched the token (PROTOCOL.u2f of OpenSSH)."""
_FLAGS_AND_COUNTER = 5  # Bytes: one of flags and a 32-bit counter (PROTOCOL.u2f)
_SIGNATURE_TYPES = {"ssh-rsa": ("rsa-sha2-512", "rsa-sha2-256")}


class SigningKey(Protocol):
    """A key that can sign, wherever its private part is: in memory, in a file, in an agent, in a token."""

    @property
    def public_key(self) -> bytes:
        """The public key as SSH encodes it."""

    def sign(self, message: bytes, namespace: str) -> bytes:
        """Return the armoured signature of a message."""


@dataclass(frozen=True)
class SshSignature:
    """The parts of a signature."""

    public_key: bytes  # The signer's key as SSH encodes it (the part in base64 of its line)
    namespace: str  # Purpose of the signature; a signature for one purpose is not valid for another
    hash_name: str  # Hash function applied to the message: ``sha512`` or ``sha256``
    signature: bytes
    armoured: bytes = field(default=b"", compare=False)  # As it was read


@dataclass(frozen=True)
class Ed25519Signer:
    """An Ed25519 key in memory, as `SigningKey`."""

    private: Ed25519PrivateKey  # The private key; ``repr`` does not show it

    def __repr__(self) -> str:
        return f"Ed25519Signer({fingerprint(self.public_key)})"

    @property
    def public_key(self) -> bytes:
        """The public key as SSH encodes it."""
        return encode_public_key(self.private.public_key())

    def sign(self, message: bytes, namespace: str) -> bytes:
        """Sign as ``ssh-keygen -Y sign`` does, armoured (PROTOCOL.sshsig of OpenSSH); deterministic (RFC 8032)."""
        signature = string(KEY_TYPE) + string(
            self.private.sign(_signed_data(message, namespace.encode(), b"sha512"))
        )
        parts = (self.public_key, namespace.encode(), b"", b"sha512", signature)
        text = base64.b64encode(_MAGIC + _VERSION.to_bytes(4, "big") + b"".join(map(string, parts)))
        lines = [text[i : i + _LINE_LENGTH] for i in range(0, len(text), _LINE_LENGTH)]
        return b"\n".join([_BEGIN, *lines, _END, b""])


def read_signature(armoured: bytes) -> SshSignature:
    """Read an armoured signature (PROTOCOL.sshsig of OpenSSH). This does not yet verify it."""
    try:
        return _parse(_remove_armour(armoured), armoured)
    except ValueError as error:
        raise EvidenceError(
            f"This is not a signature made for a report ({error}).",
            remedy="Ask the laboratory for the run folder again.",
        ) from error


def is_valid(signature: SshSignature, message: bytes) -> bool:
    """Return whether a signature is valid for its own key; a security token's only if a person touched the token."""
    key_type = key_type_of(signature.public_key)
    if key_type.encode() != KEY_TYPE:
        if key_type.startswith("sk-") and not signature.signature[-_FLAGS_AND_COUNTER] & _TOUCHED:
            return False
        return is_valid_for_openssh(signature.armoured, message, signature.namespace)
    data = _signed_data(message, signature.namespace.encode(), signature.hash_name.encode())
    key = Ed25519PublicKey.from_public_bytes(strings(signature.public_key, 2)[0][1])
    try:
        key.verify(strings(signature.signature, 2)[0][1], data)
    except InvalidSignature:
        return False
    return True


def _parse(blob: bytes, armoured: bytes) -> SshSignature:
    """Read the binary form. Raises ValueError."""
    head = _MAGIC + _VERSION.to_bytes(4, "big")
    if not blob.startswith(head):
        raise ValueError("it is not SSHSIG version 1")
    (public, namespace, reserved, hash_name, signature), rest = strings(blob.removeprefix(head), 5)
    if rest:
        raise ValueError("it has surplus bytes")
    if hash_name not in _HASHES or reserved:
        raise ValueError("it has an unknown hash or extension")
    check_key(public)
    _check_form(key_type_of(public), signature)
    return SshSignature(public, namespace.decode(), hash_name.decode(), signature, armoured)


def _check_form(key_type: str, signature: bytes) -> None:
    """Raise ValueError for a signature that is not of the form of this type of key."""
    (signature_type, signed), rest = strings(signature, 2)
    if signature_type.decode("ascii") not in _SIGNATURE_TYPES.get(key_type, (key_type,)):
        what = "an RSA signature must be rsa-sha2-512 or rsa-sha2-256"
        raise ValueError(
            what if key_type == "ssh-rsa" else "the type of the signature is not that of the key"
        )
    if len(rest) != (_FLAGS_AND_COUNTER if key_type.startswith("sk-") else 0):
        raise ValueError("it has surplus bytes" if rest else "it is incomplete")
    if key_type.encode() == KEY_TYPE and len(signed) != 64:
        raise ValueError("an Ed25519 signature has 64 bytes")


def _signed_data(message: bytes, namespace: bytes, hash_name: bytes) -> bytes:
    digest = _HASHES[hash_name](message).digest()
    return _MAGIC + string(namespace) + string(b"") + string(hash_name) + string(digest)


def _remove_armour(armoured: bytes) -> bytes:
    lines = armoured.strip().splitlines()
    if len(lines) < 3 or lines[0] != _BEGIN or lines[-1] != _END:
        raise ValueError("it has no BEGIN and END line of an SSH signature")
    try:
        return base64.b64decode(b"".join(lines[1:-1]), validate=True)
    except binascii.Error as error:
        raise ValueError("it is not base64") from error
