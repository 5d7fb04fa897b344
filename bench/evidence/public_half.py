"""The public half of the bench's key, which OpenSSH's private key format states in the clear.

So no passphrase is needed. The file ``bench_key.pub`` says the same, but nothing binds it to the private key: only the
signer's name is from there.
"""

from __future__ import annotations

import base64
import binascii
from pathlib import Path

from bench.base.errors import EvidenceError
from bench.evidence.private_files import refuse_readable_by_others, refuse_writable_by_others
from bench.evidence.signers import NAMESPACE, PRINCIPAL, Signer, read_public_key
from bench.evidence.ssh_keys import KEY_TYPE, key_type_of, strings
from bench.record.storage import (
    read_bounded,
    storage_errors,
)

KEY_FILE = "bench_key"
_BEGIN, _END = b"-----BEGIN OPENSSH PRIVATE KEY-----", b"-----END OPENSSH PRIVATE KEY-----"
_MAGIC = b"openssh-key-v1\0"
_MOST_KEY_BYTES = 64 * 1024  # An RSA key of 16,384 bits takes 13 kB


def load_public_key(folder: Path) -> Signer:
    """Load the public half of the bench's key, as those who verify trust it: for reports only."""
    path = folder / KEY_FILE
    try:
        public_key = public_of_private(read_key_file(path))
    except ValueError as error:
        raise EvidenceError(
            f"The key cannot be read: {error}.",
            where=str(path),
            remedy="Restore the file from a copy, or make a new key with `starbench keys rotate`.",
        ) from error
    return Signer(read_public(path.with_suffix(".pub"))[1], public_key, (NAMESPACE,))


def public_of_private(text: bytes) -> bytes:
    """Return the public key of an OpenSSH Ed25519 key file (PROTOCOL.key of OpenSSH, 1); else raise `ValueError`."""
    body, begins, _ = text.strip().removeprefix(_BEGIN).partition(_END)
    if not (text.strip().startswith(_BEGIN) and begins):
        raise ValueError("it is not in OpenSSH's format")
    try:
        blob = base64.b64decode(b"".join(body.split()), validate=True)
    except binascii.Error as error:
        raise ValueError("it is not base64") from error
    if not blob.startswith(_MAGIC):
        raise ValueError("it is not in OpenSSH's format")
    _, rest = strings(blob.removeprefix(_MAGIC), 3)  # cipher and derivation of the passphrase's key
    if rest[:4] != b"\0\0\0\1":
        raise ValueError("it does not hold one key")
    (public_key,), _ = strings(rest[4:], 1)
    if key_type_of(public_key) != KEY_TYPE.decode():
        raise ValueError("it is not an Ed25519 key")
    return public_key


def read_key_file(path: Path) -> bytes:
    """Read the file of a private key, if nobody else can read or change it."""
    if not path.exists():
        raise EvidenceError(
            "There is no key.", where=str(path), remedy="Make one with `starbench keys create`."
        )
    with storage_errors(path):
        refuse_readable_by_others(path)
        refuse_writable_by_others(path, "the bench's key")
    return read_bounded(path, _MOST_KEY_BYTES)


def read_public(path: Path) -> tuple[bytes, str]:
    """Return the public key of a file ``.pub``, and its principal, the signer as ``name@place``."""
    text = read_bounded(path, _MOST_KEY_BYTES).decode("utf-8", "replace")
    why, principal = "it does not name its signer as name@place", ([*text.split(), "", ""])[2]
    try:
        if PRINCIPAL.fullmatch(principal):
            return read_public_key(text), principal
    except ValueError as error:
        why = str(error)
    raise EvidenceError(
        f"This is not the bench's public key: {why}.",
        where=str(path),
        remedy=f"Restore it: ssh-keygen -y -f {path.with_suffix('')}; write name@place at the end.",
    )
