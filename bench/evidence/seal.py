"""The seal of a folder: the list of its files with their hashes, and the bench's signature of that list.

``SHA256SUMS`` lists every file but itself, ``SHA256SUMS.sig`` and the three reserved files, as ``sha256sum`` does. Its
SSH signature, namespace ``starbench-report@v1``, is written last, so that a folder is sealed as a whole or not at all;
then nothing is writable. ``VERIFY.txt`` explains how to check both without Starbench. Reserved files, added later,
state who approved (`bench.evidence.authorisation`) and when (`bench.evidence.timestamp`).
"""

from __future__ import annotations

import os
import re
import stat
from contextlib import suppress
from pathlib import Path

from bench.base.errors import BenchError, EvidenceError
from bench.base.pasteable import pasteable
from bench.evidence.content_check import check_content
from bench.evidence.findings import Verification
from bench.evidence.folder_kinds import FolderKind, folder_kind
from bench.evidence.keys import BenchKey
from bench.evidence.signers import NAMESPACE
from bench.record.history import begun_with
from bench.record.journal import CAPTURES
from bench.record.run_folder import JOURNAL, MANIFEST, SIGNATURE, RunFolder, is_sealed
from bench.record.storage import sha256_of, storage_errors, write_atomic
from bench.record.stored_run import StoredRun
from drivers.durable import sync_file
from drivers.new_output import TEMPORARY

# `verify` compares the file of every version with this text: one that is changed must stay beside the new one.
_TEXT = """\
This folder is {what}, sealed by the bench that made it.
To check it you need OpenSSH (8.9 or newer), sha256sum, and for time stamps openssl, nothing else.
Run the commands in this folder.

1. THE SEAL: which bench made these files, and that none was changed

    ssh-keygen -Y verify -f allowed_signers -I {principal} -n starbench-report@v1 -s SHA256SUMS.sig < SHA256SUMS
    sha256sum --strict --quiet -c SHA256SUMS

Both must end with status 0. They do not find added files or links. A third check finds them; it must
print "complete":

    test -z "$(find . -type l)" && \\
        test "$(find . ! -type d ! -path ./SHA256SUMS ! -path ./SHA256SUMS.sig \\
            ! -path ./SHA256SUMS.authorised.sig ! -path ./SHA256SUMS.tsr \\
            ! -path ./SHA256SUMS.authorised.tsr | wc -l)" -eq "$(wc -l < SHA256SUMS)" && echo complete

allowed_signers is the list of keys that you trust. It is not part of this folder, because a person who
can change the folder could change the list too. Get the list from the laboratory in another way. The
key that signed here has the fingerprint

    {fingerprint}

2. THE AUTHORISATION: which person approved it

Without a file SHA256SUMS.authorised.sig, no person has authorised this folder. Otherwise find the name
of the person, and verify with it in the place of PERSON:

    ssh-keygen -Y find-principals -f allowed_signers -s SHA256SUMS.authorised.sig
    ssh-keygen -Y verify -f allowed_signers -I PERSON -n starbench-authorisation@v1 \\
        -s SHA256SUMS.authorised.sig < SHA256SUMS.sig
{more}
3. THE TIME: that the seal is at least as old as a time stamp says

Without a file SHA256SUMS.tsr or SHA256SUMS.authorised.tsr, only the bench's own clock states a time.
tsa_certificates.pem holds the root certificates of time stamping authorities that you trust:

    openssl ts -verify -in SHA256SUMS.tsr -data SHA256SUMS.sig -CAfile tsa_certificates.pem
    openssl ts -reply -in SHA256SUMS.tsr -text

    openssl ts -verify -in SHA256SUMS.authorised.tsr -data SHA256SUMS.authorised.sig -CAfile tsa_certificates.pem
    openssl ts -reply -in SHA256SUMS.authorised.tsr -text

4. KEYS that have expired or were revoked

ssh-keygen judges a key for today. To judge it for the time of a time stamp, add to its commands:
-O verify-time=YYYYMMDDHHMMSSZ. To refuse revoked keys, add: -r revoked_keys (a list from the laboratory).

With Starbench at hand, `starbench verify` makes these checks and more. The folder is read-only; to
delete it: chmod -R u+w, then rm -r.
"""
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

# A name that is not UTF-8 has surrogates.
_LINE = re.compile(r"([0-9a-f]{64})  ([^\\\x00-\x1f\x7f\ud800-\udfff]+)")
_MOST_SHOWN = 5


def instructions(kind: FolderKind, *, principal: str, fingerprint: str) -> str:
    """Return the text of ``VERIFY.txt`` for a folder of this kind, sealed by this bench."""
    return _TEXT.format(
        what=kind.content, more=kind.instructions, principal=principal, fingerprint=fingerprint
    )


def seal(folder: RunFolder, key: BenchKey) -> str:
    """Seal a run folder that the caller has locked, with journal and report complete; else it is refused."""
    if not folder.journal_path.is_file():
        raise EvidenceError(
            f"The folder of this run was moved, renamed or deleted during the run: {JOURNAL} is not here any more.",
            where=str(folder.path),
            remedy="The moved folder has the journal and all earlier files. This folder has the later files. Move them"
            " to the moved folder. Then seal that one: `starbench resume FOLDER`.",
        )
    folder.release_reserve()
    return seal_folder(folder.path, key)


def seal_folder(path: Path, key: BenchKey) -> str:
    """Seal any folder that is complete; refused if sealed, with a reserved file, or with what `verify` refuses."""
    _refuse_sealed(path)
    with storage_errors(path):
        for name in (INSTRUCTIONS, MANIFEST, SIGNATURE):  # of a process that died while it sealed
            (path / f".{name}{TEMPORARY}").unlink(missing_ok=True)
    text = instructions(folder_kind(path), principal=key.principal, fingerprint=key.fingerprint)
    write_atomic(path / INSTRUCTIONS, text.encode())
    _sync_files(path)
    manifest = make_manifest(path)
    _refuse_faults(path, manifest)
    write_atomic(path / MANIFEST, manifest)
    write_atomic(path / SIGNATURE, key.sign(manifest, NAMESPACE))
    make_read_only(path)
    return key.fingerprint


def _refuse_sealed(path: Path) -> None:
    if is_sealed(path):
        raise EvidenceError(
            "This folder is sealed already; a sealed folder is never changed.",
            where=str(path),
            remedy=f"Check it: {pasteable('verify', path)}",
        )
    early = next((name for name in RESERVED if (path / name).exists()), None)
    if early is not None:
        raise EvidenceError(
            f"{early} is there before the seal: what it signs or stamps does not exist yet.",
            where=str(path),
            remedy="Remove the file, seal, and then add a new one.",
        )


def _refuse_faults(path: Path, manifest: bytes) -> None:
    """Refuse what `verify` would refuse for ever, before it is sealed."""
    found = Verification()
    check_content(path, read_manifest(manifest), found)
    if told := [*map(str, found.faults)]:
        told[_MOST_SHOWN:] = [f"And {len(told) - _MOST_SHOWN} more"] if len(told) > _MOST_SHOWN else []
        what = f"This folder is not sealed, because its seal would not be verified. {'. '.join(told)}."
        raise EvidenceError(what, where=str(path), remedy=_mend(path))


def _mend(path: Path) -> str:
    how = "Move out what does not belong in this folder, put back what is missing or changed. Then"
    if not (path / JOURNAL).is_file():
        return f"{how} repeat the command."
    how += f" seal it: `{pasteable('resume', path)}`."
    with suppress(BenchError):  # a damaged journal does not state how its run was begun
        again = pasteable("run", *begun_with(StoredRun(path).history, path))
        how += f" If a file is lost for ever, this run stays a draft; make a new run: {again}"
    return how


def _sync_files(path: Path) -> None:
    """Sync the files that were not synced when they were written, so that none is lost while its seal remains."""
    with storage_errors(path):
        for name, kind in list_files(path).items():
            is_capture = name.startswith(f"{CAPTURES}/")  # synced before the journal named it
            if kind == "file" and not is_capture:
                sync_file(path / name)


def make_manifest(path: Path) -> bytes:
    """List every file's hash, sorted, as ``sha256sum``; a link, device or unreadable name: `EvidenceError`."""
    lines = []
    with storage_errors(path):
        for name, kind in sorted(list_files(path).items()):
            line = f"{'0' * 64}  {name}"
            if kind != "file" or not _LINE.fullmatch(line):
                what = f"{name!r} is a {kind} that cannot be sealed."
                raise EvidenceError(what, where=str(path), remedy=_mend(path))
            if name not in NOT_LISTED:
                lines.append(f"{sha256_of(path / name)}  {name}\n")
    return "".join(lines).encode()


def read_manifest(manifest: bytes) -> dict[str, str]:
    """Read a seal's list, SHA-256 by file name; `EvidenceError` if not sorted, unique and within the folder."""
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
    """List a folder's content but folders, by name with ``/``: ``file``, ``link`` (not followed), ``special file``."""
    kinds = {}
    for folder_name, folders, files in os.walk(path, onerror=_refuse):
        folder = Path(folder_name)
        for name in [*files, *(f for f in folders if (folder / f).is_symlink())]:
            mode = (folder / name).lstat().st_mode
            kind = "file" if stat.S_ISREG(mode) else "link" if stat.S_ISLNK(mode) else "special file"
            kinds[(folder / name).relative_to(path).as_posix()] = kind
    return kinds


def _refuse(error: OSError) -> None:
    raise error  # without this, os.walk ignores a folder that it cannot read


def make_read_only(path: Path) -> None:
    """Make a folder, its subfolders and their files read-only. Raises StorageError when a mode cannot be changed."""
    with storage_errors(path):
        for folder_name, _, files in os.walk(path, topdown=False):
            folder = Path(folder_name)
            for name in files:
                (folder / name).chmod(0o444)
            folder.chmod(0o555)
