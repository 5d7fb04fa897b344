"""The seal of a run folder: the list of its files with their hashes, and the bench's signature of that list.

``SHA256SUMS`` lists every file of the folder except itself and ``SHA256SUMS.sig``, sorted by name, in the format of
``sha256sum``. ``SHA256SUMS.sig`` is the SSH signature of that list (`bench.evidence.sshsig`), namespace
``starbench-report@v1``. It is written last, so that a folder is sealed as a whole or not at all. ``VERIFY.txt``
explains how to check both without Starbench; the list includes it. After sealing, nothing in the folder is writable.
The seal states which bench made these files; it does not state that a person has approved them.
"""

from __future__ import annotations

import os
import re
import stat
from pathlib import Path

from bench.base.errors import EvidenceError
from bench.evidence.keys import NAMESPACE, BenchKey
from bench.evidence.sshsig import sign
from bench.records.captures import CAPTURES
from bench.records.run_folder import JOURNAL, MANIFEST, SIGNATURE, RunFolder
from bench.records.storage import sha256_of, storage_errors, sync_file

INSTRUCTIONS = "VERIFY.txt"
NOT_LISTED = frozenset({MANIFEST, SIGNATURE})
"""Files of a sealed folder that the list does not name."""

_LINE = re.compile(r"([0-9a-f]{64})  ([^\\\x00-\x1f\x7f]+)")

_INSTRUCTIONS = """\
This folder is the record of one run of Starbench, sealed by the bench that made it.
To check it you need OpenSSH (8.1 or newer) and sha256sum, nothing else. In this folder:

    ssh-keygen -Y verify -f allowed_signers -I {principal} -n {namespace} -s SHA256SUMS.sig < SHA256SUMS
    sha256sum --strict --quiet -c SHA256SUMS

Both must end with status 0. They do not find added files or links. A third check finds them; it must
print "complete":

    test -z "$(find . -type l)" && \\
        test "$(find . ! -type d | wc -l)" -eq "$(($(wc -l < SHA256SUMS) + 2))" && echo complete

allowed_signers is the list of keys that you trust. It is not part of this folder, because a person who
can change the folder could change the list too. Get the list from the laboratory in another way. The
key that signed here has the fingerprint

    {fingerprint}

With Starbench at hand, `starbench verify` makes these checks and more. The folder is read-only; to
delete it: chmod -R u+w, then rm -r.
"""


def seal(folder: RunFolder, key: BenchKey) -> str:
    """Seal a run folder. Nothing is written to it afterwards.

    Parameters
    ----------
    folder
        The folder, locked by the caller; its journal is closed and its report is written.
    key
        The bench's key.

    Returns
    -------
    str
        Fingerprint of the key.

    Raises
    ------
    EvidenceError
        When the folder has no journal, or has something that cannot be listed: a link, a device, a name with control
        characters.
    StorageError
        When a file cannot be written; the folder is then not sealed.
    """
    if not folder.journal_path.is_file():
        raise EvidenceError(f"There is no {JOURNAL} to seal.", where=str(folder.path))
    folder.release_reserve()
    text = _INSTRUCTIONS.format(principal=key.principal, namespace=NAMESPACE, fingerprint=key.fingerprint)
    folder.write_atomic(INSTRUCTIONS, text.encode())
    _sync_files(folder.path)
    manifest = make_manifest(folder.path)
    folder.write_atomic(MANIFEST, manifest)
    folder.write_atomic(SIGNATURE, sign(key.private, manifest, NAMESPACE))
    _make_read_only(folder.path)
    return key.fingerprint


def _sync_files(path: Path) -> None:
    """Sync the files that were not synced when they were written, so that none is lost while its seal remains."""
    with storage_errors(path):
        for name, kind in list_files(path).items():
            is_capture = name.startswith(f"{CAPTURES}/")  # synced before the journal named it
            if kind == "file" and not is_capture:
                sync_file(path / name)


def make_manifest(path: Path) -> bytes:
    """Hash every file of a folder, and list them in the format of ``sha256sum``, sorted by name.

    Parameters
    ----------
    path
        The folder.

    Returns
    -------
    bytes
        The text of ``SHA256SUMS``.

    Raises
    ------
    EvidenceError
        When the folder has something that cannot be listed: a link, a device, a name with control characters.
    StorageError
        When a file cannot be read.
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

    Parameters
    ----------
    manifest
        The text of ``SHA256SUMS``.

    Returns
    -------
    dict
        SHA-256 in hexadecimal by file name, in the order of the list.

    Raises
    ------
    EvidenceError
        When a line is not ``hash, two spaces, name``, when names are not sorted or not unique, or when a name leads out
        of the folder.
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

    Parameters
    ----------
    path
        The folder.

    Returns
    -------
    dict
        ``file``, ``link`` or ``special file`` by name; names are relative to the folder, with ``/``.

    Raises
    ------
    OSError
        When a subfolder cannot be read.
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


def _make_read_only(path: Path) -> None:
    with storage_errors(path):
        for folder_name, _, files in os.walk(path, topdown=False):
            folder = Path(folder_name)
            for name in files:
                (folder / name).chmod(0o444)
            folder.chmod(0o555)
