"""Writes an offline calibration to a folder: results, report, stars, exports, hashes of its inputs, seal.

The results have the schema of a run's, marked ``offline``. The seal covers the hashes of the inputs and of the seals of
their runs; without a key the folder is a draft.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any, Self

from bench.base.bounded_json import canonical_json, mapped
from bench.evidence.keys import BenchKey
from bench.evidence.seal import seal_folder
from bench.measure.views_file import VIEWS, views_file
from bench.plan.job import Job
from bench.record.run_folder import MANIFEST, PASSPORT_COPY, RESULTS, SOURCES, is_sealed
from bench.record.storage import sha256_of, storage_errors, write_files
from bench.record.stored_run import results_of
from bench.solve import results_content
from bench.solve.offline import OfflineResult
from bench.solve.result import shown_files
from bench.solve.results_content import collimator_data, pose_row, projection, target_data
from bench.solve.software import files_software
from bench.solve.sources import options_data
from bench.solve.view_sources import PHOTOGRAPHS, ViewSource, jobs_of

SCHEMA = "starbench/sources/1"
RECALCULATION = (
    "These results are a recalculation: they were calculated from existing files, without devices, and are not the"
    " record of a run."
)
"""What results.json states about results that were not calculated by a run."""


@dataclass(frozen=True)
class SealedBy:
    """Who seals a folder, as its results state it."""

    principal: str  # Name of the signer, as ``name@place``
    fingerprint: str  # Of the public key

    @classmethod
    def of(cls, key: BenchKey | None) -> Self | None:
        """Return who seals with a key; None without one."""
        return None if key is None else cls(key.principal, key.fingerprint)


def write_offline_results(
    result: OfflineResult, name: str, folder: Path, key: BenchKey | None = None
) -> None:
    """Write an offline calibration of this name to a new folder, then seal it, or leave it a draft."""
    write_files(folder, offline_files(result, name, SealedBy.of(key)))
    if key is not None:
        seal_folder(folder, key)


def offline_files(
    result: OfflineResult,
    name: str,
    sealed_by: SealedBy | None = None,
    *,
    sources: Sequence[dict[str, Any]] | None = None,
    read_from: Mapping[str, str] | None = None,
) -> dict[str, bytes]:
    """Return the files of an offline calibration by name, before its seal; ``results.json`` is the last one.

    ``sealed_by`` None leaves a draft. ``sources`` is what `source_data` returns for each view; None reads and hashes
    the files now. ``read_from`` gives the place that a folder was copied from.
    """
    if sources is None:
        pairs = zip(result.sources, result.views, strict=True)
        sources = [source_data(source, view.name) for source, view in pairs]
    results = offline_results(result, name, sources, sealed_by)
    camera_name = _camera_name(result)
    described = {
        "schema": SCHEMA,
        "runs": results["run"]["of_runs"],
        "sources": list(sources),
        "camera_name": camera_name,
        "target": asdict(result.target) if result.target is not None else None,
        "paths": [str(path.absolute()) for path in result.paths],
        "options": options_data(result.choices),
        "option_target": asdict(result.choices.target),
        "station": asdict(result.choices.station) if result.choices.station is not None else None,
    }
    in_place = partial(_read_from, places=read_from or {})
    results, described = (mapped(content, in_place) for content in (results, described))
    files = {SOURCES: canonical_json(described), VIEWS: views_file(result.stored_views)}
    if result.passport is not None:
        files[PASSPORT_COPY] = result.passport.data
    target = result.board or result.target
    data = canonical_json(results)
    shown = results_of(data, Path(name) / RESULTS)  # the report is made of what a reader gets
    files |= shown_files(shown, result.calibration, camera_name, target, result.stored_views)
    files[RESULTS] = data
    return files


def _read_from(value: Any, places: Mapping[str, str]) -> Any:
    """Replace the paths of copies in a text by the places that were copied."""
    if isinstance(value, str):
        for copy, place in places.items():
            value = value.replace(copy, place)
    return value


def offline_results(
    result: OfflineResult, name: str, sources: Sequence[dict[str, Any]], sealed_by: SealedBy | None
) -> dict[str, Any]:
    """Return results.json of an offline calibration: as a run's, but without devices, gates and states."""
    return {
        "schema": results_content.SCHEMA,
        "run": _run_facts(result, name, sealed_by),
        "devices": {},
        "calibration": result.calibration.to_dict(),
        "projection": projection(result.calibration, result.views),
        "passport": result.passport.to_dict() if result.passport else None,
        "gimbal_readings": result.readings,
        "poses": _pose_rows(result),
        "gates": [],
        **({"conformity": conformity} if (conformity := result.conformity) else {}),
        "deviations": [f"Left out: {why}" for why in result.skipped],
        "sources": list(sources),
        "truth": None,
        "comparison": [],
    }


def _run_facts(result: OfflineResult, name: str, sealed_by: SealedBy | None) -> dict[str, Any]:
    """Return section ``run`` of results.json: which runs were calculated again, when, and who seals the result."""
    jobs = _jobs(result)
    job = jobs[0] if len(jobs) == 1 else None
    started: Mapping[str, Any] = (result.sources[0].started or {}) if job is not None else {}
    now = datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
    frames = all(
        source.path.suffix.lower() in PHOTOGRAPHS or (source.job and source.job.camera_kind.name == "frame")
        for source in result.sources
    )
    return {
        "id": name,
        "offline": True,
        "statement": RECALCULATION,
        "sealed_by": asdict(sealed_by) if sealed_by else None,
        "of_runs": _runs(result),
        "calibrated_utc": now,
        "of_run": started.get("id"),
        "sequence": started.get("sequence"),
        "station": started.get("station"),
        "operator": started.get("operator"),
        "laboratory": job.station.laboratory if job else None,
        "collimator": collimator_data(job) if job else None,
        **({"board": str(result.board)} if result.board is not None else {}),
        **({"target": stated} if job and (stated := target_data(job)) else {}),
        "simulated": any(planned_job.simulated for planned_job in jobs),
        "camera": "frame" if frames else "event",
        "software": files_software(source.path.suffix for source in result.sources),
    }


def _pose_rows(result: OfflineResult) -> list[dict[str, Any]]:
    """Return what results.json states about each pose."""
    pairs = zip(result.calibration.views, result.sources, strict=True)
    return [pose_row(index, view.name, source.attempt, view) for index, (view, source) in enumerate(pairs, 1)]


def _jobs(result: OfflineResult) -> list[Job]:
    """Return the tasks of the runs that the views are from, each once."""
    return [job for job in jobs_of(result.sources) if job is not None]


def source_data(source: ViewSource, view: str) -> dict[str, Any]:
    """Return what sources.json states about the file of a view: name of the view, path, size and hash."""
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
        runs.append(
            {
                "id": source.started["id"] if source.started else None,
                "folder": str(folder),
                "seal_sha256": sealed,
            }
        )
    return runs


def _camera_name(result: OfflineResult) -> str:
    names = {job.camera_name for job in _jobs(result)}
    return names.pop() if len(names) == 1 else "camera"
