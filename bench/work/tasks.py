"""What workers do to calibrate a run again: find the stars of one recording, then calibrate from all of them.

The result is that of `bench.solve.offline.calibrate_paths` in one process, to the last digit. Only views are written.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Literal, TypedDict

from bench.base.bounded_json import content_key
from bench.base.errors import BenchError
from bench.base.failure import FORESEEN
from bench.measure.kept_views import KeptViews
from bench.record.run_folder import JOURNAL, PASSPORT_COPY, RESULTS, SEQUENCE_COPY, STATION_COPY
from bench.record.storage import sha256_of, storage_errors
from bench.record.stored_run import StoredRun
from bench.solve.offline import OfflineResult, calibrate_sources, with_kept_views
from bench.solve.offline_folder import SealedBy, offline_files
from bench.solve.offline_options import OfflineOptions
from bench.solve.sources import options_data
from bench.solve.view_sources import ViewSource, view_sources
from bench.work.kept_rows import require_program_of
from bench.work.places import Place
from calib.errors import CalibrationError
from calib.view import View
from drivers.camera.raw_check import require_regular, require_whole

ROW_FORMAT = "starbench/recalibration/1"
_READ = (JOURNAL, SEQUENCE_COPY, STATION_COPY, PASSPORT_COPY)
"""Files of a run, besides its recordings, that decide its calibration. The journal states the recordings' hashes."""


@dataclass(frozen=True)
class Task:
    """What all pieces of work of one recalculation have in common."""

    choices: OfflineOptions
    program: str  # Hash of the program that hands out the work; a worker with another program refuses it
    # Folder for kept views on the workers; None for that of the worker's user, empty for none.
    kept: str | None = None

    def views(self) -> KeptViews | None:
        """Return the kept views of this worker; None if none are used."""
        if self.kept is None:
            return KeptViews.of_bench()
        return KeptViews(Path(self.kept)) if self.kept else None


@dataclass(frozen=True)
class Listed:
    """The recordings of a place."""

    captures: Sequence[str]  # Their names within the folder, in the order of the views
    key: str  # Hash of all that decides the calibration: the recordings, the program, the options


@dataclass(frozen=True)
class FoundView:
    """What a recording showed."""

    view: View | None  # The stars; None if it is left out
    size_bytes: int  # Of the recording
    sha256: str  # Of the recording
    why: tuple[str, str, str] = ("", "", "")  # What is wrong, where, and the remedy, if it is left out
    remarks: Sequence[str] = ()
    kept: bool = False  # Whether the view was kept from an earlier calculation


class BeforeData(TypedDict):
    """What the run's own results state."""

    values: Mapping[str, float]
    sigma: Mapping[str, float]


class CalibratedData(TypedDict):
    """What the table states about a calibration; U of a value is its k times its ``sigma``."""

    model: str
    views: int
    stars: int  # Or points of a board
    board: str | None
    values: Mapping[str, float]
    sigma: Mapping[str, float]
    coverage_factor: float
    coverage_factors: Mapping[str, float]
    rms_px: float
    converged: bool
    notes: Sequence[str]
    left_out: Sequence[str]
    before: BeforeData | None
    results_sha256: str | None  # None if no folder is written


class DoneRow(CalibratedData):
    """Row of a run that was calibrated."""

    schema: str
    folder: str
    state: Literal["done"]
    key: str
    results: str | None  # Name of the folder of its results; None if none is written


class SkippedRow(DoneRow):
    """Row of a run that was done before, as it is told; the table does not state it."""

    skipped: Literal[True]


class FailedRow(TypedDict):
    """Row of a run that could not be calibrated."""

    schema: str
    folder: str
    state: Literal["failed"]
    key: str  # Empty if its recordings could not be listed
    results: None
    results_sha256: None
    failure: Mapping[str, str]  # A `Failure` by field


RunRow = DoneRow | FailedRow


@dataclass(frozen=True)
class Recalculated:
    """A calibration as files, and its row in the table."""

    files: Mapping[str, bytes]  # Contents by name within the folder; empty if no folder is written
    row: CalibratedData


def list_recordings(place: Place, task: Task) -> Listed:
    """Return the recordings of a place that have a view each, and the key of its calibration."""
    with place.folder(only=_READ) as folder:
        sources = list(view_sources(folder, task.choices))
        names = [source.path.relative_to(folder).as_posix() for source in sources]
        if (folder / JOURNAL).is_file():
            content = {name: sha256_of(folder / name) for name in _READ if (folder / name).is_file()}
        else:
            content = {name: _hash_of(folder / name) for name in names}
    return Listed(names, calibration_key(content, task))


def calibration_key(content: Mapping[str, str], task: Task) -> str:
    """Return the hash of all that decides a calibration, among it the SHA-256 of its files by name."""
    choices = task.choices
    passport = None if choices.passport is None else hashlib.sha256(choices.passport.data).hexdigest()
    options = {**options_data(choices), "target": asdict(choices.target), "passport_sha256": passport}
    options["station_sha256"] = None if choices.station is None else choices.station.sha256
    return content_key(
        {"format": ROW_FORMAT, "content": content, "options": options, "program": task.program}
    )


def find_view(place: Place, number: int, capture: str, task: Task) -> FoundView:
    """Find the stars of one recording, whose view has this number from 0."""
    require_program_of(task.program)
    kept = task.views()
    with place.folder(capture, only=_READ) as folder, _named(place, folder):
        source = list(view_sources(folder, task.choices))[number]
        size, digest = _require_recorded(source)
        if kept is not None:
            source = with_kept_views(source, kept)
        try:
            view = source.read()
        except CalibrationError as error:
            where = place.renamed(error.where or str(source.path), folder)
            return FoundView(None, size, digest, (place.renamed(error.what, folder), where, error.remedy))
    if kept is None:
        return FoundView(view, size, digest)
    return FoundView(view, size, digest, remarks=tuple(kept.remarks), kept=bool(kept.used))


def calibrate_found(
    place: Place,
    views_read: Sequence[FoundView],
    name: str,
    sealed_by: SealedBy | None,
    task: Task,
    files: bool,
) -> Recalculated:
    """Calibrate from the views of a place; ``files``: the files of the results are made too, which takes longer."""
    require_program_of(task.program)
    with place.folder() as folder, _named(place, folder):
        listed = list(view_sources(folder, task.choices))
        sources = [
            replace(source, read=partial(_given, view_read))
            for source, view_read in zip(listed, views_read, strict=True)
        ]
        result = replace(calibrate_sources(sources, task.choices), paths=(folder,))
        read = {id(source): view_read for source, view_read in zip(sources, views_read, strict=True)}
        made = {}
        if files:
            of_views = [read[id(source)] for source in result.sources]
            made = _files(place, folder, result, of_views, name, sealed_by)
        return Recalculated(made, _row(place, folder, result, made))


def _files(
    place: Place,
    folder: Path,
    result: OfflineResult,
    views_read: Sequence[FoundView],
    name: str,
    sealed_by: SealedBy | None,
) -> dict[str, bytes]:
    """Return the files of the results; sources behind a URL are named by it."""
    sources = [
        {
            "view": view.name,
            "path": str(source.path.absolute()),
            "size_bytes": view_read.size_bytes,
            "sha256": view_read.sha256,
        }
        for source, view, view_read in zip(result.sources, result.views, views_read, strict=True)
    ]
    copies = {str(folder.resolve()): place.name, str(folder): place.name} if place.is_remote else {}
    return offline_files(result, name, sealed_by, sources=sources, read_from=copies)


@contextmanager
def _named(place: Place, folder: Path) -> Iterator[None]:
    """Errors of the block name the place instead of its copy."""
    try:
        yield
    except FORESEEN as error:
        if not place.is_remote:
            raise
        placed = partial(place.renamed, folder=folder)
        raise BenchError(
            placed(error.what), where=placed(error.where), remedy=placed(error.remedy)
        ) from error


def _hash_of(recording: Path) -> str:
    """Return the hash of a recording; refuse a device, which never ends, and gigabytes that were never written."""
    require_regular(recording)
    require_whole(recording)
    return sha256_of(recording)


def _require_recorded(source: ViewSource) -> tuple[int, str]:
    """Return size and hash of a recording; refuse one of a run that is not the one that its journal names."""
    with storage_errors(source.path):
        size, digest = source.path.stat().st_size, _hash_of(source.path)
    if source.attempt is not None and digest != source.attempt.stored["sha256"]:
        raise BenchError(
            "The recording is not the one that the run made: its hash differs from that in the journal.",
            where=str(source.path),
            remedy="Copy it again from its origin.",
        )
    return size, digest


def _given(view_read: FoundView) -> View:
    if view_read.view is None:
        what, where, remedy = view_read.why
        raise CalibrationError(what, where=where, remedy=remedy)
    return view_read.view


def _row(place: Place, folder: Path, result: OfflineResult, files: Mapping[str, bytes]) -> CalibratedData:
    """Return what the table states about a calibration."""
    solved = result.calibration
    before = _before(folder)
    return {
        "model": solved.model,
        "views": len(solved.views),
        "stars": sum(view.n for view in solved.views),
        "board": None if result.board is None else str(result.board),
        "values": dict(solved.values),
        "sigma": dict(solved.sigma),
        "coverage_factor": solved.coverage_factor,
        "coverage_factors": dict(solved.coverage_factors),
        "rms_px": solved.rms_px,
        "converged": solved.converged,
        "notes": list(solved.notes),
        "left_out": [place.renamed(why, folder) for why in result.skipped],
        "before": before,
        "results_sha256": hashlib.sha256(files[RESULTS]).hexdigest() if files else None,
    }


def _before(folder: Path) -> BeforeData | None:
    """Return values and sigmas of the run's own results; None if there are none."""
    try:
        stored = StoredRun(folder).results_as_written["calibration"]
        values = {**stored["camera"], **(stored["collimator"] or {})}
        sigma = {name: float(number) for name, number in stored["sigma"].items()}
        return {"values": {name: float(values[name]) for name in sigma}, "sigma": sigma}
    except (BenchError, ValueError, KeyError, TypeError):
        return None
