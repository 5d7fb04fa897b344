"""Compares the files of recalculated results with each other, and with their sources where these are still there."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from bench.base.errors import BenchError
from bench.evidence.findings import Findings
from bench.evidence.ssh_keys import fingerprint
from bench.evidence.sshsig import read_signature
from bench.plan.job import Job
from bench.records.reading import read_json
from bench.records.run_folder import MANIFEST, PASSPORT_COPY, REPORT, RESULTS, SIGNATURE
from bench.records.storage import sha256_of
from bench.results.compare_json import differences
from bench.results.derive_instructions import check_instructions
from bench.results.derive_report import EXPORTS, check_exports, check_report
from bench.results.derive_views import check_views
from bench.results.offline_folder import RECALCULATION
from bench.results.other_software import other_program
from bench.results.stored_calibration import stored_calibration
from bench.stations.station import load_station
from bench.views.views_file import VIEWS
from calib.boards.board import Board
from calib.target import StarTarget
from drivers.errors import DriverError
from sequences.errors import SequencesError

_SOURCES = "sources.json"


def check_offline(folder: Path, found: Findings) -> None:
    """Compare sources.json, results.json, exports, report and passport with each other.

    found: Findings; they are added.
    Raises KeyError, TypeError, ValueError: When a file is not of the expected form.
    """
    results = read_json(folder / RESULTS)
    described = read_json(folder / _SOURCES)
    sources = described["sources"]
    stated = {"sources": results["sources"], "runs": results["run"].get("of_runs", [])}
    for one in differences(stated, {"sources": sources, "runs": described.get("runs", [])}):
        found.fault("results", RESULTS, f"{one}, by {_SOURCES}")
    passport = (results.get("passport") or {}).get("sha256")
    here = sha256_of(folder / PASSPORT_COPY) if (folder / PASSPORT_COPY).is_file() else None
    if passport != here:
        found.fault("results", PASSPORT_COPY, f"{RESULTS} states the passport {passport}; this one is {here}")
    check_instructions(folder, results["run"]["software"], found)
    _check_statement(folder, results["run"], described.get("runs", []), found)
    _check_sources(sources, found)
    _check_station(described, found)
    _check_derived(folder, results, described, found)


def _check_statement(
    folder: Path, run: Mapping[str, Any], runs: Sequence[Mapping[str, Any]], found: Findings
) -> None:
    """Check that the results say that they are a recalculation, of which devices, and by which key."""
    if run.get("offline") is not True:
        found.fault(
            "results", RESULTS, "it does not say that it was calculated from existing files (run.offline)"
        )
    if run.get("statement") != RECALCULATION and not other_program(run["software"]):
        found.fault("results", RESULTS, "it does not say that it is a recalculation (run.statement)")
    sealed_by = run.get("sealed_by")
    key = fingerprint(read_signature((folder / SIGNATURE).read_bytes()).public_key)
    if isinstance(sealed_by, Mapping) and sealed_by.get("fingerprint") != key:
        found.fault("results", RESULTS, f"it names the key {sealed_by.get('fingerprint')}; {key} sealed it")
    for one in runs:
        source = Path(str(one["folder"]))
        if not (source / MANIFEST).is_file() or sha256_of(source / MANIFEST) != one["seal_sha256"]:
            found.remarks.append(
                f"the run {one['id']} is not in {source} any more, or its seal is another one"
            )
            continue
        try:
            simulated = Job.from_run_folder(source).simulated
        except (BenchError, DriverError):
            found.remarks.append(f"the documents of the run in {source} cannot be read")
            continue
        if simulated and run["simulated"] is not True:
            found.fault(
                "results", RESULTS, f"it does not say that the devices of the run {one['id']} were simulated"
            )


def _check_sources(sources: Sequence[Mapping[str, Any]], found: Findings) -> None:
    """Compare the sources that are still there with their hashes."""
    gone = 0
    for source in sources:
        path = Path(str(source["path"]))
        if not path.is_file():
            gone += 1
        elif sha256_of(path) != source["sha256"]:
            found.not_compared.append(
                f"{path}: another file lies there now than the one that was calculated from"
            )
    if gone:
        found.remarks.append(f"{gone} of {len(sources)} source files are not there any more")


def _check_station(described: Mapping[str, Any], found: Findings) -> None:
    """Compare the station file of the command line, if it is still there, with its hash and its target."""
    stated = described.get("station")  # earlier versions did not state it
    if stated is None:
        return
    path = Path(str(stated["path"]))
    if not path.is_file():
        found.remarks.append(f"the station file {path}, whose target was used, is not there any more")
    elif sha256_of(path) != stated["sha256"]:
        found.remarks.append(
            f"{path}: another station file lies there now than the one whose target was used"
        )
    else:
        try:
            target = asdict(load_station(str(path)).value.target.pattern())
        except (BenchError, SequencesError) as error:
            found.remarks.append(f"the target of the station file {path} cannot be read here: {error}")
            return
        for one in differences(described["option_target"], json.loads(json.dumps(target))):
            found.fault("results", _SOURCES, f"option_target: {one}, by the station file {path}")


def _shown_target(given: Mapping[str, Any] | None, board: str | None) -> StarTarget | Board | None:
    """Return the printed target or the board; None if the views show several."""
    if board is not None:
        return Board.parse(board)
    return None if given is None else StarTarget(**{**given, "tag_square": tuple(given["tag_square"])})


def _check_derived(
    folder: Path, results: Mapping[str, Any], described: Mapping[str, Any], found: Findings
) -> None:
    """Compare stars, exports and report with the results."""
    if "camera_name" not in described or not (folder / VIEWS).is_file():
        what = "an earlier version wrote them, without the stars and the name of the camera"
        found.not_compared.append(f"{EXPORTS} and {REPORT} with {RESULTS}: {what}")
        return
    calibration = stored_calibration(results["calibration"])
    stars = [view.n for view in calibration.views]
    held = check_views(folder, results, found, all_stars=False)
    if held is None:
        return
    if stars == [len(stored.view) for stored in held.views]:  # else a guard band leaves some out
        check_views(folder, results, found)
    target = _shown_target(described["target"], results["run"].get("board"))
    names = sorted(path.name for path in (folder / EXPORTS).glob("*"))
    check_exports(folder, names, results, calibration, str(described["camera_name"]), target, found)
    check_report(folder, results, held.shown(results), "", found)
