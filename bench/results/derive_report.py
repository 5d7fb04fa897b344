"""Derives the report and the exports of a folder again from its results, and compares them byte by byte.

A report is words and numbers (its text, markup and style) and graphics (plots and images). Each part is compared if
this program makes it as the other did: the words if the form of the report is the same, the graphics if NumPy and
OpenCV are the same too. What differs though it should not is a fault. What another program made otherwise is not
compared, and that is said.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from itertools import zip_longest
from pathlib import Path
from typing import Any, cast

import jinja2

from bench.evidence.findings import Findings
from bench.records.results import Results
from bench.records.run_folder import REPORT, RESULTS
from bench.report.html import ReportData, printed_text, render_report
from bench.report.view_picture import ViewPicture
from bench.results.exports import exports
from bench.results.other_software import other_software
from calib.boards.board import Board
from calib.calibration import Calibration
from calib.target import StarTarget

UNREADABLE = (ValueError, LookupError, TypeError, AttributeError, ArithmeticError, RecursionError)
"""Exceptions raised by results that are not of the expected form."""
EXPORTS = "exports"
_WORDS_BY = ("starbench", "report_form")
_GRAPHICS_BY = (*_WORDS_BY, "numpy", "opencv-python-headless")
_EXPORTS_BY = ("starbench", "export_form", "opencv-python-headless")
_SVG = re.compile(r"<svg\b|</svg>")
_LABEL = re.compile(r'aria-label="([^"]*)"')
_AROUND = 30


def check_report(
    folder: Path, results: Mapping[str, Any], views: Sequence[ViewPicture], head: str, found: Findings
) -> None:
    """Compare the report with one that is made of the results.

    If there is a fault already, plots and images are not drawn again, and only the words are compared.

    head: Hash of the journal's line that the report must print; empty for a report without one.
    found: Findings; they are added.
    """
    try:
        due = render_report(ReportData(cast("Results", results), views, head), draw=not found.faults)
    except (*UNREADABLE, jinja2.TemplateError) as error:
        found.fault("results", RESULTS, f"no report can be made of these results ({error!r})")
        return
    data = (folder / REPORT).read_bytes()
    if data == due.encode():
        return
    had = data.decode("utf-8", errors="replace")
    if other := other_software(results, _WORDS_BY):
        found.not_compared.append(f"{REPORT} with {RESULTS}: it was made with {other}")
        return
    if found.faults:
        if printed_text(had) != printed_text(due):
            found.fault("report", REPORT, _words_differ(had, due))
        return
    if what := _words_differ(had, due):
        found.fault("report", REPORT, what)
    elif other := other_software(results, _GRAPHICS_BY):
        found.not_compared.append(f"plots and images of {REPORT} with {RESULTS}: they were made with {other}")
    else:
        found.fault("report", REPORT, _graphics_differ(had, due))


def _words_differ(had: str, due: str) -> str:
    """Return the first difference outside the graphics; empty if there is none."""
    for one, other in zip_longest(printed_text(had), printed_text(due), fillvalue=""):
        if one != other:
            return f"the report prints {one!r} where {RESULTS} gives {other!r}"
    rests = [split_graphics(html)[0] for html in (had, due)]
    if rests[0] == rests[1]:
        return ""
    at = next((i for i, pair in enumerate(zip_longest(*rests)) if pair[0] != pair[1]), 0)
    begin = max(0, at - _AROUND)
    shown = [rest[begin : at + _AROUND] for rest in rests]
    return f"its markup or style has {shown[0]!r} where {RESULTS} gives {shown[1]!r}"


def _graphics_differ(had: str, due: str) -> str:
    graphics = [split_graphics(html)[1] for html in (had, due)]
    for number, (one, other) in enumerate(zip_longest(*graphics, fillvalue=""), start=1):
        if one != other:
            label = _LABEL.search(other)
            name = f" ({label[1]})" if label else ""
            return f"its graphic {number}{name} is not the one that follows from {RESULTS} and the views"
    return f"its bytes are not those that follow from {RESULTS}"


def split_graphics(html: str) -> tuple[str, list[str]]:
    """Separate the graphics of a report from the rest.

    Returns: The ``<svg>`` elements, with all that they contain.
    """
    rest, graphics = [], []
    depth, last = 0, 0
    for mark in _SVG.finditer(html):
        if mark[0] == "</svg>":
            depth = max(0, depth - 1)
            if depth == 0:
                graphics.append(html[last : mark.end()])
                last = mark.end()
        else:
            if depth == 0:
                rest.append(html[last : mark.start()])
                last = mark.start()
            depth += 1
    rest.append(html[last:])
    return "\0".join(rest), graphics


def check_exports(
    folder: Path,
    names: Sequence[str],
    results: Mapping[str, Any],
    calibration: Calibration,
    camera_name: str,
    target: StarTarget | Board | None,
    found: Findings,
) -> None:
    """Compare the exports with those that are made of the results, byte by byte.

    names: Names of the files in ``exports/``, as the seal lists them.
    target: The printed target or the board; None if the views show several.
    found: Findings; they are added.
    """
    due = exports(calibration, camera_name=camera_name, target=target)
    other = other_software(results, _EXPORTS_BY)
    for name in sorted({*due, *names}):
        where = f"{EXPORTS}/{name}"
        if name in due and name in names and (folder / where).read_bytes() == due[name]:
            continue
        if other:
            found.not_compared.append(f"{where} with {RESULTS}: it was made with {other}")
        elif name not in names:
            found.fault("exports", where, "the file is missing; every calibration of this kind has it")
        elif name not in due:
            found.fault("exports", where, f"no such file follows from {RESULTS}")
        else:
            found.fault("exports", where, _line_differs((folder / where).read_bytes(), due[name]))


def _line_differs(had: bytes, due: bytes) -> str:
    lines = [data.decode(errors="replace").splitlines() for data in (had, due)]
    for number, (one, other) in enumerate(zip_longest(*lines, fillvalue=""), start=1):
        if one != other:
            shown = [line.strip()[:70] for line in (one, other)]
            return f"line {number} is {shown[0]!r} where {RESULTS} gives {shown[1]!r}"
    return f"its bytes are not those that follow from {RESULTS}"
