"""Public keys of SSH as bytes: their types, their fingerprints, and which are accepted. No files, no trust."""

from __future__ import annotations

import base64
import hashlib
from functools import lru_cache

from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

KEY_TYPE = b"ssh-ed25519"
"""Type of the bench's own keys, whose signatures are made and checked without OpenSSH."""
KEY_TYPES = (
    KEY_TYPE,
    b"ecdsa-sha2-nistp256",
    b"ecdsa-sha2-nistp384",
    b"ecdsa-sha2-nistp521",
    b"sk-ecdsa-sha2-nistp256@openssh.com",
    b"ssh-rsa",
    b"sk-ssh-ed25519@openssh.com",
)
"""Types of keys that are accepted; those with ``sk-`` lie in a security token."""
# NIST SP 800-57: less is no longer safe; OpenSSH takes no more than the second.
_FEWEST_RSA_BITS, _MOST_RSA_BITS = 2048, 16384


def string(data: bytes) -> bytes:
    """Encode a string: its length in four bytes, then its bytes (RFC 4251, section 5)."""
    return len(data).to_bytes(4, "big") + data


def strings(data: bytes, count: int) -> tuple[list[bytes], bytes]:
    """Read so many strings, and return what follows them too (RFC 4251, section 5)."""
    parts = []
    for _ in range(count):
        size = int.from_bytes(data[:4], "big")
        if len(data) < 4 + size:
            raise ValueError("it is incomplete")
        parts.append(data[4 : 4 + size])
        data = data[4 + size :]
    return parts, data


def encode_public_key(key: Ed25519PublicKey) -> bytes:
    """Encode a public key as SSH does (RFC 8709, section 4): what OpenSSH writes in base64 after its type."""
    return string(KEY_TYPE) + string(key.public_bytes_raw())


@lru_cache  # a list verifies ten thousand seals of few keys
def check_key(public_key: bytes) -> None:
    """Refuse a public key of an unknown type, and an RSA key of less than 2048 bit."""
    key_type = key_type_of(public_key).encode()
    if key_type not in KEY_TYPES:
        raise ValueError("its type of key is not supported")
    try:
        key = serialization.load_ssh_public_key(key_text(public_key).encode())
    except UnsupportedAlgorithm as error:
        raise ValueError("its type of key is not supported") from error
    if isinstance(key, rsa.RSAPublicKey) and not _FEWEST_RSA_BITS <= key.key_size <= _MOST_RSA_BITS:
        raise ValueError(f"an RSA key must have {_FEWEST_RSA_BITS} to {_MOST_RSA_BITS} bit")


def key_type_of(public_key: bytes) -> str:
    """Return the type of a public key, as the first word of its line; empty if it cannot be read."""
    try:
        return strings(public_key, 1)[0][0].decode("ascii")
    except ValueError:
        return ""


def key_text(public_key: bytes) -> str:
    """Return a public key as OpenSSH writes it: type and base64."""
    return f"{key_type_of(public_key)} {base64.b64encode(public_key).decode()}"


def fingerprint(public_key: bytes) -> str:
    """Return the fingerprint of a public key as ``ssh-keygen -l`` does: ``SHA256:`` and base64 without padding."""
    digest = base64.b64encode(hashlib.sha256(public_key).digest()).decode()
    return "SHA256:" + digest.rstrip("=")
