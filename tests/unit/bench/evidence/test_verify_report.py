"""Verification of what a report prints: the results that stand beside it, and nothing else."""

import json
import os
import shutil
from pathlib import Path

import pytest
from report_sample import sample

from bench.evidence.seal import seal
from bench.evidence.verify import verify_folder
from bench.records.journal import read_journal
from bench.records.run_folder import RunFolder
from bench.report.html import ReportData, render_report
from tests.unit.bench.evidence.resealed import kinds


@pytest.fixture(scope="module")
def reported_once(make_run, tmp_path_factory):
    """A run as yet unsealed, with a report of its results."""
    path = tmp_path_factory.mktemp("reported") / "run"
    with make_run(path) as folder:
        results = json.loads((path / "results.json").read_bytes())
        full = dict(sample(size=(160, 90)).results)
        full["poses"] = [
            {**pose, "attempts": [{**pose["attempts"][0], **a} for a in stored["attempts"]]}
            for pose, stored in zip(full["poses"], results["poses"], strict=False)
        ]
        full["comparison"] = []
        entries, _ = read_journal(path / "journal.jsonl")
        folder.write_atomic("results.json", json.dumps(full).encode())
        html = render_report(ReportData(full, sample(size=(160, 90)).views, entries[-2].hash))
        folder.write_atomic("report.html", html.encode())
    return path


@pytest.fixture
def reported(reported_once, tmp_path):
    return Path(shutil.copytree(reported_once, tmp_path / "reported"))


def sealed_and_verified(folder, key, signers):
    with RunFolder.open(folder) as held:
        seal(held, key)
    return verify_folder(folder, signers)


def test_a_report_that_prints_the_results_passes(reported, key, signers):
    found = sealed_and_verified(reported, key, signers)
    assert found.faults == ()
    assert found.remarks == ()


@pytest.mark.parametrize("printed", ["3346.4", "\N{PLUS-MINUS SIGN} 4.3", "0.0812", "41.27", "accepted"])
def test_a_report_that_prints_something_else_is_found(reported, key, signers, printed):
    report = reported / "report.html"
    text = report.read_text(encoding="utf-8")
    assert f">{printed}" in text
    report.write_text(text.replace(f">{printed}", f">{printed}1", 1), encoding="utf-8")
    found = sealed_and_verified(reported, key, signers)
    assert kinds(found) == [("report", "report.html")]
    assert f"{printed}1" in found.faults[0].what


def test_a_report_of_another_run_s_journal_is_found(reported, key, signers):
    report = reported / "report.html"
    head = read_journal(reported / "journal.jsonl")[0][-2].hash
    report.write_text(report.read_text(encoding="utf-8").replace(head, "0" * 64), encoding="utf-8")
    found = sealed_and_verified(reported, key, signers)
    assert kinds(found) == [("report", "report.html")]
    assert "names no line of this journal" in found.faults[0].what


def test_a_report_of_another_version_is_not_compared_and_that_is_told(reported, key, signers):
    results = json.loads((reported / "results.json").read_bytes())
    results["run"]["software"]["starbench"] = "0.0.9"
    (reported / "results.json").write_text(json.dumps(results))
    found = sealed_and_verified(reported, key, signers)
    assert found.ok
    assert "Starbench 0.0.9 wrote it" in found.remarks[0]


def test_results_that_no_report_can_be_made_of_are_found(reported, key, signers):
    results = json.loads((reported / "results.json").read_bytes())
    results["calibration"]["sigma"] = "unknown"
    (reported / "results.json").write_text(json.dumps(results))
    found = sealed_and_verified(reported, key, signers)
    assert kinds(found) == [("results", "results.json")]
    assert "no report can be made of these results" in found.faults[0].what


def test_a_report_that_is_no_text_is_found(reported, key, signers):
    (reported / "report.html").write_bytes(b"\xff\xfe" * 1000)
    assert kinds(sealed_and_verified(reported, key, signers)) == [("report", "report.html")]


def test_results_without_a_calibration_cannot_follow_from_recordings(sealed, signers):
    found = verify_folder(sealed, signers, recalculate=lambda folder: {}["calibration"])
    assert "no calibration to compare" in found.faults[0].what


@pytest.mark.parametrize(("name", "kind"), [("results.json", "results"), ("report.html", "report")])
def test_endless_results_and_reports_are_not_read(reported, key, signers, name, kind):
    os.truncate(reported / name, 1 << 27)
    assert (kind, name) in kinds(sealed_and_verified(reported, key, signers))
