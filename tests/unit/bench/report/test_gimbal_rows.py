"""The report on the gimbal: the verdict as a heading, its sentences, and no blame without evidence."""

import copy
from typing import get_args

import pytest

from bench.report.calibration_tables import _VERDICTS, checks
from bench.report.html import ReportData, printed_text, render_report
from bench.report.text import angle
from calib.studies.gimbal_verdict import VerdictKind


def test_every_verdict_has_a_heading():
    assert set(_VERDICTS) == set(get_args(VerdictKind))


def test_the_verdict_and_its_sentences_are_printed(data):
    results = copy.deepcopy(dict(data.results))
    results["gimbal"] |= {"verdict": "slip", "agrees": False, "says": ["The pan axis slipped.", "And more."]}
    words = printed_text(render_report(ReportData(results)))
    assert "Gimbal: an axis slipped" in words
    assert words[words.index("Gimbal: an axis slipped") + 1] == "The pan axis slipped. And more."


def test_a_difference_alone_blames_nobody(data):
    rows = dict(checks({"gimbal": dict(data.results["gimbal"]) | {"agrees": False}}))
    said = rows["Hand-eye check: rotations against the gimbal's readings"]
    assert said.endswith("more than the uncertainty of the stars explains.")
    assert "slipped" not in " ".join(rows.values())


def test_results_of_older_versions_have_no_verdict(data):
    rows = checks({"gimbal": {"rms_arcsec": 1.83, "scale": {}, "scale_sigma": {}, "agrees": True}})
    assert [name for name, _ in rows] == ["Hand-eye check: rotations against the gimbal's readings"]


@pytest.mark.parametrize(
    ("arcsec", "text"), [(359.0, "359\N{DOUBLE PRIME}"), (360.0, "0.100\N{DEGREE SIGN}")]
)
def test_angles_are_degrees_from_a_tenth_on(arcsec, text):
    assert angle(arcsec) == text
