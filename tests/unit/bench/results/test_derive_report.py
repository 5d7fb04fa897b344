"""A report held against the results: every word, every mark of the page, every plot; and what cannot be compared."""

from unittest import mock

import pytest
from report_sample import sample

from bench.evidence.findings import Findings
from bench.report import figures
from bench.report.html import ReportData, render_report
from bench.results.derive_report import check_report, split_graphics
from bench.results.results_content import software

HEAD = "ab" * 32


@pytest.fixture(scope="module")
def made():
    """Results, views and their report; plots are drawn once."""
    found = sample(size=(160, 90))
    results = {**found.results, "run": {**found.results["run"], "software": software()}}
    drawn = figures.report_plots(results, found.views)
    with mock.patch("bench.report.figures.report_plots", return_value=drawn):
        yield results, found.views, render_report(ReportData(results, found.views, HEAD))


def checked(folder, html, results, views, *, faults=()):
    (folder / "report.html").write_bytes(html if isinstance(html, bytes) else html.encode())
    found = Findings(faults=list(faults))
    check_report(folder, results, views, HEAD, found)
    return found


def test_the_report_of_the_results_has_the_same_bytes(made, tmp_path):
    results, views, html = made
    found = checked(tmp_path, html, results, views)
    assert (found.faults, found.not_compared) == ([], [])


@pytest.mark.parametrize("printed", ["3346.4", "\N{PLUS-MINUS SIGN} 4.3", "0.0812", "41.27", "accepted"])
def test_another_word_is_named_with_what_is_due(made, tmp_path, printed):
    results, views, html = made
    assert f">{printed}" in html
    (fault,) = checked(tmp_path, html.replace(f">{printed}", f">{printed}1", 1), results, views).faults
    assert (fault.kind, fault.where) == ("report", "report.html")
    assert f"{printed}1" in fault.what


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("</style>", "b{display:none}</style>", "markup or style"),
        ("<main>", "<main hidden>", "markup or style"),
        ("<main>", "<main><!-- 1 -->", "markup or style"),
        ("</text>", "9</text>", "its graphic"),
        ("<svg class", '<svg style="opacity:0" class', "its graphic"),
        ('href="data:image/png;base64,', 'href="data:image/png;base64,A', "its graphic"),
    ],
)
def test_what_is_no_word_is_compared_too(made, tmp_path, old, new, told):
    results, views, html = made
    assert old in html
    (fault,) = checked(tmp_path, html.replace(old, new, 1), results, views).faults
    assert told in fault.what


def test_another_line_of_the_journal_is_found(made, tmp_path):
    results, views, html = made
    assert checked(tmp_path, html.replace(HEAD, "0" * 64), results, views).faults


@pytest.mark.parametrize(
    ("part", "words", "what"),
    [
        ("starbench", "another", "report.html with results.json: it was made with starbench another (here "),
        ("report_form", "another", "report.html with results.json: it was made with report form another (here "),
        ("numpy", "1.0", "plots and images of report.html with results.json: they were made with numpy 1.0 (here "),
    ],
)  # fmt: skip
def test_what_another_program_made_otherwise_is_not_compared_and_that_is_told(
    made, tmp_path, part, words, what
):
    results, views, _ = made
    other = {**results, "run": {**results["run"], "software": {**software(), part: words}}}
    theirs = render_report(ReportData(other, views, HEAD))
    assert checked(tmp_path, theirs, other, views).not_compared == []  # the same bytes are compared anyway
    found = checked(tmp_path, theirs.replace("</text>", "9</text>", 1), other, views)
    assert found.faults == []
    assert found.not_compared[0].startswith(what)


def test_results_that_no_report_can_be_made_of_are_found(made, tmp_path):
    results, views, html = made
    broken = {**results, "calibration": {**results["calibration"], "sigma": "unknown"}}
    (fault,) = checked(tmp_path, html, broken, views).faults
    assert fault.kind == "results"
    assert "no report can be made of these results" in fault.what


def test_a_report_that_is_no_text_is_found(made, tmp_path):
    results, views, _ = made
    (fault,) = checked(tmp_path, b"\xff\xfe" * 1000, results, views).faults
    assert fault.kind == "report"


def test_after_a_fault_only_the_words_are_compared(made, tmp_path):
    results, views, html = made
    with mock.patch("bench.report.figures.report_plots", side_effect=AssertionError("drawn")):
        assert len(checked(tmp_path, html, results, views, faults=["one"]).faults) == 1
        assert (
            len(checked(tmp_path, html.replace(">3346.4", ">3346.5"), results, views, faults=["one"]).faults)
            == 2
        )


def test_graphics_are_separated_with_what_they_contain():
    html = "<p>a</p><svg x><g/><svg y></svg>1</svg><p>b</p><svg/></svg>c"
    rest, graphics = split_graphics(html)
    assert rest == "<p>a</p>\0<p>b</p>\0c"
    assert graphics == ["<svg x><g/><svg y></svg>1</svg>", "<svg/></svg>"]
