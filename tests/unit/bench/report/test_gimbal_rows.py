"""The report on the gimbal: the verdict as a heading, its sentences, and no blame without evidence."""

import copy
from typing import get_args

import numpy as np
import pytest
from certificate_sample import sample_results

from bench.certificate.run_facts import further_of
from bench.report.calibration_tables import checks
from bench.report.html import ReportData, render_report
from bench.report.run_tables import boresight_rows
from bench.report.text import angle
from calib.model.boresight import Boresight
from calib.model.rotation import exp_map
from calib.studies.gimbal_verdict import VerdictKind
from tests.support.printed_text import printed_text


@pytest.mark.parametrize("verdict", get_args(VerdictKind))
def test_every_verdict_has_a_heading(data, verdict):
    gimbal = dict(data.results["gimbal"]) | {"verdict": verdict, "says": ["What was found."]}
    (heading,) = [name for name, said in checks({"gimbal": gimbal}) if said == "What was found."]
    assert heading.startswith("Gimbal: ")


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


BORESIGHT = Boresight(
    exp_map(np.radians([0.5, -1.25, 3.0])),
    np.diag([1e-4, 4e-4, 9e-4]) ** 2,
    np.degrees([2e-4, 8e-4, 18e-4]),
    np.array([0.02, -0.01, 1.0]) / np.linalg.norm([0.02, -0.01, 1.0]),
    np.diag([1e-4, 2e-4]) ** 2,
    np.degrees([2e-4, 4e-4]),
)


def test_the_boresight_is_printed_with_u_and_with_the_faces_of_the_mount(data):
    results = copy.deepcopy(dict(data.results))
    assert boresight_rows(results) == []
    results["calibration"]["gimbal"] = {"entered": True}
    assert "two axes of the stage must move" in dict(boresight_rows(results))["Boresight"]
    results["calibration"]["boresight"] = BORESIGHT.to_dict()
    results["mount_faces"] = [
        {"name": "front", "normal_in_camera": [0, 0, 1], "angle_deg": 1.28, "expanded_deg": 0.023}
    ]
    turned, looks, face = (text for _, text in boresight_rows(results))
    assert turned == "x 0.500° ± 0.011°, y \N{MINUS SIGN}1.250° ± 0.046°, z 3.00° ± 0.10°"
    assert looks == "right 1.146° ± 0.011°, down \N{MINUS SIGN}0.573° ± 0.023° of the flange's axis"
    assert face == "angle 1.280° ± 0.023°"


def test_the_certificate_states_the_boresight_with_its_u():
    results = sample_results()
    before = further_of(results)
    results["calibration"]["boresight"] = BORESIGHT.to_dict()
    stated = {one.id: one for one in further_of(results)}
    assert {one.id for one in before} < set(stated)
    assert (stated["boresight_y"].text, stated["boresight_y"].unit) == ("-1.250 deg", "deg")
    assert stated["boresight_y_expanded"].text == "0.046 deg"
    assert stated["boresight_down"].value == pytest.approx(-0.573, abs=1e-3)
