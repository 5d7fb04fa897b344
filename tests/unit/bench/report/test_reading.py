"""What a person reads first, on any screen: warnings before the numbers, tables that fit and can be read aloud."""

from bench.report.html import ReportData, render_report


def page_with(data, **more):
    return render_report(ReportData({**data.results, **more}))


def test_gates_that_did_not_pass_and_deviations_stand_before_the_result(data):
    gate = {"name": "rms", "value": 0.31, "unit": "px", "limit": "<= 0.2", "verdict": "fail"}
    html = page_with(data, gates=[gate], deviations=["Held by ada for 3 s."])
    before = html.partition("<h2>Result</h2>")[0]
    assert "Gate rms: fail (0.310, limit ≤ 0.2 px" in before
    assert "Held by ada for 3 s." in before
    assert 'class="verdict fail"' in before
    assert "1 of 1 gates" in before


def test_an_error_that_ended_the_run_before_it_was_resumed_keeps_its_kind_and_place(data):
    error = {"kind": "PortLost", "what": "The port is gone.", "where": "/dev/gimbal", "remedy": "Plug it in."}
    html = page_with(data, gates=[], deviations=[], failures=[error])
    text = "The run failed and was resumed. PortLost (/dev/gimbal): The port is gone."
    assert html.count(text) == 2  # before the result, and among the deviations
