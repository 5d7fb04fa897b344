"""What a verification finds: faults, parts that could not be compared, and remarks. Data only."""

from __future__ import annotations

import hashlib
import itertools
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

from bench.base.bounded_json import parse_json
from bench.base.errors import RunFolderError
from bench.records.events import Event
from bench.records.history import History, replay
from bench.records.journal import (
    CAPTURES,
    CLOCK_JUMP_S,
    CLOCK_JUMPED,
    Capture,
    Entry,
    read_journal,
    stored_captures,
)
from bench.records.run_folder import (
    CHECKED_COPY,
    JOURNAL,
    PASSPORT_COPY,
    PLAN,
    REPORT,
    RESULTS,
    SEQUENCE_COPY,
    STATION_COPY,
)


@dataclass(frozen=True)
class SealFault:
    """One fault of a sealed folder."""

    # ``unsealed``, ``signature``, ``key``, ``manifest``, ``added``, ``changed``, ``missing``, ``link``,
    # ``kind``, ``form``, ``journal``, ``plan``, ``results``, ``exports``, ``report``, ``views``, ``recording``,
    # ``wire``, ``instructions``, ``certificate``, ``ledger``, ``item``, ``authorisation`` or ``timestamp``.
    kind: str
    where: str
    what: str

    def __str__(self) -> str:
        return f"{self.where}: {self.what}"


UNREADABLE = (ValueError, LookupError, TypeError, AttributeError, ArithmeticError, RecursionError)
"""Exceptions raised by reading JSON that is not of the expected form."""


@dataclass
class Findings:
    """What one check found. A check that finds nothing returns an empty one."""

    faults: list[SealFault] = field(default_factory=list)
    # Parts of the folder that were to be compared and could not be, each with the reason, as a sentence
    # without a full stop. A folder with such a part is not reported as valid without reservation (exit status
    # 4).
    not_compared: list[str] = field(default_factory=list)
    # What a reader should know, and what is no lack of the check.
    remarks: list[str] = field(default_factory=list)

    def fault(self, kind: str, where: str, what: str) -> None:
        """Add a fault."""
        self.faults.append(SealFault(kind, where, what))

    def add(self, other: Findings) -> None:
        """Add everything that another check found."""
        self.faults += other.faults
        self.not_compared += other.not_compared
        self.remarks += other.remarks


Derivation = Callable[[Path], Findings]
"""Derives parts of a sealed folder again and compares. It takes the folder, changes nothing in it, and returns what it
found. It is called only while no check has found a fault, so it may rely on the list of files and on the journal. What
it cannot read is a fault, never an exception; only StorageError and OSError may leave it."""

Derivations = Mapping[str, Sequence[Derivation]]
"""The derivations of each kind of folder (`bench.evidence.seal.kind_of`)."""


@dataclass(frozen=True)
class Verification:
    """What the checks found."""

    folder: str
    kind: str = ""  # ``run``, ``certificate``, ``results``, or ``files`` for any other folder
    faults: Sequence[SealFault] = ()  # All faults; empty when the folder is as a trusted bench sealed it
    # Whether the results were made again from the recordings, and the numbers compared (``verify --again``).
    again: bool = False
    # Parts that were to be compared and could not be, and why; see `Findings`.
    not_compared: Sequence[str] = ()
    remarks: Sequence[str] = ()
    state: str = "DRAFT"  # ``DRAFT``, ``SEALED`` or ``AUTHORISED``
    statements: Sequence[str] = ()
    # When the folder says that it was made, by the bench's own clock, ISO 8601; None if it does not say.
    stated: str | None = None
    # signer, fingerprint: Name of the bench in the list of trusted keys (None if its key is not accepted),
    # and fingerprint of its key.
    signer: str | None = None
    fingerprint: str | None = None
    # person, person_fingerprint: Name and fingerprint of the person who authorised; None if nobody did, or if
    # it does not hold.
    person: str | None = None
    person_fingerprint: str | None = None
    files: int = 0
    run_id: str | None = None
    camera_serial: str | None = None
    # Whether the devices were simulated; None when the results do not state it.
    simulated: bool | None = None

    @property
    def ok(self) -> bool:
        """Whether no fault was found."""
        return not self.faults

    @property
    def complete(self) -> bool:
        """Whether no fault was found and every part that was to be compared was compared."""
        return self.ok and not self.not_compared

    def to_dict(self) -> dict[str, Any]:
        """Return the verification as JSON carries it: ``ok``, ``complete``, and all attributes."""
        own = asdict(self)
        return {"ok": self.ok, "complete": self.complete, **own}


# An attacker who holds the bench's key can write the whole chain again. The checks here then still find
# what he did not write consistently; `bench.results.again_run` compares the journal with what the
# recordings give.

EXPORTS = "exports/"
_WRITTEN_LAST = (RESULTS, REPORT, "views.h5")
"""Files that the report step writes, besides the exports."""
_CLOCK_SLACK_S = 0.05


def check_journal(folder: Path, manifest: Mapping[str, str], found: Findings) -> Mapping[str, Capture]:
    """Check a run's journal, and the files of the folder and of the seal's list against it."""
    path = folder / JOURNAL
    if path.is_symlink() or not path.is_file():
        found.fault("journal", JOURNAL, "the file is missing")
        return {}
    try:
        entries, torn = read_journal(path)
        captures = stored_captures(entries)
        history = replay(entries)
    except RunFolderError as error:
        found.fault("journal", error.where.removeprefix(f"{folder}/") or JOURNAL, error.what)
        return {}
    if torn:
        found.fault("journal", JOURNAL, "its last line is incomplete")
        return captures
    for number, line in enumerate(path.read_bytes().splitlines(), start=1):
        if json.dumps(parse_json(line), separators=(",", ":")).encode() != line:
            found.fault("journal", f"{JOURNAL}:{number}", "its JSON is not written as the program writes it")
            return captures
    _begin_and_end(entries, history, found)
    _clock(entries, found)
    _documents(manifest, history, found)
    _recordings(manifest, captures, entries, found)
    _written(folder, manifest, entries, found)
    return captures


def _begin_and_end(entries: Sequence[Entry], history: History, found: Findings) -> None:
    if not entries or entries[0].event != Event.RUN_STARTED:
        found.fault("journal", f"{JOURNAL}:1", "the first line does not begin a run (run_started)")
    again = [entry for entry in entries[1:] if entry.event == Event.RUN_STARTED]
    if again:
        found.fault("journal", f"{JOURNAL}:{again[0].seq + 1}", "a second line begins the run (run_started)")
    if not entries or entries[-1].event != Event.RUN_ENDED:
        found.fault(
            "journal",
            JOURNAL,
            "its last line does not end the run (run_ended); a bench seals ended runs only",
        )
    elif history.ended != "finished":
        found.fault(
            "journal", JOURNAL, f"the run {history.ended or 'did not end'}; a bench seals finished runs only"
        )


def _clock(entries: Sequence[Entry], found: Findings) -> None:
    """Compare both clocks from line to line; the journal has a line for each jump of the system's clock."""
    for last, entry in itertools.pairwise(entries):
        try:
            passed_s = (_moment(entry) - _moment(last)).total_seconds()
            jumped_s = passed_s - (entry.mono_s - last.mono_s)
            back = entry.mono_s < last.mono_s
        except (TypeError, ValueError):
            found.fault("journal", f"{JOURNAL}:{entry.seq + 1}", "its time cannot be read")
            return
        if entry.event == CLOCK_JUMPED:
            continue
        bound_s = CLOCK_JUMP_S + _CLOCK_SLACK_S
        other_process = entry.event == Event.RUN_RESUMED  # its monotonic clock may begin anew
        if passed_s < -bound_s if other_process else back or abs(jumped_s) > bound_s:
            what = "its time does not follow from the line before, and no line states that the clock jumped"
            found.fault("journal", f"{JOURNAL}:{entry.seq + 1}", what)
            return


def _moment(entry: Entry) -> datetime:
    return datetime.fromisoformat(entry.utc)


def _documents(manifest: Mapping[str, str], history: History, found: Findings) -> None:
    """Compare sequence, station, passport and plan with the hashes in the journal's first line."""
    stated = history.started.get("sha256")
    if not isinstance(stated, dict):
        found.fault("journal", f"{JOURNAL}:1", "it does not state the hashes of the run's documents")
        return
    for name in (SEQUENCE_COPY, STATION_COPY):
        if name not in stated:
            found.fault("journal", f"{JOURNAL}:1", f"it does not state the hash of {name}")
    for name, sha256 in stated.items():
        if name not in manifest:
            found.fault("plan", str(name), "the run began with this file; it is missing")
        elif manifest[name] != sha256:
            found.fault(
                "plan",
                str(name),
                "this is not the file that the run began with (hash in the journal's first line)",
            )
    if PASSPORT_COPY in manifest and PASSPORT_COPY not in stated:
        found.fault(
            "plan", PASSPORT_COPY, "the run began without a passport (the journal's first line names none)"
        )
    if CHECKED_COPY in manifest and CHECKED_COPY not in stated:
        found.fault(
            "plan", CHECKED_COPY, "the run began without it (the journal's first line does not name it)"
        )
    if PLAN not in manifest:
        found.fault("plan", PLAN, "the file is missing")


def _recordings(
    manifest: Mapping[str, str], captures: Mapping[str, Capture], entries: Sequence[Entry], found: Findings
) -> None:
    """Compare the recordings in the folder with those that the journal names."""
    gone = {
        str(name)
        for entry in entries
        if entry.event == Event.RECOVERED
        for name in (*entry.data.get("missing", ()), *entry.data.get("changed", ()))
    }
    for name, capture in captures.items():
        if name not in manifest:
            if name not in gone:
                found.fault("recording", name, "the journal names this recording; it is missing")
        elif manifest[name] != capture.sha256:
            found.fault("recording", name, "the journal names this recording with another hash")
    for name in manifest:
        if name.startswith(f"{CAPTURES}/") and name not in captures:
            found.fault("recording", name, "the journal does not name this recording")


def _written(folder: Path, manifest: Mapping[str, str], entries: Sequence[Entry], found: Findings) -> None:
    """Compare results, report, views, exports and wire log with the journal's line that they were written."""
    reported = _reported(entries)
    if not reported:
        for name in manifest:
            if name in _WRITTEN_LAST or name.startswith(EXPORTS):
                found.fault("results", name, "the journal has no report step that wrote this file")
        return
    for name in _WRITTEN_LAST:
        if name not in manifest:
            found.fault("results", name, "the journal's report step wrote this file; it is missing")
    _written_line(folder, manifest, entries, found)


def _written_line(
    folder: Path, manifest: Mapping[str, str], entries: Sequence[Entry], found: Findings
) -> None:
    line = next((entry for entry in reversed(entries) if entry.event == Event.WRITTEN), None)
    if line is None:
        what = "it does not hold the hashes of results, report, views and exports"
        found.fault("journal", JOURNAL, f"{what}, though this version of the program writes them")
        return
    files = line.data.get("files")
    where = f"{JOURNAL}:{line.seq + 1}"
    if not isinstance(files, dict):
        found.fault("journal", where, "it does not state the files that were written")
        return
    for name, sha256 in files.items():
        if manifest.get(name) != sha256:
            what = "is missing" if name not in manifest else "is another file than the one that was written"
            found.fault(_kind_of_file(name), str(name), f"by the journal, it {what}")
    for name in manifest:
        if (name in _WRITTEN_LAST or name.startswith(EXPORTS)) and name not in files:
            found.fault(
                _kind_of_file(name), name, "the journal does not name it among the files that were written"
            )
    _wire(folder, line.data.get("wire"), where, found)


def _reported(entries: Sequence[Entry]) -> bool:
    """Return whether the report step has ended without an error."""
    return any(
        entry.event == Event.LEFT_OFF and entry.data.get("state") == "reporting" and "error" not in entry.data
        for entry in entries
    )


def _kind_of_file(name: str) -> str:
    return {RESULTS: "results", REPORT: "report", "views.h5": "views"}.get(name, "exports")


def _wire(folder: Path, stated: Any, where: str, found: Findings) -> None:
    """Check that no wire log was changed after the results were written. It may only have grown."""
    if not isinstance(stated, dict):
        found.fault("journal", where, "it does not state the wire log")
        return
    for name, one in stated.items():
        try:
            size, sha256 = int(one["size"]), str(one["sha256"])
        except (KeyError, TypeError, ValueError):
            found.fault("journal", where, "it does not state the wire log")
            return
        stem, _, number = str(name).partition(".jsonl")
        rotated = (
            f"{stem}.jsonl.{int(number.lstrip('.') or 0) + 1}"
            if number.lstrip(".").isdigit() or not number
            else name
        )
        if sha256 not in {_hash_of_begin(folder / one_name, size) for one_name in (name, rotated)}:
            found.fault(
                "wire",
                str(name),
                "it does not begin with the bytes that it had when the results were written",
            )


def _hash_of_begin(path: Path, size: int) -> str:
    """Return the SHA-256 of the first bytes of a file; empty if it is shorter or missing."""
    if not path.is_file() or path.stat().st_size < size:
        return ""
    digest = hashlib.sha256()
    with path.open("rb") as file:
        left = size
        while left and (block := file.read(min(left, 1 << 20))):
            digest.update(block)
            left -= len(block)
    return digest.hexdigest()
