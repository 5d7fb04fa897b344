"""The entry of a run in the bench's ledger: made before the run does anything, completed however it ends.

A break of the ledger is printed, journaled and reported. It stops a run only where the station says
``ledger: strict``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from bench.base.clock import BenchClock
from bench.base.errors import BenchError, RunFolderError
from bench.base.home import home_folder
from bench.base.pasteable import pasteable
from bench.evidence.ledger_check import sealed_strangers
from bench.plan.job import Job
from bench.record.events import LedgerPlace
from bench.record.ledger import Ledger
from bench.record.ledger_marks import EXPLAIN
from bench.record.run_folder import is_sealed
from bench.record.run_index import RunIndex
from bench.record.run_verdict import run_verdict
from bench.run.runner import RunEnd

_NO_SECOND_PLACE = (
    "ledger.anchor of the station file is not used any more: keep the head of the ledger, which each report and message"
    " prints, in another place"
)


def ledger_of(clock: BenchClock) -> Ledger:
    """Return the ledger of this bench; its file may not exist."""
    return Ledger(home_folder(), clock)


def refuse_broken_ledger(ledger: Ledger, job: Job) -> None:
    """Refuse a run if its station is strict and the ledger has a break that nobody has explained."""
    if job.station.ledger.strict:
        ledger.refuse_break(sealed_strangers(ledger.home))


def enter_in_ledger(ledger: Ledger, job: Job, folder: Path, known: LedgerPlace | None = None) -> LedgerPlace:
    """Enter a run in the ledger if it is not there at ``known``, as where it began on another bench."""
    station = job.station
    strangers = sealed_strangers(ledger.home)
    if known and (run := ledger.entered(known)):
        if run.seal and is_sealed(Path(run.folder)):
            raise RunFolderError(
                "This run is finished and sealed in another folder.",
                where=str(folder),
                remedy=f"A run has one end. To check it: {pasteable('verify', run.folder)}",
            )
        refuse_broken_ledger(ledger, job)
        faults, _ = ledger.breaks(strangers)
        place = LedgerPlace(number=known["number"], head=known["head"], of_camera=known["of_camera"])
        if faults:
            place["faults"] = [f"{fault} {EXPLAIN}" for fault in faults]
    else:
        place = ledger.begin(
            run_id=folder.name,
            folder=folder,
            camera=station.camera.serial,
            simulated=job.simulated,
            strict=station.ledger.strict,
            strangers=strangers,
        )
    if station.ledger.anchor:
        ledger.warnings.append(_NO_SECOND_PLACE)
    if ledger.warnings:
        place["warnings"] = list(ledger.warnings)
    return place


def ledger_lines(place: LedgerPlace) -> list[str]:
    """Return lines that the operator must know about the ledger before a run begins; usually none."""
    faults = [f"FAULT OF THE LEDGER: {fault}" for fault in place.get("faults", ())]
    return faults + [f"WARNING: {warning}" for warning in place.get("warnings", ())]


@contextmanager
def ledger_entry(ledger: Ledger, place: LedgerPlace, folder: Path) -> Iterator[Callable[[RunEnd], RunEnd]]:
    """Write to the ledger how the run of the block ended, and its verdict; "failed" if the block raises."""
    how, verdict = "failed", None

    def ending(end: RunEnd) -> RunEnd:
        nonlocal how, verdict
        how = end.how
        verdict = run_verdict(end.outcome.results) if end.outcome else None
        return end

    try:
        yield ending
    finally:
        ledger.end(place["number"], how=how, folder=folder, verdict=verdict)
        with suppress(BenchError):  # the index is made from journals: it can be made again
            RunIndex(ledger.home).runs([folder])
