"""SSH signatures (SSHSIG): the bytes that ``ssh-keygen -Y sign`` writes and ``-Y verify`` reads.

Sources: the format is PROTOCOL.sshsig of OpenSSH; keys and signatures are in `bench.evidence.ssh_keys`. The message is
hashed with SHA-512. This module handles bytes only. It reads no files and does not decide which keys are trusted.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
from dataclasses import dataclass
from typing import Protocol

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from bench.base.errors import EvidenceError
from bench.evidence.ssh_keys import KEY_TYPE, PublicKey, encode_public_key, fingerprint
from bench.evidence.ssh_wire import Reader, string

__all__ = [
    "KEY_TYPE",
    "SigningKey",
    "SshSignature",
    "encode_public_key",
    "fingerprint",
    "is_valid",
    "read_signature",
    "sign",
    "sign_with",
]

_MAGIC = b"SSHSIG"
_VERSION = 1
_HASHES = {b"sha512": hashlib.sha512, b"sha256": hashlib.sha256}
_BEGIN = b"-----BEGIN SSH SIGNATURE-----"
_END = b"-----END SSH SIGNATURE-----"
_LINE_LENGTH = 70


class SigningKey(Protocol):
    """A key that can sign, wherever its private part is: in memory, in an agent, in a token."""

    @property
    def public_key(self) -> bytes:
        """The public key as SSH encodes it."""

    def sign(self, data: bytes) -> bytes:
        """Sign data."""


@dataclass(frozen=True)
class SshSignature:
    """The parts of a signature."""

    public_key: bytes  # The signer's key as SSH encodes it (the part in base64 of its line)
    namespace: str  # Purpose of the signature; a signature for one purpose is not valid for another
    hash_name: str  # Hash function applied to the message: ``sha512`` or ``sha256``
    signature: bytes


@dataclass(frozen=True)
class _Ed25519Signer:
    """An Ed25519 key in memory, as `SigningKey`."""

    private: Ed25519PrivateKey

    @property
    def public_key(self) -> bytes:
        return encode_public_key(self.private.public_key())

    def sign(self, data: bytes) -> bytes:
        return string(KEY_TYPE) + string(self.private.sign(data))


def sign(key: Ed25519PrivateKey, message: bytes, namespace: str) -> bytes:
    """Sign a message with an Ed25519 key (PROTOCOL.sshsig of OpenSSH). The signature is deterministic (RFC 8032).

    Returns: The armoured signature, as ``ssh-keygen -Y sign`` writes it.
    """
    return sign_with(_Ed25519Signer(key), message, namespace)


def sign_with(key: SigningKey, message: bytes, namespace: str) -> bytes:
    """Sign a message (PROTOCOL.sshsig of OpenSSH).

    Returns: The armoured signature, as ``ssh-keygen -Y sign`` writes it.
    """
    signature = key.sign(_signed_data(message, namespace.encode(), b"sha512"))
    strings = (key.public_key, namespace.encode(), b"", b"sha512", signature)
    text = base64.b64encode(_MAGIC + _VERSION.to_bytes(4, "big") + b"".join(map(string, strings)))
    lines = [text[i : i + _LINE_LENGTH] for i in range(0, len(text), _LINE_LENGTH)]
    return b"\n".join([_BEGIN, *lines, _END, b""])


def read_signature(armoured: bytes) -> SshSignature:
    """Read an armoured signature (PROTOCOL.sshsig of OpenSSH). This does not yet verify it.

    armoured: The signature as ``ssh-keygen -Y sign`` writes it.
    Raises EvidenceError: When it is not an SSHSIG of a key whose type is known.
    """
    try:
        return _parse(_remove_armour(armoured))
    except ValueError as error:
        raise EvidenceError(
            f"This is not a signature made for a report ({error}).",
            remedy="Ask the laboratory for the run folder again.",
        ) from error


def is_valid(signature: SshSignature, message: bytes) -> bool:
    """Return whether a signature is valid for a message, with the public key that the signature itself contains.

    Returns: Whether it is valid; the caller decides whether the key is trusted.
    """
    data = _signed_data(message, signature.namespace.encode(), signature.hash_name.encode())
    try:
        return PublicKey.parse(signature.public_key).is_valid(signature.signature, data)
    except ValueError:
        return False


def _parse(blob: bytes) -> SshSignature:
    """Read the binary form. Raises ValueError."""
    reader = Reader(blob)
    if blob[:6] != _MAGIC or reader.take(6) != _MAGIC or reader.uint32() != _VERSION:
        raise ValueError("it is not SSHSIG version 1")
    public, namespace, reserved, hash_name, signature = (reader.string() for _ in range(5))
    reader.end()
    if hash_name not in _HASHES or reserved:
        raise ValueError("it has an unknown hash or extension")
    key = PublicKey.parse(public)
    key.is_valid(signature, b"")  # of the right form, or ValueError
    return SshSignature(public, namespace.decode(), hash_name.decode(), signature)


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
