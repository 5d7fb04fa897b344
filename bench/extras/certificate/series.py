"""The series of certificate numbers, kept in the laboratory's ledger: without gaps, each number given once.

A number is reserved before a certificate is made, and issued when its folder has its final name. One that was left open
goes to the next certificate of the same run, or a person declares it void. Nothing is removed from the ledger.
"""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any, Literal

from bench.base.errors import EvidenceError, JournalBroken
from bench.base.pasteable import pasteable
from bench.record.journal import Journal
from bench.record.journal_line import Entry
from bench.record.ledger import Ledger
from bench.record.ledger_marks import highest_counts
from bench.record.storage import make_folder, storage_errors
from drivers import file_lock

SIMULATED = "SIMULATED-"
"""Begin of the number of a certificate of simulated devices; these have a series of their own."""
_PLAIN = r"(?:[A-Za-z0-9._/-]|\{year\}|\{head\})*"
_FORMAT = re.compile(rf"(?P<before>{_PLAIN})\{{number(?::0(?P<digits>[1-9])d)?\}}(?P<after>{_PLAIN})")
_HEAD_DIGITS = 4
"""Of two numbers with the same count, one in 65,536 pairs has the same text."""
_LOST_HEAD = "lost"
RESERVED = "certificate_reserved"
ISSUED = "certificate_issued"
VOIDED = "certificate_voided"
LOST = "certificate_lost"
_EVENTS = frozenset({RESERVED, ISSUED, VOIDED, LOST})

How = Literal["reserved", "issued", "void", "lost"]

LOCK = "certificates.lock"
_CLOCK_SLACK = timedelta(seconds=2)  # A time server sets a clock back by less


def is_number_format(text: str) -> bool:
    """Return whether a text is the format of a series of numbers.

    It has ``{number}`` or ``{number:05d}`` exactly once and otherwise only plain characters, ``{year}`` and ``{head}``.

    >>> [is_number_format(text) for text in ("SB-{year}-{number:05d}-{head}", "SB", "{number.__class__}")]
    [True, False, False]
    """
    return _FORMAT.fullmatch(text) is not None


def number_of(text: str, *, year: int, number: int, head: str = _LOST_HEAD) -> str:
    """Return a number, from 1, of a series in its format.

    ``head`` is part of the hash of its place in the ledger: it differs if a count is given twice, by a ledger that was
    restored from an older copy.

    >>> number_of("SB-{year}-{number:05d}-{head}", year=2026, number=17, head="4f1c")
    'SB-2026-00017-4f1c'
    """
    match = _matched(text)
    before, after = (
        match[name].replace("{year}", str(year)).replace("{head}", head) for name in ("before", "after")
    )
    return f"{before}{number:0{match['digits'] or 1}d}{after}"


def _matched(text: str) -> re.Match[str]:
    match = _FORMAT.fullmatch(text)
    if match is None:
        raise ValueError(text)
    return match


def series_of(text: str, *, year: int, simulated: bool) -> str:
    """Return the name of a series: numbers count from 1 in each, and in each year if the format names the year.

    >>> series_of("SB-{year}-{number:05d}", year=2026, simulated=True)
    'SIMULATED-SB-2026-{number:05d}'
    """
    return (SIMULATED if simulated else "") + text.replace("{year}", str(year))


def number_pattern(text: str) -> re.Pattern[str]:
    """Return what a number of a series looks like, in any year: it may be used in the year after its reservation.

    >>> number_pattern("SB-{year}-{number:05d}").fullmatch("SB-2026-00017")["count"]
    '00017'
    """
    match = _matched(text)
    before, after = (
        re.escape(match[name])
        .replace(re.escape("{year}"), "[0-9]{4}")
        .replace(re.escape("{head}"), f"[0-9a-f]{{{_HEAD_DIGITS}}}")
        for name in ("before", "after")
    )
    return re.compile(f"{before}(?P<count>[0-9]{{{match['digits'] or 1},9}}){after}")


@dataclass(frozen=True)
class Numbered:
    """A number of a series, and what became of it."""

    number: str  # As printed
    series: str  # Of the number
    count: int  # In its series, from 1
    how: How  # ``reserved``, ``issued``, ``void`` or ``lost``
    run_seal: str  # SHA-256 of the run's SHA256SUMS
    run_id: str  # Name of the run
    folder: str
    issued_utc: str
    amends: str = ""  # Number of the certificate that it replaces; empty if none
    superseded_by: str = ""  # Number of the certificate that replaces it; empty if none does
    seal: str = ""  # SHA-256 of the certificate's SHA256SUMS; empty before it is issued
    serial: str = ""  # Of the camera; empty before it is issued
    customer: str = ""  # Name; empty before it is issued
    reason: str = ""  # Why it is void; else empty

    @property
    def is_newest(self) -> bool:
        """Whether it is issued and nothing replaces it."""
        return self.how == "issued" and not self.superseded_by


def numbers(entries: Iterable[Entry]) -> dict[str, Numbered]:
    """Return all numbers of all series, in the order of the reservations."""
    by_number: dict[str, Numbered] = {}
    counts: dict[str, int] = {}
    for entry in entries:
        if entry.event not in _EVENTS:
            continue
        try:
            _replay(entry.event, entry.data, by_number, counts)
        except (LookupError, TypeError, ValueError) as error:
            raise JournalBroken(
                f"Line {entry.seq + 1} of the ledger about a certificate does not follow from the lines before"
                f" ({error}): a number is missing, or given twice.",
                remedy="Ask who can write to the ledger. Restore it from a copy, or explain it:"
                " `starbench ledger --explain TEXT`.",
            ) from error
    return by_number


def _replay(
    event: str, data: Mapping[str, Any], by_number: dict[str, Numbered], counts: dict[str, int]
) -> None:
    number = str(data["number"])
    if event in {RESERVED, LOST}:
        series, count = str(data["series"]), int(data["count"])
        again = by_number.get(number)
        if again is None and count != counts.get(series, 0) + 1:
            raise ValueError(f"{series} has no number {counts.get(series, 0) + 1}")
        if again is not None and (again.how, again.series, again.count) != ("reserved", series, count):
            raise ValueError(f"{number} is reserved twice")
        counts[series] = max(count, counts.get(series, 0))
        names = ("run_seal", "run_id", "folder", "issued_utc", "amends")
        how: How = "lost" if event == LOST else "reserved"
        by_number[number] = Numbered(number, series, count, how, *(str(data.get(name, "")) for name in names))
        return
    entered = by_number[number]
    if entered.how != "reserved":
        raise ValueError(f"{number} was {entered.how} already")
    if event == VOIDED:
        by_number[number] = replace(entered, how="void", reason=str(data["reason"]))
        return
    seal, serial, customer = (str(data[name]) for name in ("seal", "serial", "customer"))
    by_number[number] = replace(entered, how="issued", seal=seal, serial=serial, customer=customer)
    if entered.amends:
        by_number[entered.amends] = replace(by_number[entered.amends], superseded_by=number)


def open_numbers(by_number: Mapping[str, Numbered]) -> list[Numbered]:
    """Return the numbers that were reserved and neither issued nor declared void, in the order of reservation."""
    return [entered for entered in by_number.values() if entered.how == "reserved"]


@dataclass(frozen=True)
class Wanted:
    """For what a number is wanted."""

    number_format: str
    simulated: bool  # Whether devices were simulated: these certificates have a series of their own
    run_seal: str
    run_id: str
    folder: str
    amends: str = ""  # Number of the certificate that it replaces; empty if none
    also: str = ""  # Why a second certificate of the run is issued; empty: a second one is refused
    ended_utc: str = ""  # When the calibration ended
    # Returns the highest count of a series that certificates outside of the ledger have.
    count_beside: Callable[[str], int] = lambda _series: 0


@contextmanager
def one_at_a_time(home: Path) -> Iterator[None]:
    """Let one process at a time issue certificates. So an open number belongs to a process that has ended."""
    make_folder(home)
    with storage_errors(home / LOCK):
        lock = os.open(home / LOCK, os.O_RDWR | os.O_CREAT, 0o600)
    try:
        file_lock.lock(lock, wait=True)
        yield
    finally:
        os.close(lock)


def reserve(ledger: Ledger, wanted: Wanted, now: datetime) -> Numbered:
    """Reserve the next number on the disk, or take the open one of the run; lost ones before it are entered as lost.

    Raises `EvidenceError` if the clock was set back, another number is open, the run has a certificate already, or what
    is to be amended is not the newest one.
    """
    with ledger.locked() as journal:
        by_number = numbers(journal.entries)
        _refuse_clock(journal.entries, now, ledger.path)
        if f"{now:%Y-%m-%dT%H:%M:%SZ}" < wanted.ended_utc:  # the run may be of another bench
            raise EvidenceError(
                f"The computer's clock says {now:%Y-%m-%d %H:%M:%S} UTC, but the calibration ended on"
                f" {wanted.ended_utc[:19].replace('T', ' ')}.",
                remedy="Set the clock.",
            )
        own = _own_open_number(by_number, wanted)
        if wanted.amends:
            refuse_old(by_number, wanted.amends)
        else:
            refuse_second(by_number, wanted.run_seal, wanted.also)
        place = (own.number, own.series, own.count) if own else _next(ledger, journal, by_number, wanted, now)
        return _enter(journal, wanted, now, *place)


def _next(
    ledger: Ledger, journal: Journal, by_number: Mapping[str, Numbered], wanted: Wanted, now: datetime
) -> tuple[str, str, int]:
    """Return the next number, its series and count; enter as lost those that were given and are not in the ledger."""
    series = series_of(wanted.number_format, year=now.year, simulated=wanted.simulated)
    last = sum(entered.series == series for entered in by_number.values())
    # A break of the ledger states what its mark knows of lines that were lost.
    in_breaks = highest_counts(journal.entries).get(series, 0)
    highest = max(in_breaks, wanted.count_beside(series))
    for count in range(last + 1, highest + 1):
        lost = number_of(series, year=now.year, number=count)
        journal.append(LOST, number=lost, series=series, count=count)
    count = max(last, highest) + 1
    place = f"{journal.head} {wanted.run_seal} {now.isoformat()}"
    head = hashlib.sha256(place.encode()).hexdigest()[:_HEAD_DIGITS]
    number = number_of(series, year=now.year, number=count, head=head)
    if number in by_number:
        raise EvidenceError(
            f"The number {number} was given already, in the series {by_number[number].series}.",
            where=str(ledger.path),
            remedy="Give numbers.format of lab.yaml another text.",
        )
    return number, series, count


def _enter(journal: Journal, wanted: Wanted, now: datetime, number: str, series: str, count: int) -> Numbered:
    texts = {
        "run_seal": wanted.run_seal,
        "run_id": wanted.run_id,
        "folder": wanted.folder,
        "issued_utc": f"{now:%Y-%m-%dT%H:%M:%SZ}",
        "amends": wanted.amends,
    }
    journal.append(RESERVED, number=number, series=series, count=count, **texts)
    return Numbered(number, series, count, "reserved", **texts)


def _own_open_number(by_number: Mapping[str, Numbered], wanted: Wanted) -> Numbered | None:
    """Return the open number of the same run and purpose; refuse while another one is open."""
    for own_open_number in open_numbers(by_number):
        if (own_open_number.run_seal, own_open_number.amends) == (wanted.run_seal, wanted.amends):
            year = int(own_open_number.issued_utc[:4])
            if own_open_number.series == series_of(
                wanted.number_format, year=year, simulated=wanted.simulated
            ):
                return own_open_number
        raise EvidenceError(
            f"The certificate number {own_open_number.number} was reserved for the run {own_open_number.run_id} on"
            f" {own_open_number.issued_utc[:16]}, and was not issued: that command was stopped or failed.",
            where=own_open_number.folder,
            remedy="Issue the certificate of that run with the same numbers.format, which takes this number, or"
            f" declare it void:"
            f" `{pasteable('certificate', 'void', own_open_number.number, '--reason', 'TEXT')}`.",
        )
    return None


def refuse_second(by_number: Mapping[str, Numbered], run_seal: str, also: str) -> None:
    """Refuse a second certificate of a run without the reason ``also``, and a first one with it."""
    first = next(
        (entered for entered in by_number.values() if entered.run_seal == run_seal and entered.is_newest),
        None,
    )
    if first is None and also:
        raise EvidenceError("The run has no certificate yet.", remedy="Leave out --reason.")
    if first is not None and not also:
        raise EvidenceError(
            f"The run has a certificate already: {first.number} of {first.issued_utc[:10]}.",
            where=first.folder,
            remedy=f"To amend it: {amending(first.folder)}. If a second one is needed, give its reason, which is"
            " printed: --reason TEXT.",
        )


def refuse_old(by_number: Mapping[str, Numbered], number: str) -> None:
    """Refuse to amend a certificate that is unknown, void or superseded."""
    old = by_number.get(number)
    if old is not None and old.is_newest:
        return
    what = "it is not in the ledger of this bench" if old is None else f"it is {old.how}"
    remedy = "Only the newest certificate can be amended, on the bench that issued it."
    if old is not None and old.superseded_by:
        what, remedy = f"{old.superseded_by} replaced it", f"Amend {_newest(by_number, old).number}."
    raise EvidenceError(f"Certificate {number} cannot be amended: {what}.", remedy=remedy)


def _newest(by_number: Mapping[str, Numbered], entered: Numbered) -> Numbered:
    while entered.superseded_by:
        entered = by_number[entered.superseded_by]
    return entered


def _refuse_clock(entries: Sequence[Entry], now: datetime, path: Path) -> None:
    """Refuse a time of issue before the last line of the ledger, so that numbers and times have one order."""
    if entries and now < (last := datetime.fromisoformat(entries[-1].utc)) - _CLOCK_SLACK:
        raise EvidenceError(
            f"The computer's clock was set back: it is {now:%Y-%m-%d %H:%M:%S} UTC, but the last line of the ledger"
            f" is of {last:%Y-%m-%d %H:%M:%S} UTC.",
            where=str(path),
            remedy="Set the clock. A certificate must not be older than the one before.",
        )


def enter_issued(ledger: Ledger, number: str, *, seal: str, serial: str, customer: str) -> None:
    """Enter that a certificate is issued: its sealed folder has its final name, and ``seal`` its SHA256SUMS."""
    with ledger.locked() as journal:
        journal.append(ISSUED, number=number, seal=seal, serial=serial, customer=customer)


def amending(folder: str) -> str:
    """Return the command that amends the certificate of a folder."""
    return f"`{pasteable('certificate', 'issue', folder)} --config LAB.YAML --output NEW --reason TEXT`"


def declare_void(ledger: Ledger, number: str, *, reason: str, by: str) -> Numbered:
    """Declare void a number that was reserved and not issued."""
    with ledger.locked() as journal:
        entered = numbers(journal.entries).get(number)
        if entered is None or entered.how != "reserved":
            state = "is not in the ledger" if entered is None else f"is {entered.how} already"
            remedy = "Only a number that was reserved and not issued can be void."
            if entered is not None and entered.how == "issued":
                remedy += f" To replace the certificate: {amending(entered.folder)}."
            raise EvidenceError(f"The number {number} {state}.", where=str(ledger.path), remedy=remedy)
        journal.append(VOIDED, number=number, reason=reason, by=by)
        return replace(entered, how="void", reason=reason)
