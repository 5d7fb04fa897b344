"""The numbers of certificates in the ledger, and what became of each. Replay of lines; nothing is written.

A number is reserved, and then issued or declared void. A number is lost if its line was lost with others, in a break of
the ledger that a person has explained.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

from bench.base.errors import JournalBroken
from bench.records.journal_entry import Entry

RESERVED = "certificate_reserved"
ISSUED = "certificate_issued"
VOIDED = "certificate_voided"
LOST = "certificate_lost"
_EVENTS = frozenset({RESERVED, ISSUED, VOIDED, LOST})

How = Literal["reserved", "issued", "void", "lost"]


@dataclass(frozen=True)
class Numbered:
    """A number of a series, and what became of it."""

    # number, series, count: The number as printed, its series, and its count in that, from 1.
    number: str
    series: str
    count: int
    how: How  # ``reserved``, ``issued``, ``void`` or ``lost``
    # run_seal, run_id: SHA-256 of the run's SHA256SUMS, and name of the run.
    run_seal: str
    run_id: str
    folder: str
    issued_utc: str
    amends: str = ""  # Number of the certificate that it replaces; empty if none
    superseded_by: str = ""  # Number of the certificate that replaces it; empty if none does
    seal: str = ""  # SHA-256 of the certificate's SHA256SUMS; empty before it is issued
    # serial, customer: Serial number of the camera, and name of the customer; empty before it is issued.
    serial: str = ""
    customer: str = ""
    reason: str = ""  # Why it is void; else empty

    @property
    def is_newest(self) -> bool:
        """Whether it is issued and nothing replaces it."""
        return self.how == "issued" and not self.superseded_by


def numbers(entries: Iterable[Entry]) -> dict[str, Numbered]:
    """Return all numbers of all series.

    Returns: By number, in the order of the reservations.
    Raises JournalBroken: When a line about a certificate is not of the expected form, or a number is missing
      in a series.
    """
    found: dict[str, Numbered] = {}
    counts: dict[str, int] = {}
    for entry in entries:
        if entry.event not in _EVENTS:
            continue
        try:
            _replay(entry.event, entry.data, found, counts)
        except (LookupError, TypeError, ValueError) as error:
            raise JournalBroken(
                f"Line {entry.seq + 1} of the ledger about a certificate does not follow from the lines before"
                f" ({error}): a number is missing, or given twice.",
                remedy="Ask who can write to the ledger. Restore it from a copy, or explain it:"
                " `starbench ledger --explain TEXT`.",
            ) from error
    return found


def _replay(event: str, data: Mapping[str, Any], found: dict[str, Numbered], counts: dict[str, int]) -> None:
    number = str(data["number"])
    if event in {RESERVED, LOST}:
        series, count = str(data["series"]), int(data["count"])
        again = found.get(number)
        if again is None and count != counts.get(series, 0) + 1:
            raise ValueError(f"{series} has no number {counts.get(series, 0) + 1}")
        if again is not None and (again.how, again.series, again.count) != ("reserved", series, count):
            raise ValueError(f"{number} is reserved twice")
        counts[series] = max(count, counts.get(series, 0))
        names = ("run_seal", "run_id", "folder", "issued_utc", "amends")
        how: How = "lost" if event == LOST else "reserved"
        found[number] = Numbered(number, series, count, how, *(str(data.get(name, "")) for name in names))
        return
    one = found[number]
    if one.how != "reserved":
        raise ValueError(f"{number} was {one.how} already")
    if event == VOIDED:
        found[number] = replace(one, how="void", reason=str(data["reason"]))
        return
    seal, serial, customer = (str(data[name]) for name in ("seal", "serial", "customer"))
    found[number] = replace(one, how="issued", seal=seal, serial=serial, customer=customer)
    if one.amends:
        found[one.amends] = replace(found[one.amends], superseded_by=number)


def open_numbers(found: Mapping[str, Numbered]) -> list[Numbered]:
    """Return the numbers that were reserved and neither issued nor declared void.

    Returns: The first reserved one first.
    """
    return [one for one in found.values() if one.how == "reserved"]
