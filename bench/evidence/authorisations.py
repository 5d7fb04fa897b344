"""Authorisations in the bench's ledger: a line for each, so that one that was removed afterwards is noticed.

The signature of a person lies beside the seal, and no list names it: whoever deletes the file turns
AUTHORISED into SEALED. The ledger of the bench on which the person signed knows the seal and the
signature by their SHA-256. A bench without a ledger enters nothing; the ledger of another bench knows
nothing of the folder.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from bench.base.errors import BenchError
from bench.evidence.findings import Findings
from bench.evidence.seal import AUTHORISATION
from bench.record.journal import read_journal
from bench.record.journal_line import Entry
from bench.record.ledger import LEDGER, Ledger
from bench.record.run_folder import MANIFEST
from bench.record.storage import sha256_of, storage_errors

FOLDER_AUTHORISED = "folder_authorised"
_SHOWN = 16  # Characters: date, hours and minutes


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


def enter_authorisation(ledger: Ledger, folder: Path, person: str, fingerprint: str) -> bool:
    """Write into the ledger that a person has authorised this folder. False if the bench has no ledger."""
    if not ledger.path.exists():
        return False
    with storage_errors(folder):
        hashes = {"seal": sha256_of(folder / MANIFEST), "signature": sha256_of(folder / AUTHORISATION)}
    facts = {"folder": str(folder.resolve()), "person": person, "fingerprint": fingerprint}
    ledger.append(FOLDER_AUTHORISED, **hashes, **facts)
    return True


def known_authorisations(home: Path) -> Known:
    """Return the authorisations that this bench's ledger names; empty if it is missing or cannot be read."""
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
    authorisations: dict[str, list[Authorised]] = {}
    for entry in entries:
        if entry.event == FOLDER_AUTHORISED:
            signature, person, fingerprint, folder = (
                str(entry.data.get(name, "")) for name in ("signature", "person", "fingerprint", "folder")
            )
            authorised = Authorised(signature, person, fingerprint, folder, entry.utc)
            authorisations.setdefault(str(entry.data.get("seal", "")), []).append(authorised)
    return authorisations


def compare_authorisation(folder: Path, known: Known) -> Findings:
    """Compare a folder's authorisation with the ledger's: nothing if they agree, or if it names none for this seal.

    A fault if it was removed or replaced; a remark if a copy, which is perhaps older, does not have it.
    """
    findings = Findings()
    manifest, signature = folder / MANIFEST, folder / AUTHORISATION
    with storage_errors(folder):
        if not known or not manifest.is_file():
            return findings
        named = known.get(sha256_of(manifest), ())
        if not named or (
            signature.is_file() and sha256_of(signature) in {authorised.signature for authorised in named}
        ):
            return findings
        is_there, here = signature.exists(), folder.resolve()
    last = named[-1]
    if is_there:
        what = f"the ledger names another authorisation than {AUTHORISATION}: by {last}"
        findings.fault("authorisation", AUTHORISATION, what)
    elif (
        here not in {Path(authorised.folder).resolve() for authorised in named} and Path(last.folder).is_dir()
    ):
        findings.remarks.append(
            f"the ledger names an authorisation that this copy does not have: by {last}, in {last.folder}"
        )
    else:
        again = f"Copy {AUTHORISATION} back, or let the person authorise again"
        what = f"the ledger names an authorisation that is missing: by {last}. {again}"
        findings.fault("authorisation", AUTHORISATION, what)
    return findings


def lost_authorisations(home: Path) -> list[str]:
    """Compare all folders that this bench's ledger names as authorised, as far as they are still there."""
    known, lost = known_authorisations(home), []
    for folder in sorted(
        {authorised.folder for named in known.values() for authorised in named if authorised.folder}
    ):
        with suppress(BenchError):
            lost += [
                f"{folder}: {fault.what}." for fault in compare_authorisation(Path(folder), known).faults
            ]
    return lost
