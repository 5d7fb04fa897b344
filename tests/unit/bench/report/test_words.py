"""The report tells what was done and found, and claims no more."""

import json
import re
from pathlib import Path

from report_sample import SMALL, sample

from bench.base.bounded_json import canonical_json
from bench.report.html import ReportData, render_report
from tests.support.printed_text import printed_text


def test_simulated_stands_on_screen_in_the_title_and_on_every_printed_page(html):
    assert any(words.startswith("SIMULATED: ") for words in printed_text(html))
    assert "<title>SIMULATED" in html
    assert '@top-right { content: "SIMULATED DEVICES"' in html
    assert '<div class="watermark" aria-hidden="true"><span>SIMULATED</span></div>' in html


def test_nothing_is_called_simulated_on_a_real_bench():
    data = sample(size=SMALL, simulated=False)
    html = render_report(data)
    assert "SIMULATED" not in html
    assert "truth" not in " ".join(printed_text(html)).lower()


def test_the_ledger_tells_of_the_camera_s_other_runs(data, results, html):
    words = printed_text(html)
    assert "12 of this bench; earlier runs of this camera: 2 finished" in words
    assert data.results["run"]["ledger"]["head"] in words
    del results["run"]["ledger"]
    assert "ledger" not in " ".join(printed_text(render_report(ReportData(results)))).lower()


#: In results.json only if the station states it, or if a board was seen; not in the sample.
ONLY_IF_STATED = {"conformity", "run.target", "run.board", "run.plugins"}
ONLY_IF_STATED |= {"calibration.boresight", "check", "mount_faces"}


def test_what_is_documented_of_the_results_is_in_them(data):
    document = (Path(__file__).parents[4] / "docs" / "results.md").read_text(encoding="utf-8")
    table = document.partition("## An offline calibration")[0]
    paths = [
        p for row in re.findall(r"^\| (`.*?`) \|", table, re.MULTILINE) for p in re.findall(r"`([^`]+)`", row)
    ]
    assert len(paths) > 30
    for path in set(paths) - ONLY_IF_STATED:
        place = json.loads(canonical_json(data.results))
        for key in path.split("."):
            place = place[0] if isinstance(place, list) else place
            assert key in place, path
            place = place[key]


def test_every_part_of_the_results_is_documented(data):
    table = (Path(__file__).parents[4] / "docs" / "results.md").read_text(encoding="utf-8")
    names = [*data.results, *data.results["run"], *data.results["calibration"], *data.results["poses"][0]]
    assert [name for name in names if not re.search(rf"\b{name}\b", table)] == []
