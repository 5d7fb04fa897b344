"""Compare sealed run folders, by the hash of their line and their seal, with the ledger of the bench that sealed them.

A folder is this bench's if the bench's key, or an earlier key of the same name, has sealed it. Writes nothing.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from bench.base.errors import BenchError
from bench.evidence.findings import UNREADABLE
from bench.evidence.public_half import KEY_FILE, read_public
from bench.evidence.signers import NAMESPACE, SIGNERS_FILE, read_signers
from bench.evidence.sshsig import is_valid, read_signature
from bench.record.ledger import Ledger
from bench.record.ledger_marks import EXPLAIN, STILL_OPEN, KnownRun, LedgerRun, Strangers
from bench.record.run_folder import CERTIFICATE, JOURNAL, MANIFEST, SIGNATURE, is_sealed
from bench.record.run_index import RunIndex
from bench.record.storage import read_bounded, read_json, sha256_of
from bench.record.stored_run import StoredRun

_LARGEST_SIGNATURE_BYTES = 64 * 1024  # One of RSA with 16,384 bits has 6 kB
_ASK = "Ask who can write to this computer's files."


def own_public_keys(home: Path) -> set[bytes]:
    """Return this bench's public keys as SSH encodes them: the present one, and trusted ones of the same name."""
    try:
        own, principal = read_public((home / KEY_FILE).with_suffix(".pub"))
    except BenchError:
        return set()
    try:
        trusted = read_signers(home / SIGNERS_FILE)
    except BenchError:
        trusted = []
    return {own, *(signer.public_key for signer in trusted if signer.principal == principal)}


def is_sealed_by(folder: Path, keys: Collection[bytes]) -> bool:
    """Return whether one of some keys has signed the list of a folder, whose files are not compared with it."""
    path = folder / SIGNATURE
    try:
        if not is_sealed(folder) or path.stat().st_size > _LARGEST_SIGNATURE_BYTES:
            return False
        signature = read_signature(path.read_bytes())
        if signature.public_key not in keys or signature.namespace != NAMESPACE:
            return False
        return is_valid(signature, read_bounded(folder / MANIFEST))
    except (OSError, BenchError):
        return False


def sealed_strangers(home: Path, beside: Path | None = None) -> Strangers:
    """Return a function that finds the sealed runs of this bench that its ledger does not have.

    It asks the index of runs; without a line of the ledger also the folders, two levels deep, of ``beside``.
    """

    def find(heads: Collection[str]) -> Sequence[KnownRun]:
        known = set(heads)
        entered = [*RunIndex(home).entered(), *(_named_below(beside) if beside and not known else ())]
        lost = {run.head: run for run in entered if run.head not in known}
        keys = own_public_keys(home) if lost else set()
        return [run for run in lost.values() if is_sealed_by(Path(run.folder), keys)]

    return find


def _named_below(folder: Path) -> Iterator[KnownRun]:
    """Yield what sealed runs and certificates below a folder state of their line in a ledger."""
    for pattern in (SIGNATURE, f"*/{SIGNATURE}", f"*/*/{SIGNATURE}"):
        for sealed in (path.parent for path in folder.glob(pattern)):
            with suppress(OSError, BenchError, *UNREADABLE):
                if (sealed / CERTIFICATE).is_file():
                    run = read_json(sealed / CERTIFICATE)["run"]
                    yield KnownRun(
                        str(sealed), str(run["id"]), int(run["ledger_number"]), str(run["ledger_head"])
                    )
                elif (sealed / JOURNAL).is_file():
                    place = StoredRun(sealed).history.ledger
                    yield KnownRun(str(sealed), sealed.name, place["number"], place["head"])


def ledger_faults_of_run(folder: Path, ledger: Ledger) -> list[str]:
    """Return a sentence for each fault of a run folder by this bench's ledger; none for a run of another bench."""
    head, number = _stated_line(folder)
    if not head:
        return []
    _, runs, breaks, damage = ledger.read()
    entered = next((run for run in runs if run.head == head), None)
    if entered is not None:
        return other_seal(folder, entered)
    is_explained = any(head in known_break.heads and known_break.reason is not None for known_break in breaks)
    if is_explained or not is_sealed_by(folder, own_public_keys(ledger.home)):
        return []
    if damage:
        return [f"The ledger of this bench is damaged, so it does not confirm this run: {damage}"]
    holder = next((run for run in runs if run.number == number), None)
    other = f" There, number {number} is the run {holder.folder}." if holder else ""
    what = f"This bench has sealed this run as number {number}, but its ledger does not contain it.{other}"
    return [f"{what} Lines of the ledger were removed or replaced. {EXPLAIN}"]


def other_seal(folder: Path, entered: LedgerRun) -> list[str]:
    """Return how the seal of a run folder contradicts its line in a ledger: a sentence, or nothing."""
    if not is_sealed(folder):
        return (
            []
            if entered.seal is None
            else [f"The ledger states a seal, but {folder} has none: it was removed."]
        )
    if entered.seal is None:
        what = f"{folder} is sealed, but the ledger says that the run {entered.how} without a seal. {_ASK}"
        return [] if entered.how == STILL_OPEN else [what]
    if entered.seal != sha256_of(folder / MANIFEST):
        return [f"{folder} has another seal than the ledger: it was changed and sealed again. {_ASK}"]
    return []


def _stated_line(folder: Path) -> tuple[str, Any]:
    """Return the hash of a run's line in the ledger, and its number, as its journal states them; empty if it cannot."""
    try:
        place: Mapping[str, Any] = StoredRun(folder).history.ledger
        return str(place["head"]), place["number"]
    except (OSError, BenchError, *UNREADABLE):
        return "", None
