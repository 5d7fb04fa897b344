"""The bench's signing key: made at first use, loaded, checked before it is needed, and replaced.

An Ed25519 key (RFC 8032) in OpenSSH's private key format (PROTOCOL.key of OpenSSH) in the user's configuration folder,
never copied into a run or a log. Beside it lies ``allowed_signers``, which those who verify reports need.
"""

from __future__ import annotations

import base64
import binascii
import os
import re
import socket
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from pathlib import Path

from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from bench.base.errors import EvidenceError
from bench.evidence.signers import (
    NAMESPACE,
    PRINCIPAL,
    REVOKED_FILE,
    SIGNERS_FILE,
    Signer,
    read_public_key,
    read_revoked,
    read_signer,
    refuse_readable_by_others,
    refuse_writable_by_others,
    replace_lines,
    signers_of,
    trust,
)
from bench.evidence.sshsig import KEY_TYPE, Ed25519Signer, fingerprint, key_text, key_type_of, strings
from bench.record.storage import (
    locked_folder,
    make_folder,
    read_bounded,
    storage_errors,
    sync_folder,
    write_atomic,
)

# The public half of the bench's key. OpenSSH's private key format states it in the clear, so no passphrase
# is needed.
#
# The file ``bench_key.pub`` says the same, but nothing binds it to the private key: only the signer's name
# is from there.

KEY_FILE = "bench_key"
_BEGIN, _END = b"-----BEGIN OPENSSH PRIVATE KEY-----", b"-----END OPENSSH PRIVATE KEY-----"
_MAGIC = b"openssh-key-v1\0"
_MOST_KEY_BYTES = 64 * 1024


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
    return Signer(principal_of(path.with_suffix(".pub")), public_key, (NAMESPACE,))


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


def principal_of(public_path: Path) -> str:
    """Return the name of the signer that the file of a public key states, as ``name@place``."""
    fields = read_bounded(public_path, _MOST_KEY_BYTES).decode("utf-8", "replace").split()
    principal = fields[2] if len(fields) > 2 else ""
    if not PRINCIPAL.fullmatch(principal):
        raise EvidenceError(
            "The public key does not name its signer.",
            where=str(public_path),
            remedy="Write name@place at the end of its line.",
        )
    return principal


NEW_KEY = f"{KEY_FILE}.new"
"""A key that replaces the bench's key, complete beside it, until it is put in its place."""


@dataclass(frozen=True)
class BenchKey(Ed25519Signer):
    """The bench's private key, ready to sign."""

    principal: str  # Name of the signer, as ``name@place``
    created: bool = False  # Whether the key was made by this call

    def __repr__(self) -> str:
        return f"BenchKey({self.principal}, {self.fingerprint})"

    @property
    def fingerprint(self) -> str:
        """Fingerprint of the public key, as ``ssh-keygen -l`` prints it."""
        return fingerprint(self.public_key)

    @property
    def public_text(self) -> str:
        """The public key as OpenSSH writes it: type and base64."""
        return key_text(self.public_key)

    @property
    def signers_line(self) -> str:
        """The line of ``allowed_signers`` that trusts this key for reports only."""
        return f'{self.principal} namespaces="{NAMESPACE}" {self.public_text}'


def ensure_key(
    folder: Path, *, principal: str | None = None, ask_passphrase: Callable[[Path], bytes] | None = None
) -> BenchKey:
    """Load the bench's key, or make one; others' reading it, or a passphrase that nobody can give, is refused."""
    make_folder(folder)
    with (
        storage_errors(folder),
        locked_folder(folder),
    ):  # two runs started at the same time must not make two keys
        if (folder / KEY_FILE).exists():
            finish_rotation(folder)
            return _load(folder, ask_passphrase)
        return create_key(folder, principal=principal)


def create_key(folder: Path, *, principal: str | None = None, passphrase: bytes | None = None) -> BenchKey:
    """Make the bench's key, and add it to ``allowed_signers``; without a passphrase it is not encrypted.

    ``principal`` is the signer as ``name@place``; None for ``bench@`` and the name of the computer.
    """
    path = folder / KEY_FILE
    if path.exists():
        raise EvidenceError(
            "The bench has a key already.",
            where=str(path),
            remedy="To replace it, use `starbench keys rotate`; reports signed with it can then still be verified.",
        )
    principal = principal or f"bench@{re.sub(r'[^A-Za-z0-9._-]', '-', socket.gethostname()) or 'localhost'}"
    if not PRINCIPAL.fullmatch(principal):
        raise EvidenceError(f"{principal!r} is not a name of a signer.", remedy="Write it as name@place.")
    key = BenchKey(Ed25519PrivateKey.generate(), principal, created=True)
    make_folder(folder)
    with storage_errors(folder):
        folder.chmod(0o700)
    write_atomic(path.with_suffix(".pub"), f"{key.public_text} {principal}\n".encode())
    trust(folder, key.signers_line)
    write_atomic(path, private_text(key, passphrase), mode=0o600)
    return key


def private_text(key: BenchKey, passphrase: bytes | None) -> bytes:
    """Return the private key in OpenSSH's format, encrypted if there is a passphrase."""
    protection = (
        serialization.BestAvailableEncryption(passphrase) if passphrase else serialization.NoEncryption()
    )
    return key.private.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.OpenSSH, protection
    )


def require_usable(folder: Path, key: BenchKey, when: datetime) -> None:
    """Refuse a key before a run if nobody would accept its seals: not trusted now, revoked, or lists not safe."""
    public = key.public_key
    known = [one for one in signers_of(folder) if one.public_key == public]
    rejections = [one.rejection(NAMESPACE, when) for one in known]
    revoked = next((one for one in read_revoked(folder / REVOKED_FILE) if one.public_key == public), None)
    if revoked is not None:
        rejections = [f"the key was revoked {revoked.text}"]
    if rejections and None not in rejections:
        is_early = all(one.valid_after is not None and when < one.valid_after for one in known)
        raise EvidenceError(
            f"The bench's key {key.fingerprint} cannot seal: {rejections[0]}.",
            where=str(folder / SIGNERS_FILE),
            remedy=f"Check the clock of this computer: it is {when:%Y-%m-%d %H:%M} UTC."
            if is_early and revoked is None
            else "Make a new key with `starbench keys rotate`.",
        )


def usable_key(
    folder: Path, when: datetime, *, ask_passphrase: Callable[[Path], bytes] | None = None
) -> BenchKey:
    """Load the bench's key, or make one at first use, and check that its seals will be accepted."""
    key = ensure_key(folder, ask_passphrase=ask_passphrase)
    require_usable(folder, key, when)
    return key


def key_to_seal(
    folder: Path, key: BenchKey, when: datetime, ask_passphrase: Callable[[Path], bytes] | None = None
) -> BenchKey:
    """Return the key to seal a run with, also if it was replaced; after an error ``resume`` can seal the run later."""
    _finish_locked(folder)
    public = folder / f"{KEY_FILE}.pub"
    with storage_errors(public):
        is_replaced = public.exists() and key.public_text not in public.read_text(encoding="utf-8")
    if is_replaced:
        key = load_key(folder, ask_passphrase=ask_passphrase)
    require_usable(folder, key, when)
    return key


def load_key(folder: Path, *, ask_passphrase: Callable[[Path], bytes] | None = None) -> BenchKey:
    """Load the bench's key; ``ask_passphrase`` is None if nobody can be asked. Raises as `ensure_key`."""
    _finish_locked(folder)
    return _load(folder, ask_passphrase)


def finish_rotation(folder: Path) -> None:
    """Put a new key in its place, if the process that replaced it was killed after the new one became trusted."""
    new, public = folder / NEW_KEY, folder / f"{NEW_KEY}.pub"
    with storage_errors(folder):
        if not new.exists() or not public.exists():
            return
        text = public.read_bytes()
        if read_public_key(text.decode()) not in {signer.public_key for signer in signers_of(folder)}:
            return  # killed before: the old key stays
        write_atomic(folder / f"{KEY_FILE}.pub", text)
        new.replace(folder / KEY_FILE)
        sync_folder(folder)
        public.unlink()


def _finish_locked(folder: Path) -> None:
    """Finish a replacement of the key, if one was begun; usually there is none, and nothing is locked."""
    if (folder / NEW_KEY).exists():
        with storage_errors(folder), locked_folder(folder):
            finish_rotation(folder)


def _load(folder: Path, ask_passphrase: Callable[[Path], bytes] | None) -> BenchKey:
    path = folder / KEY_FILE
    secret = read_key_file(path)
    private = _load_private_key(secret, path, ask_passphrase)
    if not isinstance(private, Ed25519PrivateKey):
        raise EvidenceError(
            "This is not an Ed25519 key.", where=str(path), remedy="Make one: ssh-keygen -t ed25519."
        )
    return BenchKey(private, principal_of(path.with_suffix(".pub")))


def _load_private_key(secret: bytes, path: Path, ask_passphrase: Callable[[Path], bytes] | None) -> object:
    try:
        with suppress(TypeError):  # raised by cryptography if the key is protected
            return serialization.load_ssh_private_key(secret, password=None)
        if ask_passphrase is None:
            raise EvidenceError(
                "The key is protected by a passphrase, and there is no terminal to ask for it.",
                where=str(path),
                remedy="Run in a terminal, or remove the passphrase with ssh-keygen -p.",
            )
        return serialization.load_ssh_private_key(secret, password=ask_passphrase(path))
    except ValueError as error:
        raise EvidenceError(
            "The key cannot be read: wrong passphrase, or not an OpenSSH key.",
            where=str(path),
            remedy="Try again, or restore the file from a copy.",
        ) from error


# Replace the bench's key. Reports sealed with the old key stay valid for their time.


ARCHIVE = "old_keys"
"""Folder of private keys that are no longer used."""


@dataclass(frozen=True)
class Rotation:
    """A replacement of the bench's key."""

    old: str
    new: str
    line: str  # Line of ``allowed_signers`` that trusts the new key
    archived: Path | None  # Where the old private key is kept; None if it was deleted


def rotate(folder: Path, now: datetime, *, passphrase: bytes | None, keep_old: bool) -> Rotation:
    """Replace the key, with the same principal; ``keep_old`` keeps it in ``old_keys``; no passphrase: not encrypted."""
    if not (folder / KEY_FILE).exists():
        raise EvidenceError(
            "There is no key to replace.", where=str(folder), remedy="Make one with `starbench keys create`."
        )
    with storage_errors(folder), locked_folder(folder):
        finish_rotation(folder)
        old, principal = read_public(folder / f"{KEY_FILE}.pub")
        archived = _archive(folder, old, keep=keep_old)
        line = _begin(folder, now, old, principal, passphrase)
        finish_rotation(folder)
    return Rotation(fingerprint(old), fingerprint(read_signer(line).public_key), line, archived)


def _begin(folder: Path, now: datetime, old: bytes, principal: str, passphrase: bytes | None) -> str:
    """Make the new key beside the old one, and change the list of trusted keys; return the new line."""
    key = BenchKey(Ed25519PrivateKey.generate(), principal)
    signer = replace(read_signer(key.signers_line), valid_after=now.replace(microsecond=0))
    with storage_errors(folder):  # of a process that was killed before the new key was trusted
        for name in (NEW_KEY, f"{NEW_KEY}.pub"):
            (folder / name).unlink(missing_ok=True)
    write_atomic(folder / NEW_KEY, private_text(key, passphrase), mode=0o600)
    write_atomic(folder / f"{NEW_KEY}.pub", f"{key.public_text} {principal}\n".encode())
    end = now.replace(microsecond=0) + timedelta(seconds=1)  # what was sealed in this second stays valid
    replace_lines(folder, old, end, [signer.line])
    return signer.line


def _archive(folder: Path, old: bytes, *, keep: bool) -> Path | None:
    """Keep the old private key under a name that no other key has, before it is replaced; or see that it is not."""
    name = fingerprint(old).removeprefix("SHA256:").replace("/", "_").replace("+", "-")[:16]
    path = folder / ARCHIVE / f"{KEY_FILE}-{name}"
    with storage_errors(path):
        if not keep:
            path.unlink(missing_ok=True)
            return None
        make_folder(folder / ARCHIVE)
        (folder / ARCHIVE).chmod(0o700)
        with suppress(FileExistsError):  # of an interrupted replacement
            os.link(folder / KEY_FILE, path)
        sync_folder(folder / ARCHIVE)
    return path


def read_public(path: Path) -> tuple[bytes, str]:
    """Return the public key of a file ``.pub``, and its principal."""
    with storage_errors(path):
        text = path.read_text(encoding="utf-8")
    try:
        key = read_public_key(text)
    except ValueError as error:
        raise _not_public(path, str(error)) from error
    principal = ([*text.split(), "", ""])[2]
    if not PRINCIPAL.fullmatch(principal):
        raise _not_public(path, "it does not name its signer as name@place")
    return key, principal


def _not_public(path: Path, why: str) -> EvidenceError:
    return EvidenceError(
        f"This is not the bench's public key: {why}.",
        where=str(path),
        remedy=f"Restore it: ssh-keygen -y -f {path.with_suffix('')}; write name@place at the end.",
    )
