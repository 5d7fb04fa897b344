"""The seal of a folder: the list of its files with their hashes, and the bench's signature of that list.

``SHA256SUMS`` lists every file of the folder, sorted by name, in the format of ``sha256sum``. It does not list itself,
``SHA256SUMS.sig`` and the three reserved files. ``SHA256SUMS.sig`` is the SSH signature of that list
(`bench.evidence.sshsig`), namespace ``starbench-report@v1``. It is written last, so that a folder is sealed as a whole
or not at all. ``VERIFY.txt`` explains how to check both without Starbench; the list includes it. After sealing, nothing
in the folder is writable. The seal states which bench made these files; it does not state that a person has approved
them. Reserved files, added later, do that (`bench.evidence.authorisation`) and state when (`bench.evidence.timestamp`).
"""

from __future__ import annotations

import os
import re
import stat
from pathlib import Path

from bench.base.errors import EvidenceError
from bench.evidence.instructions import instructions, kind_of
from bench.evidence.keys import NAMESPACE, BenchKey
from bench.evidence.sshsig import sign
from bench.records.captures import CAPTURES
from bench.records.run_folder import JOURNAL, MANIFEST, SIGNATURE, RunFolder, is_sealed
from bench.records.storage import TEMPORARY, sha256_of, storage_errors, sync_file, write_atomic

INSTRUCTIONS = "VERIFY.txt"
AUTHORISATION = "SHA256SUMS.authorised.sig"
"""A person's signature of ``SHA256SUMS.sig``, added at any time after sealing (`bench.evidence.authorisation`)."""
TIMESTAMP = "SHA256SUMS.tsr"
"""A time stamp of ``SHA256SUMS.sig`` (RFC 3161), added at any time after sealing (`bench.evidence.timestamp`)."""
AUTHORISATION_TIMESTAMP = "SHA256SUMS.authorised.tsr"
"""A time stamp of ``SHA256SUMS.authorised.sig``."""
RESERVED = (AUTHORISATION, TIMESTAMP, AUTHORISATION_TIMESTAMP)
"""Files that may be added beside a seal. The seal does not list them; each carries its own proof."""
NOT_LISTED = frozenset({MANIFEST, SIGNATURE, *RESERVED})
"""Files of a sealed folder that the list does not name."""

_LINE = re.compile(r"([0-9a-f]{64})  ([^\\\x00-\x1f\x7f]+)")


def seal(folder: RunFolder, key: BenchKey) -> str:
    """Seal a run folder. Nothing is written to it afterwards, except the reserved files.

    folder: The folder, locked by the caller; its journal is closed and its report is written.
    key: The bench's key.
    Raises EvidenceError: When the folder has no journal, or has something that cannot be listed: a link, a
      device, a name with control characters.
    Raises StorageError: When a file cannot be written; the folder is then not sealed.
    """
    if not folder.journal_path.is_file():
        raise EvidenceError(f"There is no {JOURNAL} to seal.", where=str(folder.path))
    folder.release_reserve()
    return seal_folder(folder.path, key)


def seal_folder(path: Path, key: BenchKey) -> str:
    """Seal any folder: a run, a certificate, recalculated results, a passport.

    path: The folder; all its files are written, and no other process writes to it.
    key: The bench's key.
    Raises EvidenceError: When the folder is sealed already, has a reserved file before its seal, or has something
      that cannot be listed: a link, a device, a name with control characters.
    Raises StorageError: When a file cannot be written; the folder is then not sealed.
    """
    _refuse_sealed(path)
    with storage_errors(path):
        for name in (INSTRUCTIONS, MANIFEST, SIGNATURE):  # of a process that died while it sealed
            (path / f".{name}{TEMPORARY}").unlink(missing_ok=True)
    text = instructions(kind_of(path), principal=key.principal, fingerprint=key.fingerprint)
    write_atomic(path / INSTRUCTIONS, text.encode())
    _sync_files(path)
    manifest = make_manifest(path)
    write_atomic(path / MANIFEST, manifest)
    write_atomic(path / SIGNATURE, sign(key.private, manifest, NAMESPACE))
    make_read_only(path)
    return key.fingerprint


def _refuse_sealed(path: Path) -> None:
    if is_sealed(path):
        raise EvidenceError(
            "This folder is sealed already; a sealed folder is never changed.",
            where=str(path),
            remedy="Check it with `starbench verify`.",
        )
    early = next((name for name in RESERVED if (path / name).exists()), None)
    if early is not None:
        raise EvidenceError(
            f"{early} is there before the seal: what it signs or stamps does not exist yet.",
            where=str(path),
            remedy="Remove the file, seal, and then add a new one.",
        )


def _sync_files(path: Path) -> None:
    """Sync the files that were not synced when they were written, so that none is lost while its seal remains."""
    with storage_errors(path):
        for name, kind in list_files(path).items():
            is_capture = name.startswith(f"{CAPTURES}/")  # synced before the journal named it
            if kind == "file" and not is_capture:
                sync_file(path / name)


def make_manifest(path: Path) -> bytes:
    """Hash every file of a folder, and list them in the format of ``sha256sum``, sorted by name.

    Returns: The text of ``SHA256SUMS``.
    Raises EvidenceError: When the folder has something that cannot be listed: a link, a device, a name with
      control characters.
    Raises StorageError: When a file cannot be read.
    """
    lines = []
    with storage_errors(path):
        for name, kind in sorted(list_files(path).items()):
            line = f"{'0' * 64}  {name}"
            if kind != "file" or not _LINE.fullmatch(line) or name.encode(errors="replace") != name.encode():
                raise EvidenceError(
                    f"{name!r} is a {kind} that cannot be sealed.", where=str(path), remedy="Remove it."
                )
            if name not in NOT_LISTED:
                lines.append(f"{sha256_of(path / name)}  {name}\n")
    return "".join(lines).encode()


def read_manifest(manifest: bytes) -> dict[str, str]:
    """Read the list of a seal.

    manifest: The text of ``SHA256SUMS``.
    Returns: SHA-256 in hexadecimal by file name, in the order of the list.
    Raises EvidenceError: When a line is not ``hash, two spaces, name``, when names are not sorted or not
      unique, or when a name leads out of the folder.
    """
    hashes: dict[str, str] = {}
    last = ""
    *lines, rest = manifest.decode(errors="replace").split("\n")
    for number, line in enumerate([*lines, rest] if rest else lines, start=1):
        match = _LINE.fullmatch(line)
        parts = match[2].split("/") if match else [""]
        if match is None or {"", ".", ".."} & set(parts) or match[2] <= last or match[2] in NOT_LISTED:
            raise EvidenceError(
                "This line does not list a file of the folder in the order of names.",
                where=f"{MANIFEST}:{number}",
                remedy="Ask the laboratory for the run folder again.",
            )
        last = match[2]
        hashes[match[2]] = match[1]
    return hashes


def list_files(path: Path) -> dict[str, str]:
    """List everything in a folder and its subfolders, except the folders. Links are not followed.

    Returns: ``file``, ``link`` or ``special file`` by name; names are relative to the folder, with ``/``.
    Raises OSError: When a subfolder cannot be read.
    """
    found = {}
    for folder_name, folders, files in os.walk(path, onerror=_refuse):
        folder = Path(folder_name)
        for name in [*files, *(f for f in folders if (folder / f).is_symlink())]:
            mode = (folder / name).lstat().st_mode
            kind = "file" if stat.S_ISREG(mode) else "link" if stat.S_ISLNK(mode) else "special file"
            found[(folder / name).relative_to(path).as_posix()] = kind
    return found


def _refuse(error: OSError) -> None:
    raise error  # without this, os.walk ignores a folder that it cannot read


def make_read_only(path: Path) -> None:
    """Make a folder, its subfolders and their files read-only.

    Raises StorageError: When a mode cannot be changed.
    """
    with storage_errors(path):
        for folder_name, _, files in os.walk(path, topdown=False):
            folder = Path(folder_name)
            for name in files:
                (folder / name).chmod(0o444)
            folder.chmod(0o555)
