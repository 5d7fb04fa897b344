"""The bench's signing key, and the list of keys that it trusts.

The key is an Ed25519 key (RFC 8032) in OpenSSH's private key format (PROTOCOL.key of OpenSSH). Its file lies in the
user's configuration folder, readable by its owner alone; the private key is never copied into a run folder or a log.
Beside it lies ``allowed_signers``, the list of trusted keys in OpenSSH's format (ssh-keygen(1), ALLOWED SIGNERS). Those
who verify reports need that file or its line.
"""

from __future__ import annotations

import base64
import binascii
import os
import re
import socket
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from fnmatch import fnmatchcase
from pathlib import Path

from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from bench.base.errors import EvidenceError
from bench.evidence.sshsig import KEY_TYPE, encode_public_key, fingerprint
from bench.records.storage import make_folder, open_to_lock, storage_errors, write_atomic
from drivers import file_lock

NAMESPACE = "starbench-report@v1"
"""Purpose of the signatures of run folders: the namespace of SSHSIG."""
AUTHORISATION_NAMESPACE = "starbench-authorisation@v1"
"""Purpose of the signature by which a person authorises a sealed folder."""
KEY_FILE = "bench_key"
SIGNERS_FILE = "allowed_signers"

_PRINCIPAL = re.compile(r"[A-Za-z0-9._+-]{1,64}@[A-Za-z0-9._-]{1,128}")
_OPTION = re.compile(r'([a-z-]+)(?:="([^"]*)")?(?:,|$)')


@dataclass(frozen=True)
class BenchKey:
    """The bench's private key, ready to sign.

    Attributes
    ----------
    private
        The private key; ``repr`` does not show it.
    principal
        Name of the signer, as ``name@place``.
    created
        Whether the key was made by this call.
    """

    private: Ed25519PrivateKey
    principal: str
    created: bool = False

    def __repr__(self) -> str:
        return f"BenchKey({self.principal}, {self.fingerprint})"

    @property
    def fingerprint(self) -> str:
        """Fingerprint of the public key, as ``ssh-keygen -l`` prints it."""
        return fingerprint(encode_public_key(self.private.public_key()))

    @property
    def public_text(self) -> str:
        """The public key as OpenSSH writes it: type and base64."""
        return (
            f"{KEY_TYPE.decode()} {base64.b64encode(encode_public_key(self.private.public_key())).decode()}"
        )

    @property
    def signers_line(self) -> str:
        """The line of ``allowed_signers`` that trusts this key for reports only."""
        return f'{self.principal} namespaces="{NAMESPACE}" {self.public_text}'


@dataclass(frozen=True)
class Signer:
    """A trusted key: one line of ``allowed_signers`` (ssh-keygen(1), ALLOWED SIGNERS).

    Attributes
    ----------
    principal
        Name of the signer, as ``name@place``.
    public_key
        The key as SSH encodes it (the part in base64 after ``ssh-ed25519``).
    namespaces
        Patterns of the purposes that it may sign for; empty if it may sign for all.
    valid_after, valid_before
        Period in which it may sign; None where there is no limit.
    """

    principal: str
    public_key: bytes
    namespaces: tuple[str, ...] = ()
    valid_after: datetime | None = None
    valid_before: datetime | None = None

    def rejection(self, namespace: str, when: datetime) -> str | None:
        """Return why a signature of this key is rejected.

        Parameters
        ----------
        namespace
            Purpose of the signature.
        when
            Moment at which the key must be valid, with its time zone.

        Returns
        -------
        str or None
            The reason; None if the key may sign.
        """
        if self.namespaces and not any(fnmatchcase(namespace, pattern) for pattern in self.namespaces):
            return f"the key is trusted for {', '.join(self.namespaces)}, not for {namespace}"
        if self.valid_after is not None and when < self.valid_after:
            return f"the key is not valid before {self.valid_after:%Y-%m-%d %H:%M} UTC"
        if self.valid_before is not None and when > self.valid_before:
            return f"the key expired {self.valid_before:%Y-%m-%d %H:%M} UTC"
        return None


def ensure_key(
    folder: Path, *, principal: str | None = None, ask_passphrase: Callable[[Path], bytes] | None = None
) -> BenchKey:
    """Load the bench's key, or make one at first use.

    Parameters
    ----------
    folder
        The configuration folder, from `bench.base.home.home_folder`.
    principal
        Name of the signer for a new key, as ``name@place``; None for ``bench@`` and the name of the computer.
    ask_passphrase
        Returns the passphrase of a protected key, given the path of its file; None if nobody can be asked.

    Returns
    -------
    BenchKey
        The key; its ``created`` is set if it is new.

    Raises
    ------
    EvidenceError
        When the key cannot be used: other users can read it, it is protected and nobody can be asked, or it is not an
        Ed25519 key.
    StorageError
        When it cannot be read or written.
    """
    make_folder(folder)
    with storage_errors(folder):
        lock = open_to_lock(folder)
        try:
            file_lock.lock(lock, wait=True)  # two runs started at the same time must not make two keys
            if (folder / KEY_FILE).exists():
                return load_key(folder, ask_passphrase=ask_passphrase)
            return create_key(folder, principal=principal)
        finally:
            os.close(lock)


def create_key(folder: Path, *, principal: str | None = None, passphrase: bytes | None = None) -> BenchKey:
    """Make the bench's key, and add it to ``allowed_signers``.

    Parameters
    ----------
    folder
        The configuration folder.
    principal
        Name of the signer, as ``name@place``; None for ``bench@`` and the name of the computer.
    passphrase
        Encrypts the private key; None leaves it unencrypted.

    Returns
    -------
    BenchKey
        The new key.

    Raises
    ------
    EvidenceError
        When there is a key already, or the principal is not ``name@place``.
    StorageError
        When it cannot be written.
    """
    path = folder / KEY_FILE
    if path.exists():
        raise EvidenceError(
            "The bench has a key already.",
            where=str(path),
            remedy="To make a new one, move this one away first; keep its line in allowed_signers, so that reports"
            " signed with it can still be verified.",
        )
    principal = principal or f"bench@{re.sub(r'[^A-Za-z0-9._-]', '-', socket.gethostname()) or 'localhost'}"
    if not _PRINCIPAL.fullmatch(principal):
        raise EvidenceError(f"{principal!r} is not a name of a signer.", remedy="Write it as name@place.")
    key = BenchKey(Ed25519PrivateKey.generate(), principal, created=True)
    protection = (
        serialization.BestAvailableEncryption(passphrase) if passphrase else serialization.NoEncryption()
    )
    secret = key.private.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.OpenSSH, protection
    )
    make_folder(folder)
    with storage_errors(folder):
        folder.chmod(0o700)
    write_atomic(path.with_suffix(".pub"), f"{key.public_text} {principal}\n".encode())
    trust(folder, key.signers_line)
    write_atomic(path, secret, mode=0o600)
    return key


def load_key(folder: Path, *, ask_passphrase: Callable[[Path], bytes] | None = None) -> BenchKey:
    """Load the bench's key.

    Parameters
    ----------
    folder
        The configuration folder.
    ask_passphrase
        Returns the passphrase of a protected key, given the path of its file; None if nobody can be asked.

    Returns
    -------
    BenchKey
        The key.

    Raises
    ------
    EvidenceError
        When there is no key, or it cannot be used (see `ensure_key`).
    StorageError
        When it cannot be read.
    """
    path = folder / KEY_FILE
    if not path.exists():
        raise EvidenceError("There is no key.", where=str(path), remedy="Make one with `starbench keys`.")
    with storage_errors(path):
        _refuse_readable_by_others(path)
        secret = path.read_bytes()
    private = _load_private_key(secret, path, ask_passphrase)
    if not isinstance(private, Ed25519PrivateKey):
        raise EvidenceError(
            "This is not an Ed25519 key.", where=str(path), remedy="Make one: ssh-keygen -t ed25519."
        )
    return BenchKey(private, _principal_of(path.with_suffix(".pub")))


def trust(folder: Path, line: str) -> Signer:
    """Add a line to ``allowed_signers``, unless the file contains it already.

    Parameters
    ----------
    folder
        The configuration folder.
    line
        A line of ``allowed_signers``, as `BenchKey.signers_line`.

    Returns
    -------
    Signer
        The key that is now trusted.

    Raises
    ------
    EvidenceError
        When this is not a line of an Ed25519 key for reports.
    StorageError
        When the file cannot be read or written.
    """
    signer = _read_signer(line.strip())
    path = folder / SIGNERS_FILE
    with storage_errors(path):
        present = path.read_text(encoding="utf-8") if path.exists() else ""
    if line.strip() not in present.splitlines():
        separator = "" if not present or present.endswith("\n") else "\n"
        make_folder(folder)
        write_atomic(path, f"{present}{separator}{line.strip()}\n".encode())
    return signer


def read_signers(path: Path) -> list[Signer]:
    """Read a list of trusted keys.

    Parameters
    ----------
    path
        A file in the format ``allowed_signers``, with Ed25519 keys only.

    Returns
    -------
    list of Signer
        The keys in the order of the lines.

    Raises
    ------
    EvidenceError
        When the file cannot be read, or a line is not understood; the message names the line.
    """
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not text"
        raise EvidenceError(
            f"The list of trusted keys cannot be read: {reason}.",
            where=str(path),
            remedy="Get the file allowed_signers from the laboratory, and name it.",
        ) from error
    signers = []
    for number, line in enumerate(lines, start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        try:
            signers.append(_read_signer(line.strip()))
        except EvidenceError as error:
            raise EvidenceError(error.what, where=f"{path}:{number}", remedy=error.remedy) from error
    return signers


def _read_signer(line: str) -> Signer:
    bad = EvidenceError(
        "This is not a line of an Ed25519 key for reports.",
        remedy='Expected form: name@place namespaces="' + NAMESPACE + '" ssh-ed25519 AAAA...',
    )
    before, found, after = line.partition(f" {KEY_TYPE.decode()} ")
    principal, _, options_text = before.partition(" ")
    if not found or not principal or not after.split():
        raise bad
    options = dict(_OPTION.findall(options_text.strip()))
    unknown = set(options) - {"namespaces", "valid-after", "valid-before"}
    if unknown or _OPTION.sub("", options_text.strip()):
        raise bad
    try:
        public_key = base64.b64decode(after.split()[0], validate=True)
        valid_after = _parse_time(options["valid-after"]) if "valid-after" in options else None
        valid_before = _parse_time(options["valid-before"]) if "valid-before" in options else None
    except (ValueError, binascii.Error) as error:
        raise bad from error
    namespaces = tuple(filter(None, options.get("namespaces", "").split(",")))
    return Signer(principal, public_key, namespaces, valid_after, valid_before)


def _parse_time(text: str) -> datetime:
    """Read a time of ssh-keygen(1): ``YYYYMMDD[HHMM[SS]][Z]``, which is local time without the Z."""
    digits = text.removesuffix("Z")
    form = {8: "%Y%m%d", 12: "%Y%m%d%H%M", 14: "%Y%m%d%H%M%S"}.get(len(digits), "")
    moment = datetime.strptime(digits, form)  # noqa: DTZ007 - the zone follows from the Z
    return moment.replace(tzinfo=UTC) if text.endswith("Z") else moment.astimezone(UTC)


def _refuse_readable_by_others(path: Path) -> None:
    status = path.stat()
    if hasattr(os, "getuid") and (status.st_mode & 0o077 or status.st_uid != os.getuid()):
        raise EvidenceError(
            f"Other users can read the key (mode {status.st_mode & 0o777:04o}): its signatures prove nothing.",
            where=str(path),
            remedy=f"If nobody has read it: chmod 600 {path}. Otherwise make a new key.",
        )


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


def _principal_of(public_path: Path) -> str:
    with storage_errors(public_path):
        fields = public_path.read_text(encoding="utf-8").split()
    principal = fields[2] if len(fields) > 2 else ""
    if not _PRINCIPAL.fullmatch(principal):
        raise EvidenceError(
            "The public key does not name its signer.",
            where=str(public_path),
            remedy="Write name@place at the end of its line.",
        )
    return principal
