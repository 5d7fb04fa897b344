"""Authorisations in the bench's ledger: a line for each, so that one that was removed afterwards is noticed.

The signature of a person lies beside the seal, and no list names it: whoever deletes the file turns AUTHORISED into
SEALED. The ledger of the bench on which the person signed knows the seal and the signature by their SHA-256. A bench
without a ledger enters nothing; the ledger of another bench knows nothing of the folder.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from bench.base.errors import BenchError
from bench.evidence.seal import AUTHORISATION
from bench.records.journal import read_journal
from bench.records.journal_entry import Entry
from bench.records.ledger_file import LEDGER, LedgerFile
from bench.records.run_folder import MANIFEST
from bench.records.storage import sha256_of, storage_errors

FOLDER_AUTHORISED = "folder_authorised"
_SHOWN = 16


@dataclass(frozen=True)
class Authorised:
    """An authorisation that the ledger names."""

    signature: str  # SHA-256 of the file with the person's signature
    person: str
    fingerprint: str
    folder: str  # The folder, where it lay then
    utc: str  # When the line was written, ISO 8601

    def __str__(self) -> str:
        return f"{self.person} ({self.fingerprint}) on {self.utc[:_SHOWN].replace('T', ' ')} UTC"


Known = Mapping[str, Sequence[Authorised]]
"""Authorisations by the SHA-256 of the seal's list of files, in the order of the ledger."""
NOTHING_KNOWN: Known = {}


def enter_authorisation(ledger: LedgerFile, folder: Path, person: str, fingerprint: str) -> bool:
    """Enter the authorisation of a folder that was just made.

    Returns: Whether it was entered; False if this bench has no ledger.
    Raises EvidenceError, JournalBroken, StorageError: When the ledger or the folder cannot be used.
    """
    if not ledger.path.exists():
        return False
    with storage_errors(folder):
        hashes = {"seal": sha256_of(folder / MANIFEST), "signature": sha256_of(folder / AUTHORISATION)}
    facts = {"folder": str(folder.resolve()), "person": person, "fingerprint": fingerprint}
    ledger.append(FOLDER_AUTHORISED, **hashes, **facts)
    return True


def known_authorisations(home: Path) -> Known:
    """Return the authorisations that the ledger of this bench names.

    Returns: Empty if there is no ledger, or if it cannot be read, which `bench.records.ledger` tells.
    """
    path = home / LEDGER
    try:
        status = path.stat()
    except OSError:
        return NOTHING_KNOWN
    return _read(path, status.st_mtime_ns, status.st_size)


@lru_cache(maxsize=4)
def _read(path: Path, _changed_ns: int, _size: int) -> Known:
    """Read the ledger once for each of its states: a page that is shown asks every second."""
    with suppress(BenchError):
        return _authorisations(read_journal(path)[0])
    return NOTHING_KNOWN


def _authorisations(entries: Sequence[Entry]) -> Known:
    found: dict[str, list[Authorised]] = {}
    for entry in entries:
        if entry.event == FOLDER_AUTHORISED:
            signature, person, fingerprint, folder = (
                str(entry.data.get(name, "")) for name in ("signature", "person", "fingerprint", "folder")
            )
            one = Authorised(signature, person, fingerprint, folder, entry.utc)
            found.setdefault(str(entry.data.get("seal", "")), []).append(one)
    return found


@dataclass(frozen=True)
class Compared:
    """How the authorisation of a folder differs from what the ledger names; sentences without a full stop."""

    fault: str = ""  # It was removed or replaced; empty if not
    note: str = ""  # A copy of the folder does not have it, perhaps because the copy is older; empty if not


_AGREES = Compared()


def compare_authorisation(folder: Path, known: Known) -> Compared:
    """Compare the authorisation of a folder with the one that the ledger names.

    Returns: Empty if they agree, or if the ledger names none for this seal.
    Raises StorageError: When a file cannot be read.
    """
    manifest, signature = folder / MANIFEST, folder / AUTHORISATION
    with storage_errors(folder):
        if not known or not manifest.is_file():
            return _AGREES
        named = known.get(sha256_of(manifest), ())
        if not named or (signature.is_file() and sha256_of(signature) in {one.signature for one in named}):
            return _AGREES
        is_there, here = signature.exists(), folder.resolve()
    last = named[-1]
    if is_there:
        return Compared(f"the ledger names another authorisation than {AUTHORISATION}: by {last}")
    if here not in {Path(one.folder).resolve() for one in named} and Path(last.folder).is_dir():
        return Compared(
            note=f"the ledger names an authorisation that this copy does not have: by {last}, in {last.folder}"
        )
    return Compared(
        f"the ledger names an authorisation that is missing: by {last}. Copy {AUTHORISATION} back, or let the person"
        " authorise again"
    )


def lost_authorisations(known: Known) -> list[str]:
    """Compare all folders that the ledger names as authorised, as far as they are still there."""
    found = []
    for folder in sorted({one.folder for named in known.values() for one in named if one.folder}):
        with suppress(BenchError):
            if why := compare_authorisation(Path(folder), known).fault:
                found.append(f"{folder}: {why}.")
    return found
