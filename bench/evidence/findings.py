"""What a verification finds: faults, parts that could not be compared, and remarks. Data only."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

# One fault of a sealed folder, as every check of evidence reports it.


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
        """Add a fault.

        kind, where, what: As the attributes of `SealFault`.
        """
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
        """Return the verification as JSON carries it.

        Returns: ``ok``, ``complete``, and all attributes.
        """
        own = asdict(self)
        return {"ok": self.ok, "complete": self.complete, **own}
