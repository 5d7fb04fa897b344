"""What a verification finds: faults, parts that could not be compared, and remarks. Data only."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from datetime import datetime
from enum import StrEnum
from pathlib import Path
from typing import Any

from bench.base.encoding import printable_line
from bench.base.errors import BenchError
from calib.errors import CalibrationError
from drivers.errors import DriverError

UNREADABLE = (ValueError, LookupError, TypeError, AttributeError, ArithmeticError, RecursionError)
"""Exceptions raised by reading JSON that is not of the expected form."""


@dataclass(frozen=True)
class SealFault:
    """One fault of a sealed folder."""

    # ``unsealed``, ``signature``, ``key``, ``manifest``, ``added``, ``changed``, ``missing``, ``link``,
    # ``kind``, ``form``, ``journal``, ``plan``, ``results``, ``exports``, ``report``, ``views``, ``recording``,
    # ``instructions``, ``certificate``, ``ledger``, ``item``, ``authorisation`` or ``timestamp``.
    kind: str
    where: str
    what: str

    def __str__(self) -> str:
        return printable_line(f"{self.where}: {self.what}")


@dataclass
class Findings:
    """What one check found. A check that finds nothing returns an empty one."""

    faults: list[SealFault] = field(default_factory=list)
    # Parts that were to be compared and could not be, each with the reason, as a sentence without a full stop.
    not_compared: list[str] = field(default_factory=list)
    # What another version made and this one calculates otherwise: both numbers and how to install that version.
    not_confirmed: list[str] = field(default_factory=list)
    # What a reader should know, and what is no lack of the check.
    remarks: list[str] = field(default_factory=list)

    def fault(self, kind: str, where: str, what: str) -> None:
        """Add a fault."""
        self.faults.append(SealFault(kind, where, what))

    @contextmanager
    def unreadable(self, kind: str, where: str, what: str) -> Iterator[None]:
        """End the block with a fault where it cannot read content, or cannot calculate with it."""
        try:
            yield
        except (BenchError, CalibrationError, DriverError) as error:
            self.fault(kind, where, f"{what}: {error}")
        except UNREADABLE as error:
            self.fault(kind, where, f"{what} ({error if type(error) is ValueError else repr(error)})")

    def add(self, other: Findings) -> None:
        """Add everything that another check found."""
        self.faults += other.faults
        self.not_compared += other.not_compared
        self.not_confirmed += other.not_confirmed
        self.remarks += other.remarks

    def derive(self, folder: Path, checks: Iterable[Derivation]) -> None:
        """Make further checks of a folder, in order, each only while no check has found a fault."""
        for check in checks:
            if not self.faults:
                self.add(check(folder))


Derivation = Callable[[Path], Findings]
"""Derives parts of a sealed folder again and compares. It takes the folder, changes nothing in it, and returns what it
found. It is called only while no check has found a fault, so it may rely on the list of files and on the journal. What
it cannot read is a fault, never an exception; only StorageError and OSError may leave it."""


class State(StrEnum):
    """State of a folder as evidence; the value is the word that is shown."""

    DRAFT = "DRAFT"
    """Not sealed, or its seal does not hold."""
    SEALED = "SEALED"
    """Sealed by a bench; no person has authorised it."""
    AUTHORISED = "AUTHORISED"
    """Sealed, and authorised by a person with a trusted key."""


@dataclass
class Verification(Findings):
    """What the checks of one sealed folder found; without a fault, it is as a trusted bench sealed it."""

    folder: str = ""
    kind: str = ""  # ``run``, ``certificate``, ``results``, or ``files`` for any other folder
    # Whether the results were made again from the recordings, and the numbers compared (``verify --again``).
    again: bool = False
    # The state. ``SEALED`` needs a seal whose signature holds, ``AUTHORISED`` also a person's signature of
    # the seal that holds and is by a trusted key. Whether the bench's key is trusted is told by ``signer``
    # and ``faults``.
    state: State = State.DRAFT
    # Who authorised, and what the time stamps say: a sentence each, without a full stop.
    statements: list[str] = field(default_factory=list)
    # When the folder says that it was made, by the bench's own clock, UTC; None if it does not say.
    stated: datetime | None = None
    signer: str | None = None  # Of the bench in the list of trusted keys; None if its key is not accepted
    fingerprint: str | None = None  # Of its key
    person: str | None = None  # Who authorised; None if nobody did, or if it does not hold
    person_fingerprint: str | None = None  # Of that person's key
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
        """Whether no fault was found, and every part that was to be compared was compared and confirmed."""
        return self.ok and not self.not_compared and not self.not_confirmed

    def to_dict(self) -> dict[str, Any]:
        """Return the verification as JSON carries it: ``ok``, ``complete``, and all attributes."""
        own = {name: getattr(self, name) for name in ("ok", "complete", "folder", "kind", "faults", "again")}
        stated = self.stated.isoformat() if self.stated else None
        return {**own, **asdict(self), "stated": stated}
