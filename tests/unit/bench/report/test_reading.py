"""What a person reads first, on any screen: warnings before the numbers, tables that fit and can be read aloud."""

import re
from itertools import pairwise

import pytest
from lxml.html import fromstring

from bench.report.html import ReportData, environment, render_report


def page_with(data, **more):
    return render_report(ReportData({**data.results, **more}))


def test_gates_that_did_not_pass_and_deviations_stand_before_the_result(data):
    gate = {"name": "rms", "value": 0.31, "unit": "px", "limit": "<= 0.2", "verdict": "fail"}
    html = page_with(data, gates=[gate], deviations=["Held by ada for 3 s."])
    before = html.partition("<h2>Result</h2>")[0]
    assert "Gate rms: fail (0.310, limit ≤ 0.2 px; 0 of 1 passed)." in before
    assert "Held by ada for 3 s." in before
    assert 'class="verdict fail"' in before
    assert "Calibrated, but 1 of 1 gates fails." in before


def test_a_run_without_either_has_no_warning(data):
    html = page_with(data, gates=[], failures=[], deviations=[])
    assert "Read this before" not in html
    assert 'class="verdict pass"' in html
    assert ">Calibrated.<" in html


def test_an_error_that_ended_the_run_before_it_was_resumed_keeps_its_kind_and_place(data):
    error = {"kind": "PortLost", "what": "The port is gone.", "where": "/dev/gimbal", "remedy": "Plug it in."}
    html = page_with(data, gates=[], deviations=[], failures=[error])
    text = "The run failed and was resumed. PortLost (/dev/gimbal): The port is gone."
    assert html.count(text) == 2  # before the result, and among the deviations


def test_many_deviations_are_counted_before_the_result_and_all_told_below(data):
    html = page_with(data, gates=[], failures=[], deviations=[f"Deviation {n}." for n in range(20)])
    before, _, after = html.partition("<h2>Result</h2>")
    assert before.count("<li>Deviation") == 6
    assert "and 14 more" in before
    assert after.count("<li>Deviation") == 20


def test_a_truth_is_printed_to_the_digits_of_its_value(data):
    shown = page_with(data).partition("Comparison with the simulated truth</h2>")[2].partition("</table>")[0]
    rows = [re.findall(r'<td class="n"[^>]*>(.*?)</td>', row) for row in shown.split("</tr>")[1:-1]]
    assert len(rows) == 9
    for value, _, truth, *_ in rows:
        assert len(value.partition(".")[2]) == len(truth.partition(".")[2])


def test_every_table_scrolls_by_itself_and_its_headings_say_what_they_head(html):
    page = fromstring(html)
    tables = page.xpath("//table")
    scrolled = "ancestor::div[contains(concat(' ', @class, ' '), ' wide ')][@aria-label]"
    assert len(tables) >= 9
    assert [table.get("class") for table in tables if not table.xpath(scrolled)] == [
        "result"
    ]  # which fits any screen
    assert page.xpath("//th[not(@scope)]") == []
    assert all(head.text_content().strip() for head in page.xpath("//th"))


def test_headings_come_in_order(html):
    levels = [int(level) for level in re.findall(r"<h([1-6])[ >]", html)]
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(after - before <= 1 for before, after in pairwise(levels))


def luminance(colour):
    def linear(part):
        share = int(part, 16) / 255
        return share / 12.92 if share <= 0.04045 else ((share + 0.055) / 1.055) ** 2.4

    r, g, b = (linear(colour[i : i + 2]) for i in (1, 3, 5))
    return 0.2126 * r + 0.7152 * g + 0.0722 * b


def contrast(first, other):
    high, low = sorted((luminance(first), luminance(other)), reverse=True)
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_words_stand_out_from_their_ground(scheme):
    css = environment().loader.get_source(environment(), "report.css")[0]
    first, second = (
        dict(re.findall(r"--(\w+): (#\w{6})", block))
        for block in re.findall(r":root \{(.*?)\}", css, re.DOTALL)
    )
    colours = first | {"paper": "#ffffff"} if scheme == "light" else first | second
    for name in ("ink", "muted", "accent", "good", "warn", "bad"):
        assert contrast(colours[name], colours["paper"]) >= 4.5, name
    grounds = re.findall(r"\.(pass|marginal|fail)\b[^{}]*\{[^}]*background: (#\w{6})", css)
    word = {"pass": "good", "marginal": "warn", "fail": "bad"}
    here = grounds[:3] if scheme == "light" else grounds[3:]
    assert len(here) == 3
    for name, ground in here:
        assert contrast(colours[word[name]], ground) >= 4.5, name
