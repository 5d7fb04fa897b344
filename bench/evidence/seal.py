"""The seal of a folder: the list of its files with their hashes, and the bench's signature of that list.

``SHA256SUMS`` lists every file but itself, ``SHA256SUMS.sig`` and the three reserved files, as ``sha256sum`` does. Its
SSH signature, namespace ``starbench-report@v1``, is written last, so that a folder is sealed as a whole or not at all;
then nothing is writable. ``VERIFY.txt`` explains how to check both without Starbench. Reserved files, added later,
state who approved (`bench.evidence.authorisation`) and when (`bench.evidence.timestamp`).
"""

from __future__ import annotations

import errno
import json
import os
import re
import shutil
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from bench.base.bounded_json import parse_json
from bench.base.errors import EvidenceError
from bench.evidence.keys import BenchKey
from bench.evidence.signers import NAMESPACE
from bench.evidence.sshsig import fingerprint, is_valid, read_signature
from bench.record.journal import CAPTURES
from bench.record.run_folder import JOURNAL, MANIFEST, SIGNATURE, RunFolder, is_sealed
from bench.record.storage import (
    TEMPORARY,
    sha256_of,
    storage_errors,
    sync_file,
    sync_folder,
    write_all,
    write_atomic,
)

# The seal of a collimator's passport: the bench's signature inside the file, on a line of its own.
#
# A passport is one file that people copy, so its seal travels in it. The second line of a sealed passport
# holds the SSH signature (`bench.evidence.sshsig`) of the file without that line, which is the unsealed
# passport. So it can be checked without Starbench::
#
#     sed -n 's/^ "seal": "\(.*\)",$/\1/p' collimator.json | sed 's/\\n/\n/g' > seal.sig
#     grep -v '^ "seal": ' collimator.json |
#         ssh-keygen -Y verify -f allowed_signers -I bench@lab -n starbench-report@v1 -s seal.sig
#
# This module handles bytes only. It does not decide which keys are trusted.

_FIRST = b"{\n"
_BEGIN = b' "seal": '
_MAKE_AGAIN = "Get the file again from who made it; or make a new passport."


@dataclass(frozen=True)
class PassportSeal:
    """The valid seal of a passport."""

    public_key: bytes  # The signer's key, as SSH encodes it
    fingerprint: str


def seal_passport(data: bytes, key: BenchKey) -> bytes:
    """Add a seal to a passport. Removing the second line of the result gives ``data``."""
    if not data.startswith(_FIRST + b" ") or _has_seal_line(data):
        raise EvidenceError("This is not an unsealed passport in the layout that Starbench writes.")
    signature = key.sign(data, NAMESPACE).decode()
    return _FIRST + _BEGIN + json.dumps(signature).encode() + b",\n" + data[len(_FIRST) :]


def read_passport_seal(data: bytes) -> PassportSeal | None:
    """Check the seal of a passport; None if the file has none."""
    if not _has_seal_line(data):
        return None
    line, _, rest = data[len(_FIRST) :].partition(b"\n")
    try:
        armoured = parse_json(line[len(_BEGIN) :].removesuffix(b","))
        signature = read_signature(armoured.encode())
    except (ValueError, AttributeError, EvidenceError) as error:
        raise EvidenceError("The seal of this passport is not a signature.", remedy=_MAKE_AGAIN) from error
    if signature.namespace != NAMESPACE or not is_valid(signature, _FIRST + rest):
        raise EvidenceError(
            "This passport was changed after it was sealed: its seal does not match.", remedy=_MAKE_AGAIN
        )
    return PassportSeal(signature.public_key, fingerprint(signature.public_key))


def _has_seal_line(data: bytes) -> bool:
    return data.startswith(_FIRST + _BEGIN)


KINDS = {JOURNAL: "run", "certificate.json": "certificate", "sources.json": "results"}
"""Kind of a sealed folder by the file that only this kind has."""

_WHAT = {
    "run": "the record of one run of Starbench",
    "certificate": "a calibration certificate made by Starbench",
    "results": "a calibration that Starbench calculated from existing files (a recalculation)",
    "files": "a set of files made by Starbench",
}

_MORE = {
    "run": "",
    "certificate": """
certificate.json names the person who is to authorise it (authorised_by), with the fingerprint of the
person's key. ssh-keygen must print the same fingerprint.
""",
    "results": """
sources.json names the files that these results were calculated from, with their SHA-256. To check one:
sha256sum FILE.
""",
    "files": "",
}

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
3. THE TIME: that it is not younger than a time stamp says

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


def kind_of(path: Path) -> str:
    """Return what a folder is, by its content: ``run``, ``certificate``, ``results`` (recalculated) or ``files``."""
    return next((kind for name, kind in KINDS.items() if (path / name).is_file()), "files")


def instructions(kind: str, *, principal: str, fingerprint: str) -> str:
    """Return the text of ``VERIFY.txt`` for a folder of this kind, sealed by this bench."""
    return _TEXT.format(what=_WHAT[kind], more=_MORE[kind], principal=principal, fingerprint=fingerprint)


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
    """Seal a run folder that the caller has locked, with journal and report complete; else it is refused."""
    if not folder.journal_path.is_file():
        raise EvidenceError(f"There is no {JOURNAL} to seal.", where=str(folder.path))
    folder.release_reserve()
    return seal_folder(folder.path, key)


def seal_folder(path: Path, key: BenchKey) -> str:
    """Seal any folder that is complete; refused if sealed, with a reserved file, or with what cannot be listed."""
    _refuse_sealed(path)
    with storage_errors(path):
        for name in (INSTRUCTIONS, MANIFEST, SIGNATURE):  # of a process that died while it sealed
            (path / f".{name}{TEMPORARY}").unlink(missing_ok=True)
    text = instructions(kind_of(path), principal=key.principal, fingerprint=key.fingerprint)
    write_atomic(path / INSTRUCTIONS, text.encode())
    _sync_files(path)
    manifest = make_manifest(path)
    write_atomic(path / MANIFEST, manifest)
    write_atomic(path / SIGNATURE, key.sign(manifest, NAMESPACE))
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
    """List every file's hash, sorted, as ``sha256sum``; a link, device or control character: `EvidenceError`."""
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
    """Make a folder, its subfolders and their files read-only. Raises StorageError when a mode cannot be changed."""
    with storage_errors(path):
        for folder_name, _, files in os.walk(path, topdown=False):
            folder = Path(folder_name)
            for name in files:
                (folder / name).chmod(0o444)
            folder.chmod(0o555)


def remove_unnamed(part: Path) -> None:
    """Remove a folder that never got its final name, if it is there; its seal may have made it read-only."""
    if part.is_symlink() or not part.is_dir():
        return
    with storage_errors(part):
        for folder_name, _, _ in os.walk(part):
            Path(folder_name).chmod(0o755)
        shutil.rmtree(part)


# Read and add the reserved files beside a seal. The sealed folder stays read-only.
#
# A file appears whole or not at all: it is written without a name and synced, then linked under its name.
# Linking never replaces a file. Where the file system has no files without a name, a temporary file is
# used; the next attempt removes one that a died process left behind.

MOST_BYTES = 1 << 20
"""Signatures and time stamps have some kilobytes; a larger file is not read."""
_NO_TMPFILE = {errno.EOPNOTSUPP, errno.EISDIR, errno.EINVAL, errno.ENOENT}
_NO_LINKS = {errno.EPERM, errno.EOPNOTSUPP, errno.ENOSYS, errno.EMLINK}
"""Errors of file systems without hard links, such as FAT."""
_MODE, _FOLDER_MODE = 0o444, 0o555


def read_beside(folder: Path, name: str) -> bytes | None:
    """Read a reserved file, or the signature of the seal: no link, and no larger than 1 MiB."""
    path = folder / name
    try:
        status = path.lstat()
    except FileNotFoundError:
        return None
    if not stat.S_ISREG(status.st_mode):
        raise EvidenceError("this is a link or a folder, not a file", where=name)
    if status.st_size > MOST_BYTES:
        raise EvidenceError(f"the file is too large: more than {MOST_BYTES} bytes", where=name)
    return path.read_bytes()


def add_beside(folder: Path, name: str, data: bytes) -> None:
    """Add a reserved file, which is never replaced, beside the seal. File and folder are read-only afterwards."""
    if name not in RESERVED:
        raise EvidenceError(f"{name!r} cannot be added to a sealed folder.", where=str(folder))
    path = folder / name
    with storage_errors(path):
        with _writable(folder):
            (folder / f".{name}{TEMPORARY}").unlink(missing_ok=True)
            try:
                write_and_link(path, data)
            except FileExistsError as error:
                raise EvidenceError(
                    f"There is a file {name} already; it is never replaced.",
                    where=str(folder),
                    remedy="Check it with `starbench verify`.",
                ) from error
        sync_folder(folder)


@contextmanager
def _writable(folder: Path) -> Iterator[None]:
    """Make the folder writable for the block."""
    folder.chmod(_FOLDER_MODE | stat.S_IWUSR)
    try:
        yield
    finally:
        folder.chmod(_FOLDER_MODE)


def write_and_link(path: Path, data: bytes) -> None:
    """Write a file without a name, and give it its name. Raises FileExistsError and other OSErrors."""
    try:
        descriptor = os.open(path.parent, os.O_TMPFILE | os.O_WRONLY, _MODE)
    except (AttributeError, OSError) as error:
        if isinstance(error, OSError) and error.errno not in _NO_TMPFILE:
            raise
        write_and_rename(path, data)
        return
    folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY)
    try:
        _fill(descriptor, data)
        # Its name in /proc is linked (open(2), O_TMPFILE). Python follows that link only if a folder's descriptor
        # is given.
        os.link(f"/proc/self/fd/{descriptor}", path.name, dst_dir_fd=folder, follow_symlinks=True)
    finally:
        os.close(descriptor)
        os.close(folder)


def write_and_rename(path: Path, data: bytes) -> None:
    """Write a file under another name, sync it, and give it its name."""
    part = path.with_name(f".{path.name}{TEMPORARY}")
    descriptor = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, _MODE)
    try:
        try:
            _fill(descriptor, data)
        finally:
            os.close(descriptor)
        try:
            os.link(part, path)
        except OSError as error:
            if error.errno not in _NO_LINKS or path.exists():
                raise
            part.rename(path)
    finally:
        with suppress(FileNotFoundError):
            part.unlink()


def _fill(descriptor: int, data: bytes) -> None:
    write_all(descriptor, data)
    if hasattr(os, "fchmod"):
        os.fchmod(descriptor, _MODE)  # whatever the umask
    os.fsync(descriptor)
