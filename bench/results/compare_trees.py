"""Compares a sealed folder with the same folder made again: results and views by value, all other files by bytes.

Report and exports are made again from the stored results and views, after these were compared with what the recordings
give. So a computer that rounds otherwise still compares every byte of them.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jinja2

from bench.base.errors import BenchError, EvidenceError, StorageError
from bench.evidence.findings import Findings
from bench.evidence.instructions import instructions, kind_of
from bench.evidence.seal import INSTRUCTIONS
from bench.evidence.ssh_keys import fingerprint
from bench.evidence.sshsig import read_signature
from bench.records.reading import read_json
from bench.records.run_folder import PLAN, REPORT, RESULTS, SIGNATURE
from bench.records.written import EXPORTS
from bench.results.compare_json import differences
from bench.results.compare_numbers import add_faults, check_numbers, tolerance
from bench.results.compare_views import Residuals, compare_views
from bench.results.result import shown_files
from bench.results.results_content import other_software
from bench.results.stored_calibration import stored_calibration
from bench.views.views_file import VIEWS, Measured
from calib.boards.board import Board
from calib.target import StarTarget

UNREADABLE = (ValueError, LookupError, TypeError, AttributeError, ArithmeticError, RecursionError)
"""Exceptions raised by results that are not of the expected form."""
_REPORT_BY = ("starbench", "report_form", "numpy", "opencv-python-headless")
_EXPORTS_BY = ("starbench", "export_form", "opencv-python-headless")
_PRINCIPAL = re.compile(r" -I (\S+) -n ")
_AROUND = 30


@dataclass(frozen=True)
class MadeAgain:
    """Results that were made again from their sources."""

    results: Mapping[str, Any]
    views: Sequence[Measured]
    residuals_px: Sequence[Residuals]
    camera_name: str
    # The printed target or the board; None if the views show several.
    target: StarTarget | Board | None
    used: Mapping[str, Any]  # Software that made the stored results, by name
    head: str = ""  # Hash of the journal's line that the report prints; empty without a journal
    source: str = "recordings"


def compare_trees(folder: Path, made: MadeAgain, found: Findings) -> None:
    """Compare results, views, exports and report of a folder with those that were made again.

    Report and exports follow from results and views; if these are wrong, only that is told.

    found: Findings; they are added.
    Raises OSError: When a file cannot be read.
    """
    before = len(found.faults)
    try:
        stored = read_json(folder / RESULTS)
        check_numbers(stored, made.results, found, other_software(made.used), made.source)
    except (StorageError, *UNREADABLE) as error:
        found.fault("results", RESULTS, f"the results are incomplete ({error!r})")
        return
    held = compare_views(folder / VIEWS, made.views, made.residuals_px, made.used, made.source, found)
    if held is None or len(found.faults) > before:
        return  # report and exports follow from results and views that are wrong
    try:
        calibration = stored_calibration(stored["calibration"])
        pictures = held.shown(stored)
        due = shown_files(stored, calibration, made.camera_name, made.target, pictures, made.head)
    except (BenchError, *UNREADABLE, jinja2.TemplateError) as error:
        if other := other_software(made.used):
            found.not_compared.append(f"{EXPORTS} and {REPORT} with {RESULTS}: they were made with {other}")
        else:
            found.fault("results", RESULTS, f"no report can be made of these results ({error!r})")
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
            found,
        )


def compare_file(
    path: Path, name: str, due: bytes | None, kind: str, other: str, found: Findings, of: str = RESULTS
) -> None:
    """Compare one file by its bytes.

    due: What it must hold; None if no such file follows from the results.
    other: How the program that wrote it differs from this one; empty if it does not.
    of: What it follows from.
    """
    had = path.read_bytes() if path.is_file() else None
    if had == due:
        return
    if other:
        found.not_compared.append(f"{name} with {of}: it was made with {other}")
    elif had is None:
        found.fault(kind, name, f"the file is missing; it follows from {of}")
    elif due is None:
        found.fault(kind, name, f"no such file follows from {of}")
    else:
        found.fault(kind, name, _first_difference(had, due, of))


def _first_difference(had: bytes, due: bytes, of: str) -> str:
    at = next((i for i, pair in enumerate(zip(had, due, strict=False)) if pair[0] != pair[1]), -1)
    at = min(len(had), len(due)) if at < 0 else at
    shown = [
        data[max(0, at - _AROUND) : at + _AROUND].decode("utf-8", errors="replace") for data in (had, due)
    ]
    return f"from byte {at} on it has {shown[0]!r} where {of} gives {shown[1]!r}"


def compare_plan(folder: Path, due: Mapping[str, Any], used: Mapping[str, Any], found: Findings) -> None:
    """Compare plan.json with the plan of the run's documents, except the names of files: the copies have others."""
    try:
        stored = read_json(folder / PLAN)
        seen = list(differences(_without_names(stored), _without_names(due), tolerance({}, {})))
    except (StorageError, *UNREADABLE) as error:
        found.fault("plan", PLAN, f"the file cannot be read ({error!r})")
        return
    if seen and (other := other_software(used)):
        found.not_compared.append(f"{PLAN} with the documents of the run: it was made with {other}")
    else:
        add_faults("plan", PLAN, "", seen, found)


def _without_names(plan: Mapping[str, Any]) -> dict[str, Any]:
    return {**plan, "remarks": [{**remark, "file": ""} for remark in plan["remarks"]]}


def compare_instructions(folder: Path, used: Mapping[str, Any], found: Findings) -> None:
    """Compare VERIFY.txt with the instructions for the key that sealed the folder: a reader types these commands."""
    try:
        had = (folder / INSTRUCTIONS).read_text(encoding="utf-8", errors="replace")
        signature = read_signature((folder / SIGNATURE).read_bytes())
    except (OSError, EvidenceError) as error:
        found.fault("instructions", INSTRUCTIONS, f"the file cannot be compared: {error}")
        return
    named, key = _PRINCIPAL.search(had), fingerprint(signature.public_key)
    due = instructions(kind_of(folder), principal=named[1] if named else "", fingerprint=key)
    if had == due:
        return
    if other := other_software(used):
        found.not_compared.append(f"{INSTRUCTIONS}: it was made with {other}")
    else:
        what = "these are not the instructions for the key that sealed this folder"
        found.fault("instructions", INSTRUCTIONS, what)
