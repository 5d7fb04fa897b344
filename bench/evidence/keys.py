"""The bench's signing key: made at first use, loaded, checked before it is needed, and replaced.

An Ed25519 key (RFC 8032) in OpenSSH's private key format (PROTOCOL.key of OpenSSH) in the user's configuration folder,
never copied into a run or a log. Beside it lies ``allowed_signers``, which those who verify reports need.
"""

from __future__ import annotations

import re
import socket
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from bench.base.errors import EvidenceError
from bench.evidence.public_half import KEY_FILE, read_key_file, read_public
from bench.evidence.revoked_keys import REVOKED_FILE, read_revoked
from bench.evidence.signers import NAMESPACE, PRINCIPAL, SIGNERS_FILE, read_public_key, signers_of, trust
from bench.evidence.ssh_keys import fingerprint, key_text
from bench.evidence.sshsig import Ed25519Signer
from bench.record.folder_lock import locked_folder
from bench.record.storage import make_folder, storage_errors, write_atomic
from drivers.durable import sync_folder

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
        if not (folder / KEY_FILE).exists():
            return create_key(folder, principal=principal)
    return load_key(folder, ask_passphrase=ask_passphrase)  # a passphrase may take long, others need the lock


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
    known = [signer for signer in signers_of(folder) if signer.public_key == public]
    rejections = [entry.rejection(NAMESPACE, when) for entry in known]
    revoked = next(
        (entry for entry in read_revoked(folder / REVOKED_FILE) if entry.public_key == public), None
    )
    if revoked is not None:
        rejections = [f"the key was revoked {revoked.text}"]
    if rejections and None not in rejections:
        is_early = all(entry.valid_after is not None and when < entry.valid_after for entry in known)
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
    return BenchKey(private, read_public(path.with_suffix(".pub"))[1])


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
