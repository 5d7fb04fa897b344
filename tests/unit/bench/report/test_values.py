"""The report prints every number of the results, each value with its uncertainty."""

import json
import re
from decimal import Decimal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from report_sample import RESULTS, SIGMA, SMALL

from bench.base.bounded_json import canonical_json
from bench.record.stored_calibration import camera_of
from bench.record.stored_run import results_of
from bench.report.html import ReportData, render_report
from bench.wording.numbers import with_uncertainty
from calib.uncertainty.projection_uncertainty import projection_uncertainty
from tests.support.printed_text import printed_text


def test_each_value_is_printed_with_its_uncertainty(html):
    words = printed_text(html)
    values = dict(
        zip(SIGMA, [3346.4, 3346.7, 640.5, 363.7, 0.064, -0.96, 96.22, 142.51, 255.10], strict=True)
    )
    for name, sigma in SIGMA.items():
        value, expanded = with_uncertainty(values[name], 2 * sigma)
        assert value in words, name
        assert f"± {expanded}" in words, name
    assert words[words.index("3346.4") - 1 :][:4] == ["focal length, along rows", "3346.4", "± 4.3", "0.13 %"]


@pytest.mark.parametrize(
    "path",
    [
        ("calibration", "rms_px"),
        ("calibration", "covariance", "matrix", 0, 2),
        ("calibration", "views", 0, "n"),
        ("calibration", "budget", "noise of the stars", "cx"),
        ("previous", "number"),
        ("halves", "worst_px"),
        ("gimbal", "rms_arcsec"),
        ("gimbal", "scale_sigma", "pan_deg"),
        ("gates", 4, "value"),
        ("conditions", "camera", "temperature_c"),
    ],
    ids=lambda path: ".".join(map(str, path)),
)  # fmt: skip
def test_each_number_of_the_results_is_printed(data, html, path):
    place = content = json.loads(canonical_json(data.results))
    for key in path[:-1]:
        place = place[key]
    number = place[path[-1]]
    place[path[-1]] = type(number)(number * 1.5 + 1)
    results = results_of(canonical_json(content), RESULTS)
    changed = printed_text(render_report(ReportData(results, (), data.journal_head)))
    assert changed != printed_text(html)


def test_the_expanded_uncertainty_takes_the_factor_that_few_poses_ask_for(results):
    results["calibration"]["coverage_factor"] = 3.5
    words = printed_text(render_report(ReportData(results)))
    assert words[words.index("focal length, along rows") + 2] == "± 7.5"  # 3.5 * 2.13
    assert "3.5" in words[words.index("k") : words.index("k") + 6] or any("= 3.5" in word for word in words)
    compared = words[words.index("Comparison with the simulated truth") :]
    assert "± 7.5" in compared


def test_a_collimator_s_imperfections_are_named_with_their_uncertainty(results):
    results["calibration"]["model"] = "pupil"
    results["calibration"]["collimator"]["pupil_shift"] = -0.0712
    results["calibration"]["sigma"]["pupil_shift"] = 0.0052
    words = printed_text(render_report(ReportData(results)))
    place = words.index("collimator: reticle out of focus")
    assert words[place - 1 : place + 3] == ["pupil shift", words[place], "\N{MINUS SIGN}0.071", "± 0.011"]
    assert any("model “pupil”" in word for word in words)


def shown_of(html, title):
    """What a map of the report states: its largest value."""
    return re.findall(rf">{title}, px</text>\s*<text[^>]*>median [\d.e+\-]+, at most ([\d.e+\-]+)<", html)


def test_the_uncertainty_of_a_direction_is_drawn_from_the_covariance(data, html):
    # of the shown digits, "at most" is k times what the engine's own map says
    calibration = data.results["calibration"]
    covariance = np.array(calibration["covariance"]["matrix"])[:6, :6]
    uncertainty = projection_uncertainty(camera_of(calibration["camera"], SMALL), covariance)
    assert shown_of(html, "U of an image point") == [f"{2 * uncertainty.worst_px:.2g}"]


@given(st.floats(-1e6, 1e6), st.floats(1e-9, 1e5))
def test_a_value_is_rounded_to_two_digits_of_its_uncertainty(value, expanded):
    texts = with_uncertainty(value, expanded)
    printed_value, printed_expanded = (Decimal(text.replace("\N{MINUS SIGN}", "-")) for text in texts)
    assert len(texts[0].partition(".")[2]) == len(texts[1].partition(".")[2])
    step = Decimal(1).scaleb(printed_expanded.adjusted() - 1)  # the second digit of U
    assert printed_expanded % step == 0
    assert printed_value % step == 0
    assert abs(printed_value - Decimal(value)) <= step / 2 + Decimal(abs(value)).scaleb(-15)
    assert Decimal("0.99") * Decimal(repr(expanded)) <= printed_expanded <= Decimal("1.1") * Decimal(expanded)


@pytest.mark.parametrize("expanded", [0.0, float("nan"), float("inf")])
def test_without_an_uncertainty_none_is_printed(expanded):
    assert with_uncertainty(3345.0637, expanded) == ("3345.06", "\N{EN DASH}")
