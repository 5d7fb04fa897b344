"""What a person reads first: warnings before the numbers."""

from bench.base.failure import Failure
from bench.report.html import ReportData, render_report


def test_what_speaks_against_a_result_stands_before_it_and_a_failure_keeps_its_kind_and_place(data):
    gate = {"name": "rms", "value": 0.31, "unit": "px", "limit": "<= 0.2", "verdict": "fail"}
    error = Failure("PortLost", "The port is gone.", "/dev/gimbal", "Plug it in.")
    told = {"gates": [gate], "deviations": ["Held by ada for 3 s."], "failures": [error]}
    html = render_report(ReportData({**data.results, **told}))
    before, _, after = html.partition("<h2>Result</h2>")
    assert "Gate rms: fail (0.310, limit \N{LESS-THAN OR EQUAL TO} 0.2 px" in before
    assert "Held by ada for 3 s." in before
    assert 'class="verdict fail"' in before
    text = "The run failed and was resumed. PortLost (/dev/gimbal): The port is gone."
    assert (before.count(text), after.count(text)) == (1, 1)  # here, and among the deviations
