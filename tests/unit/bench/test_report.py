"""The report: it shows what the results say, nothing else can get in, and the same data give the same bytes."""

import copy
import re
import subprocess
import sys
from decimal import Decimal
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from report_sample import COLLIMATOR, SIGMA, TRUE, sample

from bench.report import ReportData, ViewPicture, printed_text, render_report
from bench.report.plots import residual_vectors
from bench.report.text import with_uncertainty
from bench.report.walk import walk_diagram
from calib.camera import CameraModel
from calib.infinity import camera_difference, uncertainty_map

SMALL = (320, 180)
VOID = {"meta", "link", "br", "img", "hr", "input"}


@pytest.fixture(scope="module")
def data():
    return sample(size=SMALL)


@pytest.fixture(scope="module")
def html(data):
    return render_report(data)


class Structure(HTMLParser):
    """Tags, attributes and whether every element is closed where it should be."""

    def __init__(self, html):
        super().__init__()
        self.tags, self.attributes, self.open, self.wrong = [], [], [], []
        self.feed(html)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += [(tag, name, value) for name, value in attrs]
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += [(tag, name, value) for name, value in attrs]

    def handle_endtag(self, tag):
        if not self.open or self.open.pop() != tag:
            self.wrong.append((tag, self.getpos()))


# ------------------------------------------------------------------ what it is


def test_every_element_is_closed_and_every_id_is_unique(html):
    found = Structure(html)
    assert (found.wrong, found.open) == ([], [])
    ids = [value for _, name, value in found.attributes if name == "id"]
    assert len(ids) == len(set(ids))
    references = {
        value[1:] for _, name, value in found.attributes if name.endswith("href") and value.startswith("#")
    }
    assert references <= set(ids)


def test_every_picture_has_a_name_for_those_who_do_not_see_it(html):
    pictures = re.findall(r'<svg [^>]*role="img"[^>]*>', html)
    labels = [re.search(r'aria-label="([^"]+)"', picture) for picture in pictures]
    assert all(labels)
    assert len({label[1] for label in labels}) == len(pictures) == 9


def test_it_needs_no_network_and_runs_no_script(html):
    found = Structure(html)
    assert not {"script", "iframe", "object", "embed", "link", "form", "base"} & set(found.tags)
    assert not [a for a in found.attributes if a[1].startswith("on")]
    loaded = [
        value
        for _, name, value in found.attributes
        if name in {"src", "href", "xlink:href", "data", "action"}
    ]
    assert loaded
    assert all(value.startswith(("#", "data:image/")) for value in loaded)
    assert not re.findall(r"url\((?!#)", html)
    assert "@import" not in html


def test_it_forbids_all_but_its_own_pictures_and_style(html):
    (policy,) = re.findall(r'http-equiv="Content-Security-Policy" content="([^"]*)"', html)
    assert policy.startswith("default-src 'none'; img-src data:; style-src 'unsafe-inline';")


def test_the_same_data_give_the_same_bytes_in_another_process(html, tmp_path):
    code = "import sys; sys.path.insert(0, sys.argv[1]); from report_sample import sample; from bench.report import render_report; print(render_report(sample(size=(320, 180))), end='')"
    other = subprocess.run(
        [sys.executable, "-c", code, Path(__file__).parents[2] / "support"],
        capture_output=True,
        check=True,
        env={
            "PYTHONHASHSEED": "7",
            "PATH": "",
            "HOME": "/nonexistent",
            "TZ": "Asia/Tokyo",
            "LC_ALL": "C.UTF-8",
            "MPLCONFIGDIR": str(tmp_path),
        },
        cwd=Path(__file__).parents[3],
    ).stdout.decode()
    assert other == html


def test_names_cannot_become_markup(data):
    evil = "</style><script>alert(1)</script>\"' onload=x {{ 7*7 }} $\\alpha"
    results = copy.deepcopy(dict(data.results))
    results["run"] |= {"id": evil, "operator": evil, "station": evil}
    results["deviations"] = [evil]
    results["calibration"]["notes"] = [evil]
    results["states"][0]["state"] = evil
    results["poses"][0] |= {"name": evil}
    results["gates"][0] |= {"name": evil, "limit": evil, "unit": evil}
    views = [ViewPicture(evil, v.image, v.detected, v.reprojected, v.ids) for v in data.views]
    html = render_report(ReportData(results, views, evil))
    found = Structure(html)
    assert (found.wrong, found.open) == ([], [])
    assert "script" not in found.tags
    (page_rule,) = re.findall(r"@page \{.*?\n\}", html, re.DOTALL)
    assert re.findall(r"Calibration report [^;]*;", page_rule) == [
        'Calibration report ??style??script?alert?1???script??? onload?x ?? 7?7 ?? ??alpha";'
    ]
    assert not [a for a in found.attributes if a[1].startswith("on")]
    assert "{{ 7*7 }}" in html


@pytest.mark.slow
def test_a_page_of_twenty_noisy_poses_stays_small():
    rng = np.random.default_rng(3)
    points = rng.uniform(10, 700, (450, 2))
    noise = rng.integers(0, 256, (720, 1280), dtype=np.uint8)
    views = [
        ViewPicture(f"pose {i}", noise, points + rng.normal(0, 0.1, points.shape), points, np.arange(450))
        for i in range(20)
    ]
    assert len(render_report(ReportData(sample(size=SMALL).results, views, ""))) < 3_000_000


# ------------------------------------------------------------------ what it says


def test_simulated_stands_on_screen_in_the_title_and_on_every_printed_page(html):
    assert any(words.startswith("SIMULATED: no camera was measured") for words in printed_text(html))
    assert "<title>SIMULATED" in html
    assert '@top-right { content: "SIMULATED DEVICES"' in html
    assert '<div class="watermark" aria-hidden="true"><span>SIMULATED</span></div>' in html


def test_nothing_is_called_simulated_on_a_real_bench():
    data = sample(size=SMALL, simulated=False)
    html = render_report(data)
    assert "SIMULATED" not in html
    assert "truth" not in " ".join(printed_text(html)).lower()


def test_uncertainty_comes_before_reprojection_error(html):
    words = " ".join(printed_text(html))
    assert words.index("Expanded uncertainty") < words.index("RMS reprojection error")
    assert "It does not say that the values are accurate" in words


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
        *[("calibration", "camera", name) for name in TRUE],
        *[("calibration", "collimator", name) for name in COLLIMATOR],
        *[("calibration", "sigma", name) for name in SIGMA],
        ("calibration", "rms_px"),
        ("calibration", "mean_px"),
        ("calibration", "covariance", "matrix", 0, 2),
        ("calibration", "views", 0, "n"),
        ("calibration", "disagreement"),
        ("calibration", "left_out_rms_px"),
        ("calibration", "coverage_factor"),
        ("calibration", "budget", "noise of the stars", "cx"),
        ("halves", "worst_px"),
        ("gimbal", "rms_arcsec"),
        ("gimbal", "scale_sigma", "pan_deg"),
        ("planar", "camera", "fx"),
        ("planar", "sigma", "fx"),
        ("comparison", 0, "error_sigmas"),
        ("comparison", 3, "truth"),
        ("poses", 1, "measured_deg", "pan"),
        ("poses", 1, "rms_px"),
        ("poses", 2, "attempts", 0, "events"),
        ("poses", 2, "attempts", 0, "event_rate_mev_s"),
        ("gates", 4, "value"),
        ("conditions", "camera", "temperature_c"),
        ("run", "seed"),
    ],
    ids=lambda path: ".".join(map(str, path)),
)  # fmt: skip
def test_each_number_of_the_results_is_printed(data, html, path, monkeypatch):
    monkeypatch.setattr("bench.report.html.deviations_from_truth", lambda *_: "")  # it takes most of the time
    results = copy.deepcopy(dict(data.results))
    place = results
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = place[path[-1]] * 1.5 + 1
    changed = printed_text(render_report(ReportData(results, (), data.journal_head)))
    assert changed != printed_text(html)


def test_the_expanded_uncertainty_takes_the_factor_that_few_poses_ask_for(data):
    results = copy.deepcopy(dict(data.results))
    results["calibration"]["coverage_factor"] = 3.5
    words = printed_text(render_report(ReportData(results)))
    assert words[words.index("focal length, along rows") + 2] == "± 7.5"  # 3.5 * 2.13
    assert "3.5" in words[words.index("k") : words.index("k") + 6] or any("= 3.5" in word for word in words)
    compared = words[words.index("How far from the truth") :]
    assert "± 7.5" in compared


def test_a_collimator_s_imperfections_are_named_with_their_uncertainty(data):
    results = copy.deepcopy(dict(data.results))
    results["calibration"]["model"] = "pupil"
    results["calibration"]["collimator"]["pupil_shift"] = -0.0712
    results["calibration"]["sigma"]["pupil_shift"] = 0.0052
    words = printed_text(render_report(ReportData(results)))
    place = words.index("collimator: reticle out of focus")
    assert words[place - 1 : place + 3] == ["pupil shift", words[place], "\N{MINUS SIGN}0.071", "± 0.010"]
    assert any("model “pupil”" in word for word in words)


def test_the_uncertainty_of_a_direction_is_drawn_from_the_covariance(data, html):
    # of the shown digits, "at most" is k times what the engine's own map says
    camera = CameraModel(
        *(data.results["calibration"]["camera"][n] for n in ("fx", "fy", "cx", "cy")),
        SMALL,
        {
            "k1": data.results["calibration"]["camera"]["k1"],
            "k2": data.results["calibration"]["camera"]["k2"],
        },
    )
    covariance = np.array(data.results["calibration"]["covariance"]["matrix"])[:6, :6]
    found = uncertainty_map(camera, covariance)
    titles = re.findall(
        r">U, (px|arc seconds)</text>\s*<text[^>]*>median [\d.e+]+, at most ([\d.e+]+)<", html
    )
    assert titles == [("px", f"{2 * found.worst_px:.2g}"), ("arc seconds", f"{2 * found.worst_arcsec:.2g}")]


def test_beside_it_stands_how_far_halves_of_the_poses_lie_apart(data, html):
    halves = data.results["halves"]["cameras"]
    first, second = (
        CameraModel(
            *(half[name] for name in ("fx", "fy", "cx", "cy")),
            SMALL,
            {name: half[name] for name in ("k1", "k2")},
        )
        for half in halves
    )
    worst = camera_difference(first, second).worst_px
    title = r">Halves of the poses apart, px</text>\s*<text[^>]*>median [\d.e\-]+, at most ([\d.e\-]+)<"
    assert re.findall(title, html) == [f"{worst:.2g}"]
    alone = copy.deepcopy(dict(data.results))
    del alone["halves"]
    assert "Halves of the poses" not in render_report(ReportData(alone, data.views))


def test_words_are_the_same_with_and_without_pictures(data, html):
    assert printed_text(render_report(ReportData(data.results, (), data.journal_head))) == printed_text(html)


def test_a_page_s_words_leave_out_what_is_drawn():
    page = "<style>a</style><p>one &amp;\n two</p><section><p>three</p></section><svg><text>x</text></svg><p>four</p>"
    assert printed_text(page) == ["one & two", "four"]


def test_the_ledger_tells_of_the_camera_s_other_runs(data, html):
    words = printed_text(html)
    assert "run 12; of this camera 2 finished, 1 open, this one included" in words
    assert data.results["run"]["ledger"]["head"] in words
    results = copy.deepcopy(dict(data.results))
    del results["run"]["ledger"]
    assert "ledger" not in " ".join(printed_text(render_report(ReportData(results)))).lower()


def test_refused_recordings_deviations_and_gates_are_told(html):
    words = " ".join(printed_text(html))
    assert "stars 31, wanted >= 40" in words
    assert "refused" in words
    assert "the first recording had 31 stars" in words
    assert "marginal" in words
    assert "captures/pose-002-attempt-2.raw" in words


def test_the_journal_and_the_way_to_verify_are_told(html, data):
    words = printed_text(html)
    assert data.journal_head in words
    assert any("ssh-keygen -Y verify" in word for word in words)


def test_nothing_is_claimed_that_was_not_done(html):
    words = " ".join(printed_text(html)).lower()
    assert "not a certificate" in words
    assert "no metrological traceability is claimed" in words
    assert " due" not in words  # no recalibration interval


def test_it_ends_with_its_number(html):
    assert printed_text(html)[-1] == "END OF REPORT three_pose-20260301-120000"


def test_a_calibration_that_did_not_converge_is_called_none(data):
    results = copy.deepcopy(dict(data.results))
    results["calibration"]["converged"] = False
    words = " ".join(printed_text(render_report(ReportData(results))))
    assert "did not converge" in words
    assert "did not converge" not in " ".join(printed_text(render_report(data)))


def test_a_planar_calibration_without_devices_is_reported_too(data):
    results = {
        "run": data.results["run"] | {"simulated": False},
        "calibration": dict(data.results["calibration"]),
    }
    results["calibration"] |= {"model": "planar", "collimator": None}
    results["calibration"]["sigma"] = {name: SIGMA[name] for name in TRUE}
    html = render_report(ReportData(results))
    found = Structure(html)
    assert (found.wrong, found.open) == ([], [])
    assert "a position and a rotation of its own" in html
    assert not {"Poses", "Gates", "Recordings", "Devices", "How far from the truth"} & set(printed_text(html))


def test_what_is_documented_of_the_results_is_in_them(data):
    table = (Path(__file__).parents[3] / "docs" / "results.md").read_text(encoding="utf-8")
    paths = [
        p for row in re.findall(r"^\| (`.*?`) \|", table, re.MULTILINE) for p in re.findall(r"`([^`]+)`", row)
    ]
    assert len(paths) > 30
    for path in paths:
        place = data.results
        for key in path.split("."):
            place = place[0] if isinstance(place, list) else place
            assert key in place, path
            place = place[key]


def test_every_part_of_the_results_is_documented(data):
    table = (Path(__file__).parents[3] / "docs" / "results.md").read_text(encoding="utf-8")
    names = [*data.results, *data.results["run"], *data.results["calibration"], *data.results["poses"][0]]
    assert [name for name in names if not re.search(rf"\b{name}\b", table)] == []


# ------------------------------------------------------------------ pictures and plots


def test_each_pose_is_pictured_with_its_stars_where_they_are(data, html):
    pictures = re.findall(r'<svg class="pose".*?</svg></svg>', html, re.DOTALL)
    assert len(pictures) == 3
    for view, picture in zip(data.views, pictures, strict=True):
        rings = np.array(re.findall(r"M(-?[\d.]+) (-?[\d.]+)a7 7", picture), float) + np.array([7, 0])
        np.testing.assert_allclose(rings, view.detected, atol=0.006)
        crosses = np.array(re.findall(r"M(-?[\d.]+) (-?[\d.]+)h8", picture), float) + np.array([4, 0])
        np.testing.assert_allclose(crosses, view.reprojected, atol=0.006)


def test_pixel_centres_lie_at_integers_in_the_pictures(html):
    (places,) = {
        tuple(map(float, p))
        for p in re.findall(r'<image x="([^"]*)" y="([^"]*)" width="320" height="180"', html)
    }
    assert places == (-0.5, -0.5)


def test_the_star_with_the_largest_residual_is_looked_at_closely(data, html):
    pictures = re.findall(r'<svg class="pose".*?</svg></svg>', html, re.DOTALL)
    for view, picture in zip(data.views, pictures, strict=True):
        corners = re.findall(r'<svg class="close-up"[^>]* viewBox="([-\d.]+) ([-\d.]+) 36 36"', picture)
        middle, worst = np.array(corners, float) + 18
        lengths = np.linalg.norm(view.detected - view.reprojected, axis=1)
        np.testing.assert_allclose(worst, view.detected[lengths.argmax()], atol=0.006)
        distances = np.linalg.norm(view.detected - (159.5, 89.5), axis=1)
        np.testing.assert_allclose(middle, view.detected[distances.argmin()], atol=0.006)


def test_a_small_picture_is_embedded_without_loss(data, html):
    import base64

    encoded = re.findall(r'href="data:image/png;base64,([^"]+)"', html)
    images = [
        cv2.imdecode(np.frombuffer(base64.b64decode(e), np.uint8), cv2.IMREAD_GRAYSCALE) for e in encoded
    ]
    assert len(images) == 3
    for view, image in zip(data.views, images, strict=True):
        np.testing.assert_array_equal(image, view.image)


def test_residuals_are_drawn_from_the_star_in_their_direction():
    residual = np.array([[0.1, 0.0], [0.0, 0.05]])
    detected = np.array([[100.0, 100.0], [200.0, 50.0]])
    svg = residual_vectors(
        [ViewPicture("a", np.zeros((180, 320), np.uint8), detected, detected - residual, np.arange(2))], SMALL
    )
    assert "magnified 100 times" in svg
    drawn = [
        path for path in re.findall(r'<path d="([^"]*)" [^>]*stroke: #0072b2', svg) if path.count("M") == 2
    ]
    dots, lines = drawn
    assert len(re.findall(r"M[\d.]+ [\d.]+h0", dots)) == 2
    strokes = [tuple(map(float, s)) for s in re.findall(r"M([\d.]+) ([\d.]+)L([\d.]+) ([\d.]+)", lines)]
    (right,) = [s for s in strokes if s[2] > s[0] + 1 and abs(s[3] - s[1]) < 0.1]
    (down,) = [s for s in strokes if s[3] > s[1] + 1 and abs(s[2] - s[0]) < 0.1]
    assert right[2] - right[0] == pytest.approx(2 * (down[3] - down[1]), rel=0.02)


@given(st.lists(st.sampled_from(["homing", "slewing", "settling", "<b>"]), max_size=12))
def test_any_walk_can_be_drawn(names):
    states = [{"state": name, "utc": f"2026-03-01T12:00:{i:02d}Z"} for i, name in enumerate(names)]
    svg = walk_diagram(states)
    found = Structure(svg)
    assert (found.wrong, found.open) == ([], [])
    assert found.tags.count("rect") == len(set(names))
    assert svg.count('class="edge"') == len(set(pairwise(names)))


def test_a_walk_tells_how_often_and_how_long():
    names = ["slewing", "recording", "slewing", "recording", "solving"]
    states = [{"state": name, "utc": f"2026-03-01T12:00:{2 * i:02d}Z"} for i, name in enumerate(names)]
    texts = re.findall(r"<text[^>]*>([^<]*)</text>", walk_diagram(states))
    assert texts.count("\N{MULTIPLICATION SIGN}2, 4.0 s") == 2
    assert "\N{MULTIPLICATION SIGN}2" in texts


# ------------------------------------------------------------------ numbers


@given(st.floats(-1e6, 1e6), st.floats(1e-9, 1e5))
def test_a_value_is_rounded_to_two_digits_of_its_uncertainty(value, expanded):
    texts = with_uncertainty(value, expanded)
    printed_value, printed_expanded = (Decimal(text.replace("\N{MINUS SIGN}", "-")) for text in texts)
    assert len(texts[0].partition(".")[2]) == len(texts[1].partition(".")[2])
    step = Decimal(1).scaleb(printed_expanded.adjusted() - 1)  # the second digit of U
    assert printed_expanded % step == 0
    assert printed_value % step == 0
    assert abs(printed_value - Decimal(value)) <= step / 2 + Decimal(abs(value)).scaleb(-15)
    assert abs(printed_expanded - Decimal(expanded)) <= Decimal(expanded) / 20


@pytest.mark.parametrize("expanded", [0.0, float("nan"), float("inf")])
def test_without_an_uncertainty_none_is_printed(expanded):
    assert with_uncertainty(3345.0637, expanded) == ("3345.06", "\N{EN DASH}")
