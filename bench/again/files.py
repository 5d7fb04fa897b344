"""Compares the files of a sealed folder with the same folder made again: results and stars by value, the rest by bytes.

Report and exports are made again from the stored results and views, so that rounding does not hide a changed byte.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jinja2
import numpy as np

from bench.again.compare import Difference, Maker, arrays_differ, differences, judge, limit_of_covariances
from bench.again.limits import MOST_OF_U, ROUNDING, rules_of_results
from bench.base.bounded_json import canonical_json
from bench.base.errors import BenchError
from bench.evidence.findings import UNREADABLE, Findings
from bench.measure.views_file import VIEWS, StoredView, read_views, views_file
from bench.record.recovery import EXPORTS
from bench.record.run_folder import PLAN, REPORT, RESULTS
from bench.record.storage import read_json
from bench.record.stored_run import StoredRun
from bench.solve.result import shown_files
from bench.solve.results_content import other_software
from calib.arrays import Array
from calib.boards.board import Board
from calib.target import StarTarget

_VIEWS_BY = ("starbench", "h5py", "numpy", "program")
_REPORT_BY = ("starbench", "report_form", "numpy", "opencv-python-headless")
_EXPORTS_BY = ("starbench", "export_form", "opencv-python-headless")
_AROUND = 30  # Bytes: the words around a difference
_ENGINE = "calibration.engine"
_K_OF_STAR = 2.0  # U of a star's place is 2 sigma


@dataclass(frozen=True)
class MadeAgain:
    """Results that were made again from their sources."""

    results: Mapping[str, Any]
    views: Sequence[StoredView]
    camera_name: str
    target: StarTarget | Board | None  # None if the views show several
    head: str = ""  # Hash of the journal's line that the report prints; empty without a journal


def maker_of(results: Mapping[str, Any], used: Mapping[str, Any]) -> Maker:
    """Return who made stored results, with the software that journal or results state."""
    calibration = results.get("calibration")
    return Maker(used, calibration.get("engine") if isinstance(calibration, Mapping) else None)


def compare_files(folder: Path, made: MadeAgain, maker: Maker, findings: Findings) -> None:
    """Compare results and views of a folder with those made again, then, if these agree, report and exports."""
    run, before = StoredRun(folder), len(findings.faults)
    with findings.unreadable("results", RESULTS, "the results are incomplete"):
        _compare_results(run.results_as_written, made.results, maker, findings)
    held = _compare_views(folder / VIEWS, made.views, maker, findings)
    if held is None or len(findings.faults) > before:
        return  # report and exports follow from results and views that are wrong
    try:
        due = shown_files(run.results, run.calibration, made.camera_name, made.target, held, made.head)
    except (BenchError, *UNREADABLE, jinja2.TemplateError) as error:
        if maker.is_same_program:
            findings.fault("results", RESULTS, f"no report can be made of these results ({error!r})")
        else:
            findings.not_compared.append(f"{EXPORTS} and {REPORT}: this version cannot make them again")
        return
    names = {f"{EXPORTS}/{path.name}" for path in (folder / EXPORTS).glob("*")}
    for name in sorted({*due, *names}):
        kind, makers = ("report", _REPORT_BY) if name == REPORT else ("exports", _EXPORTS_BY)
        compare_file(
            folder / name, name, due.get(name), kind, other_software(maker.software, makers), findings
        )


def _compare_results(
    stored: Mapping[str, Any], again: Mapping[str, Any], maker: Maker, findings: Findings
) -> None:
    if canonical_json(stored) == canonical_json(again):
        findings.remarks.append("made again: every number is equal to the last bit")
        return
    seen = list(differences(stored, again, rules_of_results(again)))
    if not maker.is_same_program:  # another engine states that it is another one
        seen = [difference for difference in seen if not difference.where.startswith(_ENGINE)]
    judge("results", RESULTS, seen, maker, findings)
    if not seen:
        findings.remarks.append("made again: every value agrees within a tenth of its uncertainty")


def _compare_views(
    path: Path, again: Sequence[StoredView], maker: Maker, findings: Findings
) -> Sequence[StoredView] | None:
    """Compare a views.h5 with the views found again, and return what it holds; None if the poses differ."""
    try:
        held = read_views(path)
        rewritten = views_file(held)  # this reads every image
    except (BenchError, MemoryError, RuntimeError) as error:
        what = error.what if isinstance(error, BenchError) else f"the file cannot be read ({error!r})"
        findings.fault("views", VIEWS, what)
        return None
    names = [stored.view.name for stored in held], [stored.view.name for stored in again]
    if names[0] != names[1]:
        findings.fault("views", VIEWS, f"it holds the poses {names[0]}; the recordings give {names[1]}")
        return None
    for had, due in zip(held, again, strict=True):
        judge("views", VIEWS, _views_differ(had, due), maker, findings)
    if path.read_bytes() != rewritten:  # a file with the same bytes holds nothing besides this content
        if by := other_software(maker.software, _VIEWS_BY):
            findings.not_compared.append(f"bytes of {VIEWS} with its content: it was made with {by}")
        else:
            what = "it holds more than stars, residuals and images, or was not written by this program"
            findings.fault("views", VIEWS, what)
    return held


def _views_differ(had: StoredView, due: StoredView) -> Iterator[Difference]:
    """Yield the first part that differs of a stored view and the one found again: stars by their U."""
    of_star = MOST_OF_U * _K_OF_STAR * np.sqrt(np.diagonal(due.view.covariances_px2, axis1=1, axis2=2))
    limits: dict[str, Array | float] = {
        "points_px": of_star,
        "residuals_px": of_star,
        "covariances_px2": limit_of_covariances(due.view.covariances_px2),
        "image": 0.0,
    }
    stored = _parts(had)
    for name, made in _parts(due).items():
        limit = limits.get(name, ROUNDING * np.max(np.abs(made), initial=0.0))
        if seen := list(arrays_differ(f"{due.view.name}.{name}", stored[name], made, limit)):
            yield from seen
            return  # of other stars, places say nothing


def _parts(stored: StoredView) -> dict[str, Array]:
    """Return the content of a view; parts that it does not have are empty."""
    view, nothing = stored.view, np.zeros(0)
    parts = {
        "image_size": view.image_size,
        "ids": view.ids,
        "target_mm": view.target_mm,
        "rim.points_mm": nothing if view.rim is None else view.rim.points_mm,
        "rim.sigmas_mm": nothing if view.rim is None else view.rim.sigmas_mm,
        "points_px": view.points_px,
        "residuals_px": stored.residuals_px,
        "covariances_px2": view.covariances_px2,
        "image": nothing if stored.picture is None else stored.picture(),
    }
    return {name: np.asarray(part, np.float64) for name, part in parts.items()}


def compare_file(
    path: Path, name: str, due: bytes | None, kind: str, other: str, findings: Findings, of: str = RESULTS
) -> None:
    """Compare one file by bytes with what is due, None for no file; ``other`` tells how the program differs."""
    had = path.read_bytes() if path.is_file() else None
    if had == due:
        return
    if other:
        findings.not_compared.append(f"{name} with {of}: it was made with {other}")
    elif had is None:
        findings.fault(kind, name, f"the file is missing; it follows from {of}")
    elif due is None:
        findings.fault(kind, name, f"no such file follows from {of}")
    else:
        findings.fault(kind, name, _first_difference(had, due, of))


def _first_difference(had: bytes, due: bytes, of: str) -> str:
    at = next((i for i, pair in enumerate(zip(had, due, strict=False)) if pair[0] != pair[1]), -1)
    at = min(len(had), len(due)) if at < 0 else at
    shown = [
        data[max(0, at - _AROUND) : at + _AROUND].decode("utf-8", errors="replace") for data in (had, due)
    ]
    return f"from byte {at} on it has {shown[0]!r} where {of} gives {shown[1]!r}"


def compare_plan(folder: Path, due: Mapping[str, Any], used: Mapping[str, Any], findings: Findings) -> None:
    """Compare plan.json with the plan of the run's documents, except the names of files: the copies have others."""
    with findings.unreadable("plan", PLAN, "the file cannot be read"):
        seen = differences(_without_names(read_json(folder / PLAN)), _without_names(due))
        judge("plan", PLAN, seen, Maker(used), findings)


def _without_names(plan: Mapping[str, Any]) -> dict[str, Any]:
    return {**plan, "remarks": [{**remark, "file": ""} for remark in plan["remarks"]]}
