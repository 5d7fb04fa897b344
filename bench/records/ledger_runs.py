"""The runs in a ledger: from its lines to one entry for each run. Reads no files."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from bench.base.errors import JournalBroken
from bench.records.journal_entry import Entry

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
    Raises JournalBroken: When a line about a run is incomplete, gives a number again, or ends a run that
      never began.
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
