"""Compares a sealed folder with the same folder made again: results and views by value, all other files by bytes.

Report and exports are made again from the stored results and views, so that rounding does not hide a changed byte.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from numpy.typing import NDArray

from bench.base.errors import BenchError, EvidenceError, RunFolderError, StorageError
from bench.evidence.findings import UNREADABLE, Findings, Part
from bench.evidence.seal import INSTRUCTIONS, instructions, kind_of
from bench.evidence.ssh_keys import fingerprint
from bench.evidence.sshsig import read_signature
from bench.measure.views_file import VIEWS, StoredView, read_views, views_file
from bench.record.recovery import EXPORTS
from bench.record.run_folder import PLAN, REPORT, RESULTS, SIGNATURE
from bench.record.storage import read_json
from bench.record.stored_calibration import stored_calibration
from bench.record.stored_run import StoredRun
from bench.solve.compare_numbers import (
    TOLERANCE_SHARE,
    add_faults,
    check_numbers,
    differences,
    same_stars,
    tolerance,
)
from bench.solve.result import shown_files
from bench.solve.results_content import other_software
from calib.boards.board import Board
from calib.target import StarTarget
from calib.view import View

_BYTES_BY = ("starbench", "h5py", "numpy", "program")
_REPORT_BY = ("starbench", "report_form", "numpy", "opencv-python-headless")
_EXPORTS_BY = ("starbench", "export_form", "opencv-python-headless")
_PRINCIPAL = re.compile(r" -I (\S+) -n ")
_AROUND = 30  # Bytes: the words around a difference


def compare_views(
    path: Path, again: Sequence[StoredView], used: Mapping[str, Any], source: str, findings: Findings
) -> Sequence[StoredView] | None:
    """Compare a views.h5 with the views found again, roughly those of another program; None if poses differ."""
    try:
        held = read_views(path)
        rewritten = views_file(held)  # this reads every image
    except (RunFolderError, MemoryError, RuntimeError) as error:
        what = error.what if isinstance(error, RunFolderError) else f"the file cannot be read ({error!r})"
        findings.fault("views", VIEWS, what)
        return None
    names = [stored.view.name for stored in held], [stored.view.name for stored in again]
    if names[0] != names[1]:
        findings.fault("views", VIEWS, f"it holds the poses {names[0]}; the {source} give {names[1]}")
        return None
    excused: dict[str, list[str]] = {}
    for had, due in zip(held, again, strict=True):
        seen, name = _views_differ(had, due), due.view.name
        if seen and other_software(used) and same_stars(had.view, due.view):
            excused[name] = seen
        else:
            for what in seen:
                findings.fault("views", VIEWS, f"the {source} of {name} give {what}")
    if excused:
        parts = ", ".join(dict.fromkeys(part for seen in excused.values() for part in seen))
        findings.could_not_compare(
            f"{', '.join(excused)} of {VIEWS} with the {source}: another program found the stars, with {parts}",
            "stars and images",
        )
    if path.read_bytes() != rewritten:  # a file with the same bytes holds nothing besides this content
        if by := other_software(used, _BYTES_BY):
            findings.could_not_compare(
                f"bytes of {VIEWS} with its content: it was made with {by}", "stars and images"
            )
        else:
            what = "it holds more than stars, residuals and images, or was not written by this program"
            findings.fault("views", VIEWS, what)
    return held


def _views_differ(had: StoredView, again: StoredView) -> list[str]:
    """Return what differs between a stored view and the one found again: ``other star ids``."""
    seen = [f"other {what}" for what in _stars_differ(had.view, again.view)]
    if not close(had.residuals_px, again.residuals_px):
        seen.append("other residuals")
    if (had.picture is None) != (again.picture is None):
        seen.append("an image" if had.picture is None else "no image")
    elif had.picture is not None and again.picture is not None:
        stored, made = had.picture(), again.picture()
        if stored.shape != made.shape:
            seen.append("an image of another size")
        elif differ := np.count_nonzero(stored != made):
            seen.append(f"another image: {differ} pixels differ")
    return seen


def _stars_differ(stored: View, again: View) -> list[str]:
    arrays: Sequence[tuple[str, Any, Any]] = [
        ("image sizes", stored.image_size, again.image_size),
        ("star ids", stored.ids, again.ids),
        ("image points", stored.points_px, again.points_px),
        ("points of the target", stored.target_mm, again.target_mm),
        ("covariances", stored.covariances_px2, again.covariances_px2),
    ]
    if (stored.rim is None) != (again.rim is None):
        return ["points of the rim"]
    if stored.rim is not None and again.rim is not None:
        arrays = [
            *arrays,
            ("points of the rim", stored.rim.points_mm, again.rim.points_mm),
            ("sigmas of the rim", stored.rim.sigmas_mm, again.rim.sigmas_mm),
        ]
    return [name for name, had, due in arrays if not close(np.asarray(had, float), np.asarray(due, float))]


def close(stored: NDArray[np.float64], again: NDArray[np.float64]) -> bool:
    """Return whether two arrays have one shape, and are equal within one millionth of the largest value."""
    if stored.shape != again.shape:
        return False
    scale = float(np.max(np.abs(again), initial=0.0))
    return bool(np.all(np.abs(stored - again) <= TOLERANCE_SHARE * scale))


@dataclass(frozen=True)
class MadeAgain:
    """Results that were made again from their sources."""

    results: Mapping[str, Any]
    views: Sequence[StoredView]
    camera_name: str
    # The printed target or the board; None if the views show several.
    target: StarTarget | Board | None
    used: Mapping[str, Any]  # Software that made the stored results, by name
    head: str = ""  # Hash of the journal's line that the report prints; empty without a journal
    source: str = "recordings"


def compare_trees(folder: Path, made: MadeAgain, findings: Findings) -> None:
    """Compare results and views of a folder with those made again, then, if these agree, report and exports."""
    before = len(findings.faults)
    try:
        stored = StoredRun(folder).results_as_written
        check_numbers(stored, made.results, findings, other_software(made.used), made.source)
    except (StorageError, RunFolderError, *UNREADABLE) as error:
        findings.fault("results", RESULTS, f"the results are incomplete ({error!r})")
        return
    held = compare_views(folder / VIEWS, made.views, made.used, made.source, findings)
    if held is None or len(findings.faults) > before:
        return  # report and exports follow from results and views that are wrong
    try:
        calibration = stored_calibration(stored["calibration"])
        due = shown_files(stored, calibration, made.camera_name, made.target, held, made.head)
    except (BenchError, *UNREADABLE, jinja2.TemplateError) as error:
        if other := other_software(made.used):
            findings.could_not_compare(
                f"{EXPORTS} and {REPORT} with {RESULTS}: they were made with {other}", "exports", "report"
            )
        else:
            findings.fault("results", RESULTS, f"no report can be made of these results ({error!r})")
        return
    names = {f"{EXPORTS}/{path.name}" for path in (folder / EXPORTS).glob("*")}
    for name in sorted({*due, *names}):
        of_report = name == REPORT
        compare_file(
            folder / name,
            name,
            due.get(name),
            "report" if of_report else "exports",
            other_software(made.used, _REPORT_BY if of_report else _EXPORTS_BY),
            findings,
        )


def compare_file(
    path: Path, name: str, due: bytes | None, kind: Part, other: str, findings: Findings, of: str = RESULTS
) -> None:
    """Compare one file by bytes with what is due, None for no file; ``other`` tells how the program differs."""
    had = path.read_bytes() if path.is_file() else None
    if had == due:
        return
    if other:
        findings.could_not_compare(f"{name} with {of}: it was made with {other}", kind)
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
    try:
        stored = read_json(folder / PLAN)
        seen = list(differences(_without_names(stored), _without_names(due), tolerance({})))
    except (StorageError, *UNREADABLE) as error:
        findings.fault("plan", PLAN, f"the file cannot be read ({error!r})")
        return
    if seen and (other := other_software(used)):
        findings.could_not_compare(f"{PLAN} with the documents of the run: it was made with {other}", "plan")
    else:
        add_faults("plan", PLAN, "", seen, findings)


def _without_names(plan: Mapping[str, Any]) -> dict[str, Any]:
    return {**plan, "remarks": [{**remark, "file": ""} for remark in plan["remarks"]]}


def compare_instructions(folder: Path, used: Mapping[str, Any], findings: Findings) -> None:
    """Compare VERIFY.txt with the instructions for the key that sealed the folder: a reader types these commands."""
    try:
        had = (folder / INSTRUCTIONS).read_text(encoding="utf-8", errors="replace")
        signature = read_signature((folder / SIGNATURE).read_bytes())
    except (OSError, EvidenceError) as error:
        findings.fault("instructions", INSTRUCTIONS, f"the file cannot be compared: {error}")
        return
    named, key = _PRINCIPAL.search(had), fingerprint(signature.public_key)
    due = instructions(kind_of(folder), principal=named[1] if named else "", fingerprint=key)
    if had == due:
        return
    if other := other_software(used):
        findings.could_not_compare(f"{INSTRUCTIONS}: it was made with {other}", "instructions")
    else:
        what = "these are not the instructions for the key that sealed this folder"
        findings.fault("instructions", INSTRUCTIONS, what)
