"""Breaks of the ledger: how they are found, recorded in the ledger itself, and explained by a person.

A break is anything that a ledger which only grows cannot show: lines are missing or replaced, the file is gone or
damaged, or a sealed run of this bench has a line that the ledger has not. It is recorded as a line ``ledger_broken``
with what was found and what other places knew; the ledger then grows on. A person states the reason, in that line or
later in a line ``break_explained``. Nothing is ever rewritten. This module decides; it reads and writes no files.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from bench.base.errors import JournalBroken
from bench.records.journal import Entry
from bench.records.ledger_marks import LedgerMark, OwnMark, Witness

# The runs in a ledger: from its lines to one entry for each run. Reads no files.

RUN_BEGUN = "run_begun"
RUN_ENDED = "run_ended"
STILL_OPEN = "open"
"""State of a run without an end: it is running, was killed, or was cut off by a loss of power."""


@dataclass(frozen=True)
class LedgerRun:
    """One run in the ledger."""

    number: int  # Number of the run in the ledger, from 1
    run_id: str
    folder: str
    camera: str
    simulated: bool  # Whether any device was simulated
    begun_utc: str  # Time of the start, ISO 8601
    how: str = STILL_OPEN  # State of the run: ``finished``, ``aborted``, ``failed`` or ``open``
    seal: str | None = None  # SHA-256 of its list of files; None when it was not sealed
    head: str = ""  # Hash of the line that enters it
    ended_utc: str = ""  # Time of the line with its end and its seal; empty without one


def runs_of(entries: Iterable[Entry]) -> list[LedgerRun]:
    """Return the runs of a ledger.

    Returns: In the order in which they began. Numbers rise; after a break of the ledger some may be missing.
    """
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
                runs[at] = replace(runs[at], how=data["how"], seal=data["seal"], ended_utc=entry.utc)
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


LEDGER_BROKEN = "ledger_broken"
BREAK_EXPLAINED = "break_explained"
EXPLAIN = "State what happened: `starbench ledger --explain TEXT`."
_MOST_KNOWN = 100


@dataclass(frozen=True)
class KnownRun:
    """A run that names its own line of the ledger."""

    folder: str
    run_id: str
    # number, head: Its number, and the hash of its line, as its journal states them.
    number: int
    head: str


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
    # reason, by: What a person stated, and who; None while nobody has.
    reason: str | None = None
    by: str | None = None

    def __str__(self) -> str:
        return f"On {self.utc[:16].replace('T', ' ')} UTC the ledger was found broken: {' '.join(self.what)}"


@dataclass(frozen=True)
class BreakFindings:
    """What was found and is not recorded yet."""

    what: tuple[str, ...] = ()  # The findings, as sentences; empty if there is no break
    # What other places know, as a line ``ledger_broken`` holds it.
    known: tuple[Mapping[str, Any], ...] = ()
    warnings: tuple[str, ...] = ()  # Places that could not be asked


def breaks_of(entries: Iterable[Entry]) -> list[Break]:
    """Return the breaks that a ledger records, first to last, each with its explanation if there is one."""
    found: dict[int, Break] = {}
    for entry in entries:
        data = entry.data
        if entry.event == LEDGER_BROKEN:
            heads = frozenset(str(known["head"]) for known in data["known"])
            what = tuple(str(sentence) for sentence in data["what"])
            found[entry.seq + 1] = Break(
                entry.seq + 1, entry.utc, what, heads, data.get("reason"), data.get("by")
            )
        elif entry.event == BREAK_EXPLAINED:
            line = int(data["line"])
            found[line] = replace(found[line], reason=str(data["reason"]), by=str(data["by"]))
    return list(found.values())


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
        found = [(series, count)] if isinstance(series, str) and isinstance(count, int) else []
        if entry.event == LEDGER_BROKEN:
            found = [pair for known in entry.data["known"] for pair in known.get("counts", {}).items()]
        for name, number in found:
            highest[name] = max(number, highest.get(name, 0))
    return highest


@dataclass
class _Findings:
    """Findings as they are collected."""

    what: list[str] = field(default_factory=list)
    known: list[Mapping[str, Any]] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)

    def knows(self, place: str, mark: LedgerMark) -> None:
        self.known.append({"place": place, **mark.to_dict()})


def find_breaks(
    entries: Sequence[Entry],
    own: OwnMark | str | None,
    anchors: Iterable[Witness] = (),
    strangers: Strangers = no_strangers,
) -> BreakFindings:
    """Compare a ledger with all places that know of it.

    own: The bench's own mark; None if there is none; a text if it cannot be read, with the reason.
    strangers: Finds sealed runs of this bench that are not in the ledger.
    """
    found = _Findings()
    excused = {head for one in breaks_of(entries) for head in one.heads}
    _ask_own_mark(found, entries, own, excused)
    for witness in anchors:
        _ask_anchor(found, entries, witness, excused)
    lost = [run for run in strangers({entry.hash for entry in entries}) if run.head not in excused]
    numbers = {e.data["number"]: e.data["run"] for e in entries if e.event == RUN_BEGUN}
    for run in lost:
        holder = (
            f"; its number {run.number} is that of run {numbers[run.number]}" if run.number in numbers else ""
        )
        found.what.append(f"The sealed run {run.folder} is not in the ledger{holder}.")
        mark = {"place": run.folder, "lines": 0, "runs": run.number, "head": run.head}
        found.known.append(mark)
    if len(found.what) > _MOST_KNOWN:
        found.what[_MOST_KNOWN:] = [f"And {len(found.what) - _MOST_KNOWN} more."]
    return BreakFindings(tuple(found.what), tuple(found.known), tuple(found.warnings))


def _ask_own_mark(
    found: _Findings, entries: Sequence[Entry], own: OwnMark | str | None, excused: Collection[str]
) -> None:
    if isinstance(own, str):
        found.what.append(f"The bench's own mark of the ledger cannot be read: {own}")
    elif own is None:
        since = max((e.seq for e in entries if e.event == LEDGER_BROKEN), default=-1)
        if any(e.event == RUN_BEGUN and e.data.get("witnessed") for e in entries[since + 1 :]):
            found.what.append("The bench's own mark of the ledger (ledger_high) was deleted.")
    elif own.mark.head not in excused and (what := own.mark.disagreement(entries)):
        found.what.append(f"The ledger {what} (as ledger_high knows).")
        found.knows("ledger_high", own.mark)


def _ask_anchor(
    found: _Findings, entries: Sequence[Entry], witness: Witness, excused: Collection[str]
) -> None:
    if witness.trouble:
        found.warnings.append(
            f"The second place of the ledger {witness.place} cannot be read: {witness.trouble}"
        )
    elif witness.was_there and not witness.marks:
        found.warnings.append(f"The second place of the ledger {witness.place} is empty; it had marks.")
    elif objecting := witness.objections(entries, excused):
        last = max(objecting, key=lambda mark: mark.lines)
        hint = (
            ""
            if witness.was_there
            else " Or the file is another bench's: then give this bench a file of its own."
        )
        found.what.append(f"The ledger {last.disagreement(entries)} (as {witness.place} knows).{hint}")
        for mark in dict.fromkeys([last, objecting[-1]]):
            found.knows(witness.place, mark)
