"""Many sealed folders checked by workers: one piece of work each.

Only what was made again may be kept, which depends on the bytes of folder and program; the rest is checked each time.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

from bench.base.bounded_json import content_key
from bench.evidence.findings import Derivation, Findings, SealFault, Verification
from bench.evidence.folder_kinds import folder_kind
from bench.evidence.key_trust import Trust
from bench.evidence.verify import verify_folder
from bench.work.kept_rows import content_hash, require_program_of

VERIFIED = "verified.jsonl"
DERIVED_KINDS = frozenset({"run", "results"})
"""Kinds of folders whose files can be derived again."""


@dataclass(frozen=True)
class Check:
    """What is to be checked in every folder."""

    trust: Trust
    at: datetime | None  # Moment for which the keys must have been valid; None: when the folder was sealed
    camera_serial: str | None  # Serial number that the calibrated camera must have; None for any
    again: bool  # Whether to calibrate again from the recordings too
    program: str  # Hash of the program that hands out the work


@dataclass(frozen=True)
class Checked:
    """What one check found."""

    verification: Verification
    row: Mapping[str, Any] | None = None  # What was derived, to be kept (see `_derived`); None if nothing was
    before: bool = False  # Whether it is of an earlier command


def check_one(folder: Path, check: Check, known: Mapping[str, Any] | None) -> Checked:
    """Check one sealed folder without the bench's ledger; ``known`` is what an earlier command derived of it."""
    require_program_of(check.program)
    rows: list[Mapping[str, Any]] = []

    def derive(folder: Path) -> Findings:
        rows.append(_derived(folder, check, known))
        derived = rows[-1]["derived"]
        faults = [SealFault(**seal_fault) for seal_fault in derived["faults"]]
        return Findings(faults, *([*derived[name]] for name in ("not_compared", "not_confirmed", "remarks")))

    kind = folder_kind(folder)
    derivations: list[Derivation] = [derive] if kind.name in DERIVED_KINDS else []
    if kind.checks(None):
        derivations = [lambda _folder: Findings()]  # this bench makes them
    verification = verify_folder(
        folder,
        check.trust,
        at=check.at,
        camera_serial=check.camera_serial,
        derivations=derivations,
        again=check.again,
    )
    row = rows[0] if rows else None
    return Checked(verification, row, before=row is not None and row is known)


def _derived(folder: Path, check: Check, known: Mapping[str, Any] | None) -> Mapping[str, Any]:
    """Derive a folder's files again: the ``key`` of what decides it, and the findings; or ``known`` of the same key."""
    key = content_key({"folder": content_hash(folder), "again": check.again, "program": check.program})
    if known is not None and known["key"] == key:
        return known
    findings = Findings()
    findings.derive(folder, derivations_of(folder, again=check.again))
    return {"key": key, "derived": asdict(findings)}


def derivations_of(
    folder: Path, *, again: bool, progress: Callable[[int, int], None] | None = None
) -> list[Derivation]:
    """Return what compares the files of a run or of recalculated results, in order; ``again``: by the recordings.

    ``progress`` is told how many recordings or views of all have been measured again.
    """
    derivations: list[Derivation] = []
    if folder_kind(folder).name == "run":
        from bench.again.verdict import check_verdict

        derivations.append(check_verdict)
    if again:
        from bench.again.recalculated import check_recalculated
        from bench.again.run import check_run_again
        from bench.solve.offline import nothing_shown

        work = check_run_again if folder_kind(folder).name == "run" else check_recalculated
        derivations.append(partial(work, progress=progress or nothing_shown))
    return derivations
