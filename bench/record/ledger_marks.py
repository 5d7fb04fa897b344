"""What is known of the ledger beside it: ``ledger_high``, the bench's own mark, and the sealed runs.

They show lines cut off the end, and a deleted file: such a chain is still valid.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

from bench.base.bounded_json import parse_json
from bench.base.errors import EvidenceError, JournalBroken
from bench.record.journal_line import Entry
from bench.record.run_folder import MANIFEST
from bench.record.run_verdict import RunVerdict, read_verdict
from bench.record.storage import read_bounded, storage_errors, write_atomic

MARK = "ledger_high"
_MOST_MARK_BYTES = 1 << 20  # A mark has some hundred bytes, with counts of series some thousand

RUN_BEGUN = "run_begun"
RUN_ENDED = "run_ended"
STILL_OPEN = "open"
"""State of a run without an end: it is running, was killed, or was cut off by a loss of power."""

LEDGER_BROKEN = "ledger_broken"
BREAK_EXPLAINED = "break_explained"
EXPLAIN = "State what happened: `starbench ledger --explain TEXT`."
_MOST_KNOWN = 100  # What names a hundred breaks needs a person, not a longer list


@dataclass(frozen=True)
class LedgerMark:
    """The state of a ledger after one of its lines."""

    lines: int
    runs: int  # Highest number of a run
    head: str  # Hash of the last line
    utc: str  # Time of the last line, ISO 8601
    counts: Mapping[str, int] = field(default_factory=dict, hash=False)  # The highest of each series

    def to_dict(self) -> dict[str, Any]:
        """Return the mark as JSON carries it: all attributes; ``counts`` is left out if it is empty."""
        return {name: value for name, value in vars(self).items() if name != "counts" or value}

    def disagreement(self, entries: Sequence[Entry]) -> str:
        """Return how a ledger contradicts this mark: the end of a sentence that begins with "The ledger", or empty."""
        if len(entries) < self.lines:
            return (
                f"has {len(entries)} of at least {self.lines} lines: {self.lines - len(entries)} are missing"
            )
        if entries[self.lines - 1].hash != self.head:
            return f"has another line {self.lines} than it had on {self.utc[:16]}: lines were removed or replaced"
        return ""


def parse_mark(line: bytes) -> LedgerMark:
    """Read one mark, a line of ``ledger_high``; ValueError if it is none."""
    from pydantic import TypeAdapter  # most commands read no mark

    parse_json(line)  # bounded, and read alike by all readers
    mark = TypeAdapter(LedgerMark).validate_json(line, strict=True)
    if mark.lines < 1 or mark.runs < 0:
        raise ValueError(mark)
    return mark


def read_own_mark(home: Path) -> LedgerMark | None:
    """Read ``ledger_high``; None if there is no such file."""
    path = home / MARK
    with storage_errors(path):
        if not path.exists():
            return None
        data = read_bounded(path, _MOST_MARK_BYTES)
    try:
        return parse_mark(data)
    except ValueError as error:
        raise EvidenceError(
            "This file does not hold the state of the ledger.",
            where=str(path),
            remedy="Somebody changed it. State what happened: `starbench ledger --explain TEXT`.",
        ) from error


def write_own_mark(home: Path, mark: LedgerMark) -> None:
    """Write ``ledger_high``, one line of JSON."""
    write_atomic(home / MARK, (json.dumps(mark.to_dict(), separators=(",", ":")) + "\n").encode())


class LedgerRun(NamedTuple):
    """One run in the ledger."""

    number: int  # Number of the run in the ledger, from 1
    run_id: str
    folder: str  # Where it ended last, or began: a folder may be moved, or copied, before its run is resumed
    camera: str
    simulated: bool  # Whether any device was simulated
    begun_utc: str  # Time of the start, ISO 8601
    how: str = STILL_OPEN  # State of the run: ``finished``, ``aborted``, ``failed`` or ``open``
    seal: str | None = None  # SHA-256 of its list of files; None when it was not sealed
    head: str = ""  # Hash of the line that enters it
    ended_utc: str = ""  # Time of the line with its end and its seal; empty without one
    verdict: RunVerdict | None = None  # None if it has no results, or an earlier version entered it


@dataclass(frozen=True)
class RunFault:
    """A sealed run of the ledger whose folder is not as it was sealed."""

    run: LedgerRun
    kind: Literal["missing", "changed"]

    @property
    def key(self) -> tuple[str, str]:
        """What a line that explains the fault repeats: the hash of the run's line, and the kind."""
        return self.run.head, self.kind

    def __str__(self) -> str:
        what = f"its folder {self.run.folder} is missing"
        if self.kind == "changed":
            what = f"{Path(self.run.folder) / MANIFEST} was changed after sealing"
        return f"run {self.run.number} ({self.run.run_id}): {what}"


def runs_of(entries: Iterable[Entry]) -> list[LedgerRun]:
    """Return the runs of a ledger as they began; after a break of the ledger some numbers may be missing."""
    runs: list[LedgerRun] = []
    place_of: dict[int, int] = {}
    for entry in entries:
        data = entry.data
        try:
            if entry.event == RUN_BEGUN:
                number = data["number"]
                _require_rising(number, runs)
                names = (data["run"], data["folder"], data["camera"], data["simulated"])
                place_of[number] = len(runs)
                runs.append(LedgerRun(number, *names, begun_utc=entry.utc, head=entry.hash))
            elif entry.event == RUN_ENDED and not data.get("lost"):
                at = place_of[data["number"]]
                if runs[at].seal and data["seal"] is None:
                    continue  # a copy of a sealed run that was resumed in vain
                end = {"folder": runs[at].folder, **data}  # an earlier version stated no folder
                end = {name: end[name] for name in ("how", "seal", "folder")}
                runs[at] = runs[at]._replace(ended_utc=entry.utc, verdict=read_verdict(data), **end)
        except (LookupError, TypeError, ValueError) as error:
            raise JournalBroken(
                f"Line {entry.seq + 1} of the ledger is not a line about a run.",
                remedy="Another program wrote it. State what happened: `starbench ledger --explain TEXT`.",
            ) from error
    return runs


def _require_rising(number: object, runs: Sequence[LedgerRun]) -> None:
    last = runs[-1].number if runs else 0
    if isinstance(number, bool) or not isinstance(number, int) or number <= last:
        raise ValueError(number)


@dataclass(frozen=True)
class KnownRun:
    """A run that names its own line of the ledger."""

    folder: str
    run_id: str
    number: int  # Its number in the ledger, as its journal states it
    head: str  # Hash of its line in the ledger, as its journal states it


Strangers = Callable[[Collection[str]], Sequence[KnownRun]]
"""Given the hashes of all lines, returns the sealed runs of this bench whose line is not among them."""


def no_strangers(_: Collection[str]) -> Sequence[KnownRun]:
    """Ask no run folder."""
    return ()


@dataclass(frozen=True)
class Break:
    """A break that the ledger records."""

    line: int  # Number of its line, from 1
    utc: str  # When it was found, ISO 8601
    what: tuple[str, ...]
    heads: frozenset[str]  # Heads that other places knew and the ledger had not
    reason: str | None = None  # What a person stated as the reason; None while nobody has
    by: str | None = None  # Who stated it; None while nobody has

    def __str__(self) -> str:
        found = f"On {self.utc[:16].replace('T', ' ')} UTC the ledger was found broken: {' '.join(self.what)}"
        return found if self.reason is None else f"{found} Reason, stated by {self.by}: {self.reason}"


@dataclass
class BreakFindings:
    """What was found and is not recorded yet."""

    what: list[str] = field(default_factory=list)  # The findings, as sentences; empty if there is no break
    # What other places know, as a line ``ledger_broken`` holds it.
    known: list[Mapping[str, Any]] = field(default_factory=list)


def breaks_of(entries: Iterable[Entry]) -> list[Break]:
    """Return the breaks that a ledger records, first to last, each with its explanation if there is one."""
    breaks: dict[int, Break] = {}
    for entry in entries:
        data = entry.data
        if entry.event == LEDGER_BROKEN:
            heads = frozenset(str(known["head"]) for known in data["known"])
            what = tuple(str(sentence) for sentence in data["what"])
            breaks[entry.seq + 1] = Break(
                entry.seq + 1, entry.utc, what, heads, data.get("reason"), data.get("by")
            )
        elif entry.event == BREAK_EXPLAINED:
            line = int(data["line"])
            breaks[line] = replace(breaks[line], reason=str(data["reason"]), by=str(data["by"]))
    return list(breaks.values())


def highest_run(entries: Iterable[Entry]) -> int:
    """Return the highest number of a run that a ledger has given, or a break of it knows of; 0 if there is none."""
    highest = 0
    for entry in entries:
        if entry.event == RUN_BEGUN:
            highest = max(highest, entry.data["number"])
        elif entry.event == LEDGER_BROKEN:
            highest = max([highest, *(known["runs"] for known in entry.data["known"])])
    return highest


def highest_counts(entries: Iterable[Entry]) -> dict[str, int]:
    """Return the highest count of each series: of lines with a ``series``, and of breaks that know of more."""
    highest: dict[str, int] = {}
    for entry in entries:
        series, count = entry.data.get("series"), entry.data.get("count")
        counts_of_series = [(series, count)] if isinstance(series, str) and isinstance(count, int) else []
        if entry.event == LEDGER_BROKEN:
            counts_of_series = [
                pair for known in entry.data["known"] for pair in known.get("counts", {}).items()
            ]
        for name, number in counts_of_series:
            highest[name] = max(number, highest.get(name, 0))
    return highest


def find_breaks(
    entries: Sequence[Entry], own: LedgerMark | str | None, strangers: Strangers = no_strangers
) -> BreakFindings:
    """Compare a ledger with all places that know of it; ``own`` is None without a mark, a text if it cannot be read."""
    findings = BreakFindings()
    excused = {head for gap in breaks_of(entries) for head in gap.heads}
    _ask_own_mark(findings, entries, own, excused)
    lost = [run for run in strangers({entry.hash for entry in entries}) if run.head not in excused]
    numbers = {e.data["number"]: e.data["run"] for e in entries if e.event == RUN_BEGUN}
    for run in lost:
        holder = (
            f"; its number {run.number} is that of run {numbers[run.number]}" if run.number in numbers else ""
        )
        findings.what.append(f"The sealed run {run.folder} is not in the ledger{holder}.")
        mark = {"place": run.folder, "lines": 0, "runs": run.number, "head": run.head}
        findings.known.append(mark)
    if len(findings.what) > _MOST_KNOWN:
        findings.what[_MOST_KNOWN:] = [f"And {len(findings.what) - _MOST_KNOWN} more."]
    return findings


def _ask_own_mark(
    findings: BreakFindings, entries: Sequence[Entry], own: LedgerMark | str | None, excused: Collection[str]
) -> None:
    if isinstance(own, str):
        findings.what.append(f"The bench's own mark of the ledger cannot be read: {own}")
    elif own is None:
        since = max((e.seq for e in entries if e.event == LEDGER_BROKEN), default=-1)
        if len(entries[since + 1 :]) > 1:  # after the first line, the process may have been killed
            findings.what.append("The bench's own mark of the ledger (ledger_high) was deleted.")
    elif own.head not in excused and (what := own.disagreement(entries)):
        findings.what.append(f"The ledger {what} (as ledger_high knows).")
        findings.known.append({"place": "ledger_high", **own.to_dict()})
