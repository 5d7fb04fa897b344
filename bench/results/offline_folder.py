"""Writes an offline calibration to a folder: results, report, stars, exports, hashes of its inputs, seal.

The results have the schema of a run's, as far as files without devices can give it. The run is marked ``offline``, and
a sentence says that it is a recalculation. The seal covers the hashes of the input files and of the seals of the runs
that they are from. Without a key the folder is a draft.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from bench.base.errors import UsageError
from bench.evidence.keys import BenchKey
from bench.evidence.seal import seal_folder
from bench.plan.job import Job
from bench.records.history import replay
from bench.records.journal import read_journal
from bench.records.run_folder import JOURNAL, MANIFEST, PASSPORT_COPY, REPORT, RESULTS, is_sealed
from bench.records.storage import make_folder, sha256_of, storage_errors, write_atomic
from bench.report.html import ReportData, render_report
from bench.report.view_picture import ViewPicture
from bench.results.exports import exports
from bench.results.offline import OfflineResult
from bench.results.projection_facts import projection_facts
from bench.results.results_content import collimator_data, software, target_data
from bench.results.stored_options import options_data
from bench.results.view_sources import PHOTOGRAPHS, ViewSource
from bench.views.views_file import VIEWS, views_file
from calib.view import View

SOURCES = "sources.json"
SCHEMA = "starbench/sources/1"
RECALCULATION = (
    "These results are a recalculation: they were calculated from existing files, without devices, and are not the"
    " record of a run."
)
"""What results.json states about results that were not calculated by a run."""


@dataclass(frozen=True)
class _Stars:
    """A view without its image, as `bench.views.views_file.views_file` takes it."""

    view: View
    image: None = None


def require_new(folder: Path) -> None:
    """Refuse a folder that holds anything.

    Parameters
    ----------
    folder
        The folder to write to.

    Raises
    ------
    UsageError
        If it is not empty.
    StorageError
        If it cannot be read.
    """
    with storage_errors(folder):
        found = next(folder.iterdir(), None) if folder.is_dir() else None
    if found is not None:
        raise UsageError(
            f"The folder is not empty: it contains {found.name}.",
            where=str(folder),
            remedy="Choose a new folder; results are never overwritten.",
        )


def write_offline_results(result: OfflineResult, folder: Path, key: BenchKey | None = None) -> None:
    """Write an offline calibration to a new folder, and seal it.

    Parameters
    ----------
    result
        The calibration and its views.
    folder
        The folder; it is made if it does not exist. ``results.json`` is written last, before the seal.
    key
        The bench's key; None leaves the folder a draft.

    Raises
    ------
    UsageError
        If the folder is not empty.
    EvidenceError
        If the folder cannot be sealed.
    StorageError
        If a file cannot be read or written.
    """
    require_new(folder)
    sources = [
        source_data(source, view.name) for source, view in zip(result.sources, result.views, strict=True)
    ]
    results = offline_results(result, folder.resolve().name, sources, key)
    runs = results["run"]["of_runs"]
    make_folder(folder / "exports")
    camera_name = _camera_name(result)
    target = asdict(result.target) if result.target is not None else None
    described = {
        "camera_name": camera_name,
        "target": target,
        "paths": [str(path.absolute()) for path in result.paths],
        "options": options_data(result.choices),
        "option_target": asdict(result.choices.target),
    }
    write_atomic(
        folder / SOURCES, _json_bytes({"schema": SCHEMA, "runs": runs, "sources": sources, **described})
    )
    stars = [_Stars(view) for view in result.views]
    write_atomic(folder / VIEWS, views_file(stars, result.calibration.residuals_px))
    if result.passport is not None:
        write_atomic(folder / PASSPORT_COPY, result.passport.data)
    written = exports(result.calibration, camera_name=camera_name, target=result.target)
    for name, data in written.items():
        write_atomic(folder / "exports" / name, data)
    html = render_report(ReportData(results, _pictures(result)))
    write_atomic(folder / REPORT, html.encode())
    write_atomic(folder / RESULTS, _json_bytes(results))
    if key is not None:
        seal_folder(folder, key)


def offline_results(
    result: OfflineResult, name: str, sources: Sequence[dict[str, Any]], key: BenchKey | None = None
) -> dict[str, Any]:
    """Return the content of results.json of an offline calibration.

    Parameters
    ----------
    result
        The calibration and its views.
    name
        Name of the calibration, as the report prints it.
    sources
        Path, size and hash of each input file.
    key
        The bench's key that will seal the folder; None if it stays a draft.

    Returns
    -------
    dict
        The schema of a run's results; ``run.offline`` is true, and there are no devices, gates and states.
    """
    calibration = result.calibration
    return {
        "schema": "starbench/results/1",
        "run": _run_facts(result, name, key),
        "devices": {},
        "calibration": calibration.to_dict(),
        "projection": projection_facts(
            calibration.camera,
            calibration.camera_covariance,
            calibration.coverage_factor,
            [view.points_px for view in result.views],
        ),
        "planar": result.planar.to_dict() if result.planar else None,
        "passport": result.passport.to_dict() if result.passport else None,
        "gimbal_readings": result.readings,
        "poses": _pose_rows(result),
        "gates": [],
        "deviations": [f"Left out: {why}" for why in result.skipped],
        "sources": list(sources),
        "truth": None,
        "comparison": [],
    }


def _run_facts(result: OfflineResult, name: str, key: BenchKey | None) -> dict[str, Any]:
    """Return what results.json states about the origin of a recalculation."""
    jobs = _jobs(result)
    job = jobs[0] if len(jobs) == 1 else None
    started = _started(result.sources[0]) if job is not None else {}
    now = datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
    frames = all(
        source.path.suffix.lower() in PHOTOGRAPHS or (source.job and source.job.camera_kind.name == "frame")
        for source in result.sources
    )
    return {
        "id": name,
        "offline": True,
        "statement": RECALCULATION,
        "sealed_by": {"principal": key.principal, "fingerprint": key.fingerprint} if key else None,
        "of_runs": _runs(result),
        "calibrated_utc": now,
        "of_run": started.get("id"),
        "sequence": started.get("sequence"),
        "station": started.get("station"),
        "operator": started.get("operator"),
        "laboratory": job.laboratory if job else None,
        "collimator": collimator_data(job) if job else None,
        **({"target": stated} if job and (stated := target_data(job)) else {}),
        "simulated": any(one.simulated for one in jobs),
        "camera": "frame" if frames else "event",
        "software": software(),
    }


def _pose_rows(result: OfflineResult) -> list[dict[str, Any]]:
    """Return what results.json states about each pose."""
    return [
        {
            "index": index,
            "name": view.name,
            "commanded_deg": source.attempt.stored["commanded_deg"] if source.attempt else None,
            "measured_deg": source.attempt.stored["measured_deg"] if source.attempt else None,
            "stars": view.n,
            "rms_px": view.rms_px,
            "mean_px": view.mean_px,
        }
        for index, (view, source) in enumerate(zip(result.calibration.views, result.sources, strict=True), 1)
    ]


def _jobs(result: OfflineResult) -> list[Job]:
    """Return the tasks of the runs that the views are from, each once."""
    return list({id(source.job): source.job for source in result.sources if source.job}.values())


def _started(source: ViewSource) -> dict[str, Any]:
    """Return the first line of the journal of the run that a recording is from."""
    entries, _ = read_journal(source.path.resolve().parent.parent / JOURNAL)
    return dict(replay(entries).started)


def source_data(source: ViewSource, view: str) -> dict[str, Any]:
    """Return what sources.json states about the file of a view.

    Parameters
    ----------
    source
        The file.
    view
        Name of the view.

    Returns
    -------
    dict
        Name of the view, path, size and hash.

    Raises
    ------
    StorageError
        If the file cannot be read.
    """
    with storage_errors(source.path):
        size = source.path.stat().st_size
        return {
            "view": view,
            "path": str(source.path.absolute()),
            "size_bytes": size,
            "sha256": sha256_of(source.path),
        }


def _runs(result: OfflineResult) -> list[dict[str, Any]]:
    """Return id and SHA-256 of the seal of each run that recordings are from; None for a run that is not sealed."""
    runs = []
    folders = {source.path.resolve().parent.parent: source for source in result.sources if source.job}
    for folder, source in folders.items():
        manifest = folder / MANIFEST
        with storage_errors(manifest):
            sealed = sha256_of(manifest) if is_sealed(folder) and manifest.is_file() else None
        runs.append({"id": _started(source).get("id"), "folder": str(folder), "seal_sha256": sealed})
    return runs


def _camera_name(result: OfflineResult) -> str:
    names = {job.camera_name for job in _jobs(result)}
    return names.pop() if len(names) == 1 else "camera"


def _pictures(result: OfflineResult) -> list[ViewPicture]:
    """Return the views for the plots of the report, without images."""
    return [
        ViewPicture(view.name, None, view.points_px, view.points_px - residuals, view.ids)
        for view, residuals in zip(result.views, result.calibration.residuals_px, strict=True)
    ]


def _json_bytes(content: dict[str, Any]) -> bytes:
    return (json.dumps(content, indent=1, allow_nan=False) + "\n").encode()
