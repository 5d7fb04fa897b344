"""Compare sealed run folders, by number and hash of their line, with the ledger of the bench that sealed them.

A folder is this bench's if the bench's key, or an earlier key of the same name, has sealed it. Writes nothing.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

from bench.base.errors import BenchError
from bench.evidence.findings import UNREADABLE
from bench.evidence.public_half import KEY_FILE, read_public
from bench.evidence.signers import NAMESPACE, SIGNERS_FILE, read_signers
from bench.evidence.sshsig import is_valid, read_signature
from bench.record.events import Event
from bench.record.ledger import Ledger
from bench.record.ledger_marks import EXPLAIN, STILL_OPEN, KnownRun, LedgerRun, Strangers
from bench.record.run_folder import CERTIFICATE, JOURNAL, MANIFEST, SIGNATURE, is_sealed
from bench.record.run_index import RunIndex
from bench.record.storage import read_bounded, read_json, sha256_of
from bench.record.stored_run import StoredRun

_LARGEST_SIGNATURE_BYTES = 64 * 1024  # One of RSA with 16,384 bits has 6 kB
_CLOCK_SLACK = timedelta(minutes=10)
"""A clock may be set while a run begins or ends by so much without a fault."""
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


@dataclass(frozen=True)
class _Said:
    """What the journal of a run states."""

    place: Mapping[str, Any]
    run_id: str
    simulated: bool
    camera: str
    begun_utc: str  # Of the line that names the place in the ledger
    last_utc: str  # Of the last line


def ledger_faults_of_run(folder: Path, ledger: Ledger) -> list[str]:
    """Return a sentence for each fault of a run folder by this bench's ledger; none for a run of another bench."""
    statement = _said_by(folder)
    if statement is None:
        return []
    _, runs, breaks, damage = ledger.read()
    if damage:
        is_own = is_sealed_by(folder, own_public_keys(ledger.home))
        damage_text = f"The ledger of this bench is damaged, so it does not confirm this run: {damage}"
        return [damage_text] if is_own else []
    entered = next((run for run in runs if run.head == statement.place.get("head")), None)
    if entered is not None:
        return _differences(folder, statement, entered)
    named_by = next(
        (known_break for known_break in breaks if statement.place.get("head") in known_break.heads), None
    )
    if named_by is not None and named_by.reason is not None:
        return []
    if not is_sealed_by(folder, own_public_keys(ledger.home)):
        return []
    number = statement.place.get("number")
    holder = next((run for run in runs if run.number == number), None)
    other = f" There, number {number} is the run {holder.folder}." if holder else ""
    what = f"This bench has sealed this run as number {number}, but its ledger does not contain it.{other}"
    return [f"{what} Lines of the ledger were removed or replaced. {EXPLAIN}"]


def _differences(folder: Path, statement: _Said, entered: LedgerRun) -> list[str]:
    differences = []
    stated = {
        "number": (statement.place.get("number"), entered.number),
        "name": (statement.run_id or entered.run_id, entered.run_id or statement.run_id),
        "simulated": (statement.simulated, entered.simulated),
        "camera": (statement.camera or entered.camera, entered.camera or statement.camera),
    }
    for what, (here, there) in stated.items():
        if here != there:
            differences.append(
                f"The {what} of this run is {here} in its journal and {there} in the ledger. {_ASK}"
            )
    differences += _dates(statement, entered)
    if is_sealed(folder):
        if entered.seal is None and entered.how != STILL_OPEN:
            differences.append(
                f"This run is sealed, but the ledger says that it {entered.how} without a seal. {_ASK}"
            )
        elif entered.seal not in {None, sha256_of(folder / MANIFEST)}:
            differences.append(
                f"This folder has another seal than the ledger: it was changed and sealed again. {_ASK}"
            )
    return differences


def _dates(statement: _Said, entered: LedgerRun) -> list[str]:
    """Compare the times of the journal with those at which the ledger took the run and its seal."""
    begun, last = (datetime.fromisoformat(text) for text in (statement.begun_utc, statement.last_utc))
    dates = []
    if abs(begun - datetime.fromisoformat(entered.begun_utc)) > _CLOCK_SLACK:
        dates.append(
            f"The journal of this run states {statement.begun_utc} for its begin, the ledger"
            f" {entered.begun_utc}. {_ASK}"
        )
    if entered.seal is not None and datetime.fromisoformat(entered.ended_utc) < last - _CLOCK_SLACK:
        dates.append(
            f"The ledger took the end and the seal of this run at {entered.ended_utc}, before the last line of its "
            f"journal, {statement.last_utc}. {_ASK}"
        )
    return dates


def _said_by(folder: Path) -> _Said | None:
    """Return what the journal of a run says; None if it cannot be read, or the run was in no ledger."""
    try:
        entries = StoredRun(folder).entries
    except (OSError, BenchError):
        return None
    started = [e.data for e in entries if e.event in {Event.RUN_STARTED, Event.RUN_RESUMED}]
    places = [data["ledger"] for data in started if isinstance(data.get("ledger"), Mapping)]
    if not places:
        return None
    begun = [e.utc for e in entries if e.data.get("ledger") == places[-1]]
    cameras = [e.data.get("camera") for e in entries if e.event == Event.DEVICES]
    camera = cameras[-1] if cameras and isinstance(cameras[-1], Mapping) else {}
    return _Said(
        places[-1],
        str(started[0].get("id", "")),
        bool(started[0].get("simulated", False)),
        str(camera.get("serial", "")),
        begun[0],
        entries[-1].utc,
    )
