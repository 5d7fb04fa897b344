"""A report about a board speaks of points and of the board, never of stars."""

import copy
import re
from dataclasses import replace

import pytest
from report_sample import SMALL, sample

from bench.report.html import ReportData, render_report
from tests.support.printed_text import printed_text

STAR = re.compile(r"(?<![\w-])[Ss]tars?\b")


def of_board(**run):
    data = sample(size=SMALL)
    results = copy.deepcopy(dict(data.results))
    results["run"] |= {"board": "checkerboard:11x7:20mm", "collimator": None, **run}
    results["run"].pop("target", None)
    budget = {"stars": next(iter(results["calibration"]["budget"].values()))}
    results["calibration"] |= {"model": "planar", "collimator": None, "budget": budget}
    rows = results["calibration"]["budget_rows"]
    results["calibration"]["budget_rows"] = [  # as the planar model says it
        replace(row, source=row.source.replace("stars", "points")) for row in rows
    ]
    for pose in results["poses"]:  # it is calibrated from files: no attempts, no gates
        pose.pop("attempts", None)
    results |= {"gates": [], "passport": None, "deviations": []}
    return ReportData(results, data.views, data.journal_head)


@pytest.mark.parametrize("camera", ["event", "frame"])
def test_nothing_in_the_report_of_a_board_is_called_a_star(camera):
    html = render_report(of_board(camera=camera))
    labels = re.findall(r'aria-label="([^"]*)"', html)
    shown = [*labels, *re.findall(r">([^<]+)<", html.partition("</style>")[2])]
    assert [text for text in shown if STAR.search(text)] == []
    words = " ".join(printed_text(html))
    assert "stars" not in words
    assert "Gimbal readings" not in words
    for phrase in ("residuals of the points", "checkerboard:11x7:20mm"):
        assert phrase in words
    assert "the board\N{RIGHT SINGLE QUOTATION MARK}s nominal dimensions" in words
