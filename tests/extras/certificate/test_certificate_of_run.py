"""What a certificate says is what the sealed run says: limits, settings, hashes, dates, and numbers after a restore."""

import copy
import dataclasses
import re
import shutil
from datetime import timedelta

import pytest
from certificate_lab import FIRST, Lab
from certificate_sample import LAB, full_dcc
from sealed_bench import sample_results, write_sealed_run

from bench.base.errors import EvidenceError
from bench.extras.certificate.amend import amend
from bench.extras.certificate.check import check_certificate
from bench.record.conformity import conformity
from bench.record.stored_calibration import stored_calibration
from sequences.schema import ResultLimitConfig


def test_deviations_of_the_run_enter_by_themselves(lab):
    results = copy.deepcopy(sample_results())
    results["deviations"] = ["Pose 2 (right) was skipped by ada."]
    results["run"]["resumed"] = 2
    results["gates"][0] |= {"verdict": "fail"}
    lab.run = write_sealed_run(lab.path / "run2", lab.home, results=results)
    deviations = [(deviation.text, deviation.source) for deviation in lab.issue().certificate.deviations]
    assert deviations == [
        ("Pose 2 (right) was skipped by ada.", "run"),
        ("The run was resumed 2 times.", "run"),
        ("Limit not met: pose 1: stars is 200, limit >= 40.", "run"),
        ("Warm-up of 20 min instead of 30 min.", "laboratory"),
    ]


# ---------------------------------------------------------------- never more than the sealed run

WIDE = "  - {result: fx, specification: drawing 4711, lower: 3300, upper: 3400}"
OWN = '  - {result: fx, specification: "Customer drawing 4711, focal length", lower: 3340, upper: 3347}'


@pytest.fixture
def failed(lab):
    """A laboratory whose limits pass, and whose run says FAIL by the narrower ones of its sequence."""
    results = copy.deepcopy(sample_results())
    rules = [ResultLimitConfig(result="fx", specification="drawing 4711", upper=3300.0)]
    results["conformity"] = conformity(stored_calibration(results["calibration"]), {"sequence": rules}, [])
    assert not results["conformity"].passed
    lab.run = write_sealed_run(lab.path / "failed", lab.home, results=results)
    text = LAB.replace(OWN, WIDE)
    assert WIDE in text
    lab.lab.write_text(text, encoding="utf-8")
    return lab


def test_a_pass_over_a_sealed_fail_is_refused_and_takes_no_number(failed):
    with pytest.raises(EvidenceError, match=r"FAIL: fx .* fx, k2"):
        failed.issue()
    assert failed.numbers() == {}


def test_a_pass_over_a_sealed_fail_with_a_reason_says_so_itself(failed):
    made = failed.issue(despite="waived").certificate
    assert "FAIL: 0 of 1 limits kept." in made.statement("limits")
    assert made.statement("limits_reason") == "waived"
    assert [
        (statement.lower, statement.upper, statement.verdict)
        for statement in made.conformity
        if statement.symbol == "fx"
    ] == [(3300.0, 3400.0, "pass"), (None, 3300.0, "fail")]
    failed.lab.write_text(failed.lab.read_text().replace("Mill Lane 3", "Mill Lane 4"), encoding="utf-8")
    again = amend(
        failed.path / "certificate", failed.lab, failed.path / "again", failed.laboratory(), reason="address"
    )
    assert again.certificate.statement("limits_reason") == "waived"
    failed.lab.write_text(LAB, encoding="utf-8")


def test_a_reason_that_the_certificate_does_not_need_is_not_stated(lab):
    assert lab.issue(despite="no matter").certificate.statement("limits") == ""


def test_the_verifier_asks_for_the_statement_and_for_a_date_after_the_run(failed):
    issued = failed.issue(despite="waived")
    path = issued.folder / "certificate.json"
    for name in ("dcc.xml", "certificate.pdf", "VERIFY.txt"):
        (issued.folder / name).touch()
    whole = issued.certificate

    def faults(changed):
        path.chmod(0o644)
        path.write_bytes(changed.to_json())
        return " ".join(map(str, check_certificate(issued.folder).faults))

    silent = dataclasses.replace(
        whole,
        statements=tuple(statement for statement in whole.statements if statement.id != "limits_reason"),
    )
    assert "over a FAIL" in faults(silent)
    early = dataclasses.replace(whole, issued_utc="2025-11-21T08:30:00Z")
    assert "before its calibration ended" in faults(early)


def test_sequence_and_station_are_bound_by_hash_and_compared_with_the_run(lab):
    issued = lab.issue()
    assert issued.certificate.run.sequence_sha256 == ""  # the run of the sample has no files
    run = dataclasses.replace(issued.certificate.run, sequence_sha256="ab" * 32)
    (lab.run / "sequence.yaml").parent.chmod(0o755)
    (lab.run / "sequence.yaml").write_text("name: another")
    for name in ("dcc.xml", "certificate.pdf", "VERIFY.txt"):
        (issued.folder / name).write_bytes(full_dcc())
    (issued.folder / "certificate.json").chmod(0o644)
    changed = dataclasses.replace(issued.certificate, run=run)
    (issued.folder / "certificate.json").write_bytes(changed.to_json())
    verification = check_certificate(issued.folder, lab.ledger)
    assert "names another sequence.yaml" in " ".join(map(str, verification.faults))


# ---------------------------------------------------------------- a home that was restored


def restored(lab, between):
    """What comes after the home was set back to its state before ``between``."""
    shutil.copytree(lab.home, lab.path / "backup")
    made = between()
    shutil.rmtree(lab.home)
    shutil.copytree(lab.path / "backup", lab.home)
    return made


def test_no_number_is_given_twice_after_an_older_home_was_restored(lab):
    first = restored(lab, lambda: lab.issue("first"))
    again = lab.issue("again")
    assert first.certificate.number == FIRST
    assert again.certificate.number == FIRST.replace("00001", "00002")
    assert lab.numbers() == {FIRST: "lost", again.certificate.number: "issued"}


def test_a_certificate_of_another_bench_beside_the_new_folder_takes_no_number(lab, tmp_path):
    other = Lab(tmp_path / "other")
    (tmp_path / "other").mkdir(exist_ok=True)
    other.issue("first")
    shutil.copytree(other.path / "first", lab.path / "first")
    assert lab.issue("own").certificate.number == FIRST


def test_of_two_numbers_with_one_count_the_part_of_the_ledgers_head_differs(lab):
    text = LAB.replace('numbers: {format: "SB-{year}-{number:05d}"}\n', "")
    assert text != LAB
    lab.lab.write_text(text, encoding="utf-8")
    first = restored(lab, lambda: lab.issue("certificates/first")).certificate
    lab.now += timedelta(hours=1)
    again = lab.issue("elsewhere/first").certificate
    assert [re.sub("[0-9a-f]{4}$", "head", certificate.number) for certificate in (first, again)] == [
        "SIMULATED-SB-2026-00001-head"
    ] * 2
    assert first.number != again.number
