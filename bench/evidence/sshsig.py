"""SSH signatures (SSHSIG) with Ed25519: the bytes that ``ssh-keygen -Y sign`` writes and ``-Y verify`` reads.

Sources: the format is PROTOCOL.sshsig of OpenSSH; Ed25519 is RFC 8032; its keys and signatures in SSH are RFC 8709,
sections 4 and 6; strings are RFC 4251, section 5. The message is hashed with SHA-512. This module handles bytes only.
It reads no files and does not decide which keys are trusted.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
import struct
from dataclasses import dataclass

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

from bench.base.errors import EvidenceError

KEY_TYPE = b"ssh-ed25519"

_MAGIC = b"SSHSIG"
_VERSION = 1
_HASHES = {b"sha512": hashlib.sha512, b"sha256": hashlib.sha256}
_BEGIN = b"-----BEGIN SSH SIGNATURE-----"
_END = b"-----END SSH SIGNATURE-----"
_LINE_LENGTH = 70


@dataclass(frozen=True)
class SshSignature:
    """The parts of a signature.

    Attributes
    ----------
    public_key
        The signer's key as SSH encodes it (the part in base64 after ``ssh-ed25519``).
    namespace
        Purpose of the signature; a signature for one purpose is not valid for another.
    hash_name
        Hash function applied to the message: ``sha512`` or ``sha256``.
    signature
        The Ed25519 signature, 64 bytes.
    """

    public_key: bytes
    namespace: str
    hash_name: str
    signature: bytes


def sign(key: Ed25519PrivateKey, message: bytes, namespace: str) -> bytes:
    """Sign a message (PROTOCOL.sshsig of OpenSSH). Ed25519 signatures are deterministic (RFC 8032).

    Parameters
    ----------
    key
        The private key.
    message
        What is signed.
    namespace
        Purpose of the signature.

    Returns
    -------
    bytes
        The armoured signature, as ``ssh-keygen -Y sign`` writes it.
    """
    public = encode_public_key(key.public_key())
    signature = key.sign(_signed_data(message, namespace.encode(), b"sha512"))
    blob = (
        _MAGIC
        + struct.pack(">I", _VERSION)
        + _string(public)
        + _string(namespace.encode())
        + _string(b"")
        + _string(b"sha512")
        + _string(_string(KEY_TYPE) + _string(signature))
    )
    text = base64.b64encode(blob)
    lines = [text[i : i + _LINE_LENGTH] for i in range(0, len(text), _LINE_LENGTH)]
    return b"\n".join([_BEGIN, *lines, _END, b""])


def read_signature(armoured: bytes) -> SshSignature:
    """Read an armoured signature (PROTOCOL.sshsig of OpenSSH). This does not yet verify it.

    Parameters
    ----------
    armoured
        The signature as ``ssh-keygen -Y sign`` writes it.

    Returns
    -------
    SshSignature
        Its parts.

    Raises
    ------
    EvidenceError
        When it is not an SSHSIG of an Ed25519 key.
    """
    try:
        return _parse(_remove_armour(armoured))
    except (ValueError, struct.error) as error:
        raise EvidenceError(
            f"This is not a signature made for a report ({error}).",
            remedy="Ask the laboratory for the run folder again.",
        ) from error


def is_valid(signature: SshSignature, message: bytes) -> bool:
    """Return whether a signature is valid for a message, with the public key that the signature itself contains.

    Parameters
    ----------
    signature
        The signature.
    message
        What was signed.

    Returns
    -------
    bool
        Whether it is valid (RFC 8032, section 5.1.7); the caller decides whether the key is trusted.
    """
    key = Ed25519PublicKey.from_public_bytes(_strings(signature.public_key, 2)[1])
    data = _signed_data(message, signature.namespace.encode(), signature.hash_name.encode())
    try:
        key.verify(signature.signature, data)
    except InvalidSignature:
        return False
    return True


def encode_public_key(key: Ed25519PublicKey) -> bytes:
    """Encode a public key as SSH does (RFC 8709, section 4).

    Parameters
    ----------
    key
        The public key.

    Returns
    -------
    bytes
        What OpenSSH writes in base64 after ``ssh-ed25519``.
    """
    return _string(KEY_TYPE) + _string(key.public_bytes_raw())


def fingerprint(public_key: bytes) -> str:
    """Return the fingerprint of a public key, as ``ssh-keygen -l`` prints it.

    Parameters
    ----------
    public_key
        The key as SSH encodes it.

    Returns
    -------
    str
        ``SHA256:`` and the hash in base64, without padding.
    """
    digest = base64.b64encode(hashlib.sha256(public_key).digest()).decode()
    return "SHA256:" + digest.rstrip("=")


def _parse(blob: bytes) -> SshSignature:
    """Read the binary form. Raises ValueError or struct.error."""
    if blob[:6] != _MAGIC or struct.unpack(">I", blob[6:10])[0] != _VERSION:
        raise ValueError("it is not SSHSIG version 1")
    public, namespace, reserved, hash_name, signature = _strings(blob[10:], 5)
    key_type, key_bytes = _strings(public, 2)
    signature_type, signature_bytes = _strings(signature, 2)
    if (key_type, signature_type) != (KEY_TYPE, KEY_TYPE) or (len(key_bytes), len(signature_bytes)) != (
        32,
        64,
    ):
        raise ValueError("it does not consist of an Ed25519 key and signature")
    if hash_name not in _HASHES or reserved:
        raise ValueError("it has an unknown hash or extension")
    return SshSignature(public, namespace.decode(), hash_name.decode(), signature_bytes)


def _signed_data(message: bytes, namespace: bytes, hash_name: bytes) -> bytes:
    digest = _HASHES[hash_name](message).digest()
    return _MAGIC + _string(namespace) + _string(b"") + _string(hash_name) + _string(digest)


def _string(data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + data


def _strings(data: bytes, count: int) -> list[bytes]:
    """Split into exactly ``count`` length-prefixed strings. Raises ValueError or struct.error."""
    found = []
    for _ in range(count):
        (size,) = struct.unpack(">I", data[:4])
        if len(data) < 4 + size:
            raise ValueError("it is incomplete")
        found.append(data[4 : 4 + size])
        data = data[4 + size :]
    if data:
        raise ValueError("it has surplus bytes")
    return found


def _remove_armour(armoured: bytes) -> bytes:
    lines = armoured.strip().splitlines()
    if len(lines) < 3 or lines[0] != _BEGIN or lines[-1] != _END:
        raise ValueError("it has no BEGIN and END line of an SSH signature")
    try:
        return base64.b64decode(b"".join(lines[1:-1]), validate=True)
    except binascii.Error as error:
        raise ValueError("it is not base64") from error
