"""Recalculated results: the sources are calibrated again."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from bench.again.files import MadeAgain, compare_file, compare_files, maker_of
from bench.base.bounded_json import parse_json
from bench.evidence.findings import Findings
from bench.evidence.ssh_keys import fingerprint
from bench.evidence.sshsig import read_signature
from bench.record.run_folder import PASSPORT_COPY, RESULTS, SIGNATURE, SOURCES
from bench.record.storage import read_json, sha256_of
from bench.record.stored_run import StoredRun
from bench.solve.offline import OfflineResult, Reached, calibrate_paths, nothing_shown
from bench.solve.offline_folder import SealedBy, offline_files, source_data
from bench.solve.offline_options import StationFile, passport_of_file
from bench.solve.results_content import other_software
from bench.solve.sources import options_of_data
from calib.target import StarTarget


def check_recalculated(folder: Path, progress: Reached = nothing_shown) -> Findings:
    """Calibrate the sources of recalculated results again, with the same options, and compare every file.

    ``progress`` is told how many views of all have been found.
    """
    findings = Findings()
    with findings.unreadable("results", RESULTS, "it cannot be compared with its sources"):
        _compare(folder, progress, findings)
    return findings


def _compare(folder: Path, progress: Reached, findings: Findings) -> None:
    described, stored = read_json(folder / SOURCES), StoredRun(folder).results_as_written
    used = stored["run"]["software"]
    if stored["sources"] != described["sources"]:
        findings.fault("results", RESULTS, f"its sources are not those of {SOURCES}")
        return
    if why := _cannot(described):
        findings.not_compared.append(f"{RESULTS} with its sources: {why}")
        return
    again = _calibrated(folder, described, progress)
    pairs = zip(again.sources, again.views, strict=True)
    sources = [source_data(source, view.name) for source, view in pairs]
    if sources != described["sources"]:
        why = "the paths hold other files now than those that were calculated from"
        findings.not_compared.append(f"{RESULTS} with its sources: {why}")
        return
    files = offline_files(again, str(stored["run"]["id"]), _sealer(folder, stored), sources=sources)
    results = parse_json(files[RESULTS])
    results["run"] |= {name: stored["run"][name] for name in ("calibrated_utc", "software")}
    for name in (SOURCES, PASSPORT_COPY):
        other = other_software(used)
        compare_file(folder / name, name, files.get(name), "results", other, findings, "the sources")
    target = again.board or again.target
    made = MadeAgain(results, again.stored_views, str(described["camera_name"]), target)
    compare_files(folder, made, maker_of(stored, used), findings)


def _sealer(folder: Path, stored: Mapping[str, Any]) -> SealedBy | None:
    """Return who sealed the results, by the key of their signature; None if they name nobody."""
    stated = stored["run"].get("sealed_by")
    if stated is None:
        return None
    key = read_signature((folder / SIGNATURE).read_bytes()).public_key
    return SealedBy(str(stated["principal"]), fingerprint(key))


def _cannot(described: Mapping[str, Any]) -> str:
    """Return why the calibration cannot be made again; empty if it can."""
    for path in (*described["paths"], *(source["path"] for source in described["sources"])):
        if not Path(path).exists():
            return f"{path} is not there any more"
    for source in described["sources"]:
        if sha256_of(Path(source["path"])) != source["sha256"]:
            return f"{source['path']} is another file now"
    return ""


def _calibrated(folder: Path, described: Mapping[str, Any], progress: Reached) -> OfflineResult:
    """Calibrate the sources again."""
    stored, passport = described["options"], None
    station = None if described["station"] is None else StationFile(**described["station"])
    if stored["passport"] is not None:
        passport = passport_of_file(folder / PASSPORT_COPY, str(stored["passport"]))
        if station is not None and station.passport_source is not None:
            passport = replace(passport, source=station.passport_source)
    given = described["option_target"]
    target = StarTarget(**{**given, "tag_square": tuple(given["tag_square"])})
    options = replace(options_of_data(stored, passport, target), station=station)
    return calibrate_paths([Path(path) for path in described["paths"]], options, progress=progress)
