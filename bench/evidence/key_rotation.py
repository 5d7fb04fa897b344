"""Replace the bench's key. Reports sealed with the old key stay valid for their time."""

from __future__ import annotations

import os
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from pathlib import Path

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from bench.base.errors import EvidenceError
from bench.evidence.keys import NEW_KEY, BenchKey, finish_rotation, private_text
from bench.evidence.public_half import KEY_FILE, read_public
from bench.evidence.signers import read_signer, replace_lines
from bench.evidence.ssh_keys import fingerprint
from bench.record.folder_lock import locked_folder
from bench.record.storage import make_folder, storage_errors, write_atomic
from drivers.durable import sync_folder

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
