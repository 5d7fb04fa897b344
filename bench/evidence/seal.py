"""The seal of a run folder: the list of its files with their hashes, and the bench's signature under it.

``SHA256SUMS`` lists every file of the folder but itself and ``SHA256SUMS.sig``, sorted by name, as
``sha256sum`` writes it. ``SHA256SUMS.sig`` is the SSH signature of that list, namespace
``starbench-report@v1``; it is written last, so a folder is sealed as a whole or not at all.
``VERIFY.txt`` tells a stranger how to check both, and is in the list itself. After sealing, nothing in
the folder is writable. The seal says which bench made these files, not that a person approved of them.
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

Both must end with status 0. They do not see files that were added, or links; that is a third check,
which must print "complete":

    test -z "$(find . -type l)" && \\
        test "$(find . ! -type d | wc -l)" -eq "$(($(wc -l < SHA256SUMS) + 2))" && echo complete

allowed_signers is the list of keys that you trust. It is not part of this folder, for whoever could
change the folder could change it too: get it from the laboratory by another way. The key that signed
here has the fingerprint

    {fingerprint}

With Starbench at hand, `starbench verify` makes these checks and more. The folder is read-only; to
delete it: chmod -R u+w, then rm -r.
"""


def seal(folder: RunFolder, key: BenchKey) -> str:
    """Seal a run folder; afterwards it is never written to again.

    Parameters
    ----------
    folder
        Held by the caller; its journal is closed, its report written.
    key
        The bench's key.

    Returns
    -------
    str
        Fingerprint of the key.

    Raises
    ------
    EvidenceError
        When the folder holds no journal, or what cannot be listed: a link, a device, a strange name.
    StorageError
        When the disk did not take it; the folder is then not sealed.
    """
    if not folder.journal_path.is_file():
        raise EvidenceError(f"There is no {JOURNAL} to seal.", where=str(folder.path))
    folder.release_reserve()
    text = _INSTRUCTIONS.format(principal=key.principal, namespace=NAMESPACE, fingerprint=key.fingerprint)
    folder.write_atomic(INSTRUCTIONS, text.encode())
    _sync_what_others_wrote(folder.path)
    manifest = make_manifest(folder.path)
    folder.write_atomic(MANIFEST, manifest)
    folder.write_atomic(SIGNATURE, sign(key.private, manifest, NAMESPACE))
    _make_read_only(folder.path)
    return key.fingerprint


def _sync_what_others_wrote(path: Path) -> None:
    """Make last what was not synced when it was written, as the log of the lines: a seal must not outlive its files."""
    with storage_errors(path):
        for name, kind in list_files(path).items():
            if kind == "file" and not name.startswith(
                f"{CAPTURES}/"
            ):  # those were synced before the journal told of them
                sync_file(path / name)


def make_manifest(path: Path) -> bytes:
    """Hash every file of a folder, and list them as ``sha256sum`` does, sorted by name.

    Raises
    ------
    EvidenceError
        When the folder holds something that cannot be listed: a link, a device, a strange name.
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
    """Read a list of hashes: file name to SHA-256.

    Raises
    ------
    EvidenceError
        When a line is not ``hash, two spaces, name``, names are not sorted and different, or lead elsewhere.
    """
    hashes: dict[str, str] = {}
    last = ""
    *lines, rest = manifest.decode(errors="replace").split("\n")
    for number, line in enumerate([*lines, rest] if rest else lines, start=1):
        match = _LINE.fullmatch(line)
        parts = match[2].split("/") if match else [""]
        if match is None or {"", ".", ".."} & set(parts) or match[2] <= last or match[2] in NOT_LISTED:
            raise EvidenceError(
                "This line does not list a file of the folder, in order.",
                where=f"{MANIFEST}:{number}",
                remedy="Ask the laboratory for the bundle again.",
            )
        last = match[2]
        hashes[match[2]] = match[1]
    return hashes


def list_files(path: Path) -> dict[str, str]:
    """Everything below a folder but folders: name, with ``/``, to ``file``, ``link`` or ``special file``.

    Links are not followed.
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
    raise error  # os.walk would pass over a folder that it cannot read


def _make_read_only(path: Path) -> None:
    with storage_errors(path):
        for folder_name, _, files in os.walk(path, topdown=False):
            folder = Path(folder_name)
            for name in files:
                (folder / name).chmod(0o444)
            folder.chmod(0o555)
