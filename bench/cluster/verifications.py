"""Many sealed folders checked by workers: one piece of work each.

Seals, trust and files are checked each time. Only what was made again may be kept: it depends on nothing but the bytes
of the folder and the program, and takes most of the time.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

from bench.cluster.conversions import content_hash
from bench.cluster.kept_rows import content_key
from bench.cluster.program import require_program_of
from bench.evidence.faults import SealFault
from bench.evidence.findings import Derivation, Findings, Verification
from bench.evidence.key_trust import Trust
from bench.evidence.verify import verify_folder

VERIFIED = "verified.jsonl"


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
    key: str = ""  # Hash of what the derived findings depend on; empty if nothing was derived
    derived: Mapping[str, Any] | None = None
    before: bool = False  # Whether they are of an earlier command


def check_one(folder: Path, check: Check, known: Mapping[str, Any] | None) -> Checked:
    """Check one sealed folder on a worker.

    folder: The folder. The ledger of the bench is not compared here, because only the bench has it.
    known: Key and findings of an earlier command; None if there are none.
    Raises BenchError: If this worker runs another program, or the folder cannot be read.
    """
    require_program_of(check.program)
    made: list[Checked] = []
    derive = partial(_derive, check=check, known=known, made=made)
    found = verify_folder(
        folder,
        check.trust,
        at=check.at,
        camera_serial=check.camera_serial,
        derivations={"run": [derive], "results": [derive], "certificate": [lambda _folder: Findings()]},
        again=check.again,
    )
    last = made[-1] if made else Checked(found)
    return Checked(found, last.key, last.derived, last.before)


def _derive(folder: Path, *, check: Check, known: Mapping[str, Any] | None, made: list[Checked]) -> Findings:
    """Derive the files of a folder again, or take the findings of an earlier command about the same bytes."""
    key = content_key({"folder": content_hash(folder), "again": check.again, "program": check.program})
    before = known is not None and known["key"] == key
    if before and known is not None:
        derived = known["derived"]
    else:
        found = Findings()
        for derivation in derivations_of(folder, again=check.again):
            if not found.faults:
                found.add(derivation(folder))
        derived = asdict(found)
    made.append(Checked(Verification(str(folder)), key, derived, before))
    return Findings(
        [SealFault(**one) for one in derived["faults"]], [*derived["not_compared"]], [*derived["remarks"]]
    )


def derivations_of(folder: Path, *, again: bool) -> list[Derivation]:
    """Return what compares the files of a run, or of recalculated results, with each other and with their sources.

    again: Whether to make the results again from the recordings.
    Returns: In the order in which they are called.
    """
    from bench.evidence.instructions import kind_of

    found: list[Derivation] = []
    if kind_of(folder) == "run":
        from bench.results.recorded_with import check_recorded_with

        found.append(check_recorded_with)
    if again:
        from bench.results.again_recalculated import check_recalculated
        from bench.results.again_run import check_run_again

        found.append(check_run_again if kind_of(folder) == "run" else check_recalculated)
    return found
