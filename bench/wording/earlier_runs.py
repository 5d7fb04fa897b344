"""How many runs of its camera a bench has made before a run, in words."""

from __future__ import annotations

from bench.record.events import LedgerPlace

ENDS = {"open": "without an end"}
"""Words for the ends of runs in the ledger."""


def earlier_runs(ledger: LedgerPlace) -> str:
    """Return how often the camera of a run was calibrated before, by the end of each run; ``none`` if never.

    >>> earlier_runs({"number": 3, "head": "", "of_camera": {"finished": 1, "open": 2}})
    '1 finished, 1 without an end'
    """
    earlier = dict(ledger["of_camera"])
    earlier["open"] = earlier.get("open", 0) - 1  # this run was entered when it began
    counts = [f"{count} {ENDS.get(how, how)}" for how, count in earlier.items() if count > 0]
    return ", ".join(counts) or "none"
