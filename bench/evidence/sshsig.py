"""SSH signatures (SSHSIG) with Ed25519: the bytes that ``ssh-keygen -Y sign`` writes and ``-Y verify`` reads.

Format: PROTOCOL.sshsig of OpenSSH; key and signature blobs: RFC 4253 section 6.6, RFC 8709. The message is
hashed with SHA-512. Knows bytes only: no files, and not whom to trust.
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
    """A signature taken apart.

    Attributes
    ----------
    public_key
        The signer's key as SSH encodes it (what stands in base64 after ``ssh-ed25519``).
    namespace
        What the signature is for; one for a report is not valid for anything else.
    hash_name
        Hash of the message: ``sha512`` or ``sha256``.
    signature
        The Ed25519 signature, 64 bytes.
    """

    public_key: bytes
    namespace: str
    hash_name: str
    signature: bytes


def sign(key: Ed25519PrivateKey, message: bytes, namespace: str) -> bytes:
    """Sign a message, armoured. The same key, message and namespace give the same bytes."""
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
    """Take an armoured signature apart; says nothing yet on whether it holds.

    Raises
    ------
    EvidenceError
        When it is not an SSHSIG of an Ed25519 key.
    """
    try:
        return _taken_apart(_unarmoured(armoured))
    except (ValueError, struct.error) as error:
        raise EvidenceError(
            f"This is not a signature made for a report ({error}).",
            remedy="Ask the laboratory for the bundle again.",
        ) from error


def is_valid(signature: SshSignature, message: bytes) -> bool:
    """Whether the signature is that of this message under the key it names itself."""
    key = Ed25519PublicKey.from_public_bytes(_strings(signature.public_key, 2)[1])
    data = _signed_data(message, signature.namespace.encode(), signature.hash_name.encode())
    try:
        key.verify(signature.signature, data)
    except InvalidSignature:
        return False
    return True


def encode_public_key(key: Ed25519PublicKey) -> bytes:
    """Encode a public key as SSH does (binary)."""
    return _string(KEY_TYPE) + _string(key.public_bytes_raw())


def fingerprint(public_key: bytes) -> str:
    """Give a public key's fingerprint as ``ssh-keygen -l`` prints it: ``SHA256:...``."""
    digest = base64.b64encode(hashlib.sha256(public_key).digest()).decode()
    return "SHA256:" + digest.rstrip("=")


def _taken_apart(blob: bytes) -> SshSignature:
    """Read the binary form. Raises ValueError or struct.error."""
    if blob[:6] != _MAGIC or struct.unpack(">I", blob[6:10])[0] != _VERSION:
        raise ValueError("not SSHSIG version 1")
    public, namespace, reserved, hash_name, signature = _strings(blob[10:], 5)
    key_type, key_bytes = _strings(public, 2)
    signature_type, signature_bytes = _strings(signature, 2)
    if (key_type, signature_type) != (KEY_TYPE, KEY_TYPE) or (len(key_bytes), len(signature_bytes)) != (
        32,
        64,
    ):
        raise ValueError("not an Ed25519 key and signature")
    if hash_name not in _HASHES or reserved:
        raise ValueError("unknown hash or extension")
    return SshSignature(public, namespace.decode(), hash_name.decode(), signature_bytes)


def _signed_data(message: bytes, namespace: bytes, hash_name: bytes) -> bytes:
    digest = _HASHES[hash_name](message).digest()
    return _MAGIC + _string(namespace) + _string(b"") + _string(hash_name) + _string(digest)


def _string(data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + data


def _strings(data: bytes, count: int) -> list[bytes]:
    """Take exactly ``count`` length-prefixed strings. Raises ValueError or struct.error."""
    found = []
    for _ in range(count):
        (size,) = struct.unpack(">I", data[:4])
        if len(data) < 4 + size:
            raise ValueError("cut short")
        found.append(data[4 : 4 + size])
        data = data[4 + size :]
    if data:
        raise ValueError("bytes left over")
    return found


def _unarmoured(armoured: bytes) -> bytes:
    lines = armoured.strip().splitlines()
    if len(lines) < 3 or lines[0] != _BEGIN or lines[-1] != _END:
        raise ValueError("no armour of an SSH signature")
    try:
        return base64.b64decode(b"".join(lines[1:-1]), validate=True)
    except binascii.Error as error:
        raise ValueError("not base64") from error
