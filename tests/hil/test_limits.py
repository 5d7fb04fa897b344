"""PASS and FAIL of whole runs: first on the terminal and in the report, in the results, the exit status and a batch."""

import json
import re

import pytest
from quick_runs import END, THREE, quick_words, write_queue, write_sequence, write_station
from running import called, results

KEPT, MISSED = "{result: fx, lower: 1600, upper: 1750}", "{result: cx, upper: 300, specification: drawing 7}"


def run(home, folder, station, sequence_limits, status=0):
    words = quick_words(folder, THREE, station=station, seed=3, end=f"{END}limits: [{sequence_limits}]\n")
    return called(*words, home=home, status=status), folder / "run"


def test_one_limit_that_is_not_kept_fails_the_run_and_not_the_bench(home, tmp_path):
    ended, folder = run(home, tmp_path, f"limits: [{MISSED}]\n", KEPT, status=4)
    first, second, *_ = ended.stdout.splitlines()
    assert first == "FAIL: 1 of 2 limits kept."
    assert re.match(r"  cx 3\d\d.* 300 px by drawing 7\): outside", second)
    page = (folder / "report.html").read_text()
    assert page.index("FAIL: 1 of 2 limits kept.") < page.index("<h2>Result</h2>")
    assert 'class="verdict fail"' in page
    called("verify", folder, home=home)
    again = called("calibrate", folder, "-o", tmp_path / "again", home=home, status=4)
    assert again.stdout.startswith("FAIL: 1 of 2 limits kept.\n")
    assert results(tmp_path / "again")["conformity"] == results(folder)["conformity"]


@pytest.mark.slow
def test_a_batch_counts_such_a_run_as_done_and_tells_it(home, tmp_path):
    write_sequence(tmp_path / "s.yaml", THREE, end=f"{END}limits: [{MISSED}]\n")
    write_station(tmp_path / "b.yaml")
    queue = write_queue(tmp_path / "q.yaml", "name: one, sequence: s.yaml, station: b.yaml")
    ended = called("batch", queue, "-o", tmp_path / "night", "--json", home=home, status=4)
    (item,) = json.loads(ended.stdout)["items"]
    assert (item["how"], item["conformity"], item["attempts"]) == ("finished", "FAIL", 1)
    assert "FAIL by the limits" in (tmp_path / "night" / "summary.html").read_text()
