"""Compares the files of recalculated results with each other, and with their sources where these are still there."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jinja2

from bench.base.errors import BenchError
from bench.evidence.findings import Findings
from bench.plan.job import Job
from bench.records.run_folder import JOURNAL, PASSPORT_COPY, REPORT, RESULTS
from bench.records.storage import sha256_of
from bench.report.html import ReportData, printed_text, render_report
from bench.results.compare_json import differences
from bench.results.derive_report import EXPORTS, UNREADABLE, check_exports, other_software
from bench.results.stored_calibration import stored_calibration

_SOURCES = "sources.json"


def check_offline(folder: Path, found: Findings) -> None:
    """Compare sources.json, results.json, exports, report and passport with each other.

    Parameters
    ----------
    folder
        The folder.
    found
        Findings; they are added.

    Raises
    ------
    KeyError, TypeError, ValueError
        When a file is not of the expected form.
    """
    results = json.loads((folder / RESULTS).read_bytes())
    sources = json.loads((folder / _SOURCES).read_bytes())["sources"]
    for one in differences(results["sources"], sources, where="sources"):
        found.fault("results", RESULTS, f"{one}, by {_SOURCES}")
    stated = (results.get("passport") or {}).get("sha256")
    here = sha256_of(folder / PASSPORT_COPY) if (folder / PASSPORT_COPY).is_file() else None
    if stated != here:
        found.fault("results", PASSPORT_COPY, f"{RESULTS} states the passport {stated}; this one is {here}")
    jobs = _check_sources(sources, found)
    _check_exports(folder, results, jobs, found)
    _check_words(folder, results, found)


def _check_sources(sources: list[Mapping[str, Any]], found: Findings) -> list[Job]:
    """Compare the sources that are still there; return the tasks of the runs that they are from."""
    gone, folders = 0, set()
    for source in sources:
        path = Path(str(source["path"]))
        if not path.is_file():
            gone += 1
        elif sha256_of(path) != source["sha256"]:
            found.not_compared.append(
                f"{path}: another file lies there now than the one that was calculated from"
            )
        else:
            folders.add(path.resolve().parent.parent)
    if gone:
        found.remarks.append(f"{gone} of {len(sources)} source files are not there any more")
    jobs = []
    for folder in sorted(folders):
        if (folder / JOURNAL).is_file():
            try:
                jobs.append(Job.from_run_folder(folder))
            except (BenchError, *UNREADABLE):
                found.remarks.append(f"the documents of the run in {folder} cannot be read")
    return jobs


def _check_exports(folder: Path, results: Mapping[str, Any], jobs: list[Job], found: Findings) -> None:
    """Compare the exports; name of the camera and target come from the source runs, or from an export."""
    calibration = stored_calibration(results["calibration"])
    names = sorted(path.name for path in (folder / EXPORTS).glob("*"))
    cameras = {job.camera_name for job in jobs}
    targets = list({job.target for job in jobs})
    if len(cameras) != 1 or len(targets) != 1 or len(results["sources"]) == 0:
        found.not_compared.append(
            f"{EXPORTS} with {RESULTS}: their camera's name and target stand in the source runs alone"
        )
        return
    check_exports(folder, names, results, calibration, cameras.pop(), targets[0], found)


def _check_words(folder: Path, results: Mapping[str, Any], found: Findings) -> None:
    """Compare the words of the report; its plots need the stars, which this folder does not hold."""
    if other := other_software(results, ("starbench", "report_form")):
        found.not_compared.append(f"{REPORT} with {RESULTS}: it was made with {other}")
        return
    try:
        due = printed_text(render_report(ReportData(results), draw=False))
    except (*UNREADABLE, jinja2.TemplateError) as error:
        found.fault("results", RESULTS, f"no report can be made of these results ({error!r})")
        return
    had = printed_text((folder / REPORT).read_text(encoding="utf-8", errors="replace"))
    if had != due:
        one = next(
            (pair for pair in zip(had, due, strict=False) if pair[0] != pair[1]),
            (str(len(had)), str(len(due))),
        )
        found.fault("report", REPORT, f"the report prints {one[0]!r} where {RESULTS} gives {one[1]!r}")
    found.not_compared.append(f"plots of {REPORT}: the stars that they show are in the sources alone")
