"""The bench's signing key and the keys it trusts: where they lie, who may read them, how they are made.

The key is an Ed25519 key in OpenSSH's own file format, in the user's configuration folder, readable by
its owner alone; it never goes into a run folder or a log. Beside it lies ``allowed_signers``, OpenSSH's
list of trusted keys: give that file, or its line, to whoever is to verify reports.
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
"""What signatures of run folders are for."""
KEY_FILE = "bench_key"
SIGNERS_FILE = "allowed_signers"

_PRINCIPAL = re.compile(r"[A-Za-z0-9._+-]{1,64}@[A-Za-z0-9._-]{1,128}")
_OPTION = re.compile(r'([a-z-]+)(?:="([^"]*)")?(?:,|$)')


@dataclass(frozen=True)
class BenchKey:
    """The bench's key, ready to sign.

    Attributes
    ----------
    private
        The key itself; not shown when this is printed.
    principal
        Who signs, as ``name@place``.
    created
        Whether it was made just now.
    """

    private: Ed25519PrivateKey
    principal: str
    created: bool = False

    def __repr__(self) -> str:
        return f"BenchKey({self.principal}, {self.fingerprint})"

    @property
    def fingerprint(self) -> str:
        """Fingerprint of its public half, as ``ssh-keygen -l`` prints it."""
        return fingerprint(encode_public_key(self.private.public_key()))

    @property
    def public_text(self) -> str:
        """Its public half as OpenSSH writes it: type and base64."""
        return (
            f"{KEY_TYPE.decode()} {base64.b64encode(encode_public_key(self.private.public_key())).decode()}"
        )

    @property
    def signers_line(self) -> str:
        """The line of ``allowed_signers`` that trusts this key for reports and nothing else."""
        return f'{self.principal} namespaces="{NAMESPACE}" {self.public_text}'


@dataclass(frozen=True)
class Signer:
    """A trusted key: one line of ``allowed_signers`` (ssh-keygen(1), ALLOWED SIGNERS)."""

    principal: str
    public_key: bytes
    namespaces: tuple[str, ...] = ()
    valid_after: datetime | None = None
    valid_before: datetime | None = None

    def rejection(self, namespace: str, when: datetime) -> str | None:
        """Say why this key may not sign for ``namespace`` at ``when``; None when it may."""
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
    """Load the bench's key, or make one at first use (``created`` tells: the operator wants to know).

    Parameters
    ----------
    folder
        As ``home_folder`` gives it.
    principal
        Who signs, when a key is made; the default is ``bench@`` and the name of the machine.
    ask_passphrase
        Asked for the passphrase of a protected key, given its file.

    Raises
    ------
    EvidenceError
        When the key cannot be used: readable by others, protected and nobody to ask, not Ed25519.
    StorageError
        When it cannot be read or made.
    """
    make_folder(folder)
    with storage_errors(folder):
        lock = open_to_lock(folder)
        try:
            file_lock.lock(lock, wait=True)  # two runs started at once must not make two keys
            if (folder / KEY_FILE).exists():
                return load_key(folder, ask_passphrase=ask_passphrase)
            return create_key(folder, principal=principal)
        finally:
            os.close(lock)


def create_key(folder: Path, *, principal: str | None = None, passphrase: bytes | None = None) -> BenchKey:
    """Make the bench's key and trust it in ``allowed_signers``.

    Raises
    ------
    EvidenceError
        When there is one already, or the principal is not ``name@place``.
    StorageError
        When it cannot be written.
    """
    path = folder / KEY_FILE
    if path.exists():
        raise EvidenceError(
            "The bench has a key already.",
            where=str(path),
            remedy="Reports signed with it need it to stay known; move it away first to begin a new one.",
        )
    principal = principal or f"bench@{re.sub(r'[^A-Za-z0-9._-]', '-', socket.gethostname()) or 'localhost'}"
    if not _PRINCIPAL.fullmatch(principal):
        raise EvidenceError(f"{principal!r} does not name a signer.", remedy="Write it as name@place.")
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
    """Load the bench's key. Parameters and errors as ``ensure_key``; EvidenceError when there is none."""
    path = folder / KEY_FILE
    if not path.exists():
        raise EvidenceError("There is no key.", where=str(path), remedy="Make one with `starbench keys`.")
    with storage_errors(path):
        _refuse_readable_by_others(path)
        secret = path.read_bytes()
    private = _opened(secret, path, ask_passphrase)
    if not isinstance(private, Ed25519PrivateKey):
        raise EvidenceError(
            "This is not an Ed25519 key.", where=str(path), remedy="Make one: ssh-keygen -t ed25519."
        )
    return BenchKey(private, _principal_of(path.with_suffix(".pub")))


def trust(folder: Path, line: str) -> Signer:
    """Add a line to ``allowed_signers``, unless it stands there.

    Raises
    ------
    EvidenceError
        When it is not such a line.
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
    """Read a list of trusted keys; keys other than Ed25519 are passed over.

    Raises
    ------
    EvidenceError
        When the file is missing, unreadable, or a line is not understood (it is named).
    """
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not text"
        raise EvidenceError(
            f"The list of trusted keys cannot be read: {reason}.",
            where=str(path),
            remedy="Get the laboratory's allowed_signers and name it.",
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
        "This line does not name a trusted Ed25519 key.",
        remedy='A line reads: name@place namespaces="' + NAMESPACE + '" ssh-ed25519 AAAA...',
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
        valid_after = _moment(options["valid-after"]) if "valid-after" in options else None
        valid_before = _moment(options["valid-before"]) if "valid-before" in options else None
    except (ValueError, binascii.Error) as error:
        raise bad from error
    namespaces = tuple(filter(None, options.get("namespaces", "").split(",")))
    return Signer(principal, public_key, namespaces, valid_after, valid_before)


def _moment(text: str) -> datetime:
    """Read OpenSSH's ``YYYYMMDD[HHMM[SS]][Z]``; local time without the Z."""
    digits = text.removesuffix("Z")
    form = {8: "%Y%m%d", 12: "%Y%m%d%H%M", 14: "%Y%m%d%H%M%S"}.get(len(digits), "")
    moment = datetime.strptime(digits, form)  # noqa: DTZ007 - the zone follows from the Z
    return moment.replace(tzinfo=UTC) if text.endswith("Z") else moment.astimezone(UTC)


def _refuse_readable_by_others(path: Path) -> None:
    status = path.stat()
    if hasattr(os, "getuid") and (status.st_mode & 0o077 or status.st_uid != os.getuid()):
        raise EvidenceError(
            f"The key can be read by others (mode {status.st_mode & 0o777:04o}): it proves nothing.",
            where=str(path),
            remedy=f"If nobody has read it: chmod 600 {path}. Else make a new one.",
        )


def _opened(secret: bytes, path: Path, ask_passphrase: Callable[[Path], bytes] | None) -> object:
    try:
        with suppress(TypeError):  # cryptography's way of asking for a passphrase
            return serialization.load_ssh_private_key(secret, password=None)
        if ask_passphrase is None:
            raise EvidenceError(
                "The key is protected by a passphrase and there is nobody to ask.",
                where=str(path),
                remedy="Run in a terminal, or take the passphrase off with ssh-keygen -p.",
            )
        return serialization.load_ssh_private_key(secret, password=ask_passphrase(path))
    except ValueError as error:
        raise EvidenceError(
            "The key cannot be opened: wrong passphrase, or not an OpenSSH key.",
            where=str(path),
            remedy="Try again, or restore the file from a copy.",
        ) from error


def _principal_of(public_path: Path) -> str:
    with storage_errors(public_path):
        fields = public_path.read_text(encoding="utf-8").split()
    principal = fields[2] if len(fields) > 2 else ""
    if not _PRINCIPAL.fullmatch(principal):
        raise EvidenceError(
            "The public key does not say who signs.",
            where=str(public_path),
            remedy="Write name@place as its last word.",
        )
    return principal
