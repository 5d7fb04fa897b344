"""The verdicts of a camera's runs on the certificate: no FAIL is forgotten by another run, or by other limits."""

import re

import pytest
from certificate_sample import LAB

from bench.record.run_verdict import RunVerdict, hashes_of

DRAWING = "Drawing 4711"
NARROW, WIDE = ("fx", 3345.9, 3346.0), ("fx", 3000.0, 4000.0)
SERIAL = "00050423"


def enter(lab, verdict, *, camera=SERIAL, simulated=True, how="finished"):
    place = lab.ledger.begin(run_id="other", folder=lab.path / "other", camera=camera, simulated=simulated)
    lab.ledger.end(place["number"], how=how, folder=lab.path / "other", verdict=verdict)


def judged(verdict, limits=NARROW, *, camera=SERIAL):
    return RunVerdict(verdict, hashes_of({DRAWING: [limits]}), limits_stated_before=True, camera=camera)


WITHOUT = RunVerdict(None, {}, limits_stated_before=False, camera=SERIAL)


def with_limits(lab, limits):
    name, lower, upper = limits
    rules = (
        f"decision_rules:\n  - {{result: {name}, specification: {DRAWING}, lower: {lower}, upper: {upper}}}\n"
    )
    text, count = re.subn(r"(?ms)^decision_rules:.*?(?=^\w)", rules, LAB)
    assert count == 1
    lab.lab.write_text(text, encoding="utf-8")


def test_a_fail_then_a_run_without_limits_then_wide_limits_shows_the_fail(lab):
    enter(lab, judged("FAIL"))
    enter(lab, WITHOUT)
    with_limits(lab, WIDE)
    text = lab.issue().certificate.statement("verdicts")
    assert f"1 FAIL against {DRAWING}" in text
    assert "1 without limits" in text
    assert "stated after the run" in text


@pytest.mark.parametrize(
    ("verdict", "facts", "counts"),
    [
        (judged("PASS", WIDE), {}, True),
        (judged("FAIL"), {"simulated": False}, False),
        (judged("FAIL", camera="1"), {"camera": "1"}, False),
        (judged("FAIL"), {"camera": ""}, True),
        (None, {"how": "aborted"}, True),
        (None, {}, True),
    ],
)
def test_runs_of_this_camera_count_also_those_that_did_not_finish(lab, verdict, facts, counts):
    with_limits(lab, WIDE)
    before = lab.issue("first").certificate.statement("verdicts")
    enter(lab, verdict, **facts)
    after = lab.issue("second", also="again").certificate.statement("verdicts")
    assert (after != before) == counts


def test_lines_of_earlier_versions_stay_readable(lab):
    assert [run.verdict for run in lab.ledger.runs()] == [None]
    assert "1 of an earlier version" in lab.issue().certificate.statement("verdicts")
