"""The clauses of ISO/IEC 17025: each is answered or named; the table of the documentation has them all."""

import json
import re
from dataclasses import replace

import pytest
import yaml
from certificate_sample import LAB, identity, sample_lab
from refusals import faults_of
from sealed_bench import sample_results

from bench.extras.certificate.clauses import faults_of_lab, unanswered
from bench.extras.certificate.compose import compose
from bench.extras.certificate.lab_config import EXAMPLE, LabConfig
from sequences.reader import read_document

NUMBERS = 'numbers: {format: "SB-{year}-{number:05d}"}'
NOTHING = "format: starbench/lab/1\n"


SEQUENCE = "5e" * 32


@pytest.mark.parametrize("used", ["", "6f" * 32])
def test_a_lab_that_answers_every_clause_has_no_fault_and_a_method_that_names_its_sequence_allows_no_other(
    used,
):
    lab = sample_lab(LAB.replace("version: 3.2,", f"version: 3.2, sequence_sha256: {SEQUENCE},"))
    assert faults_of_lab(lab, sample_results(), SEQUENCE) == []
    (fault,) = faults_of_lab(lab, sample_results(), used)
    assert fault.path == "method.sequence_sha256"
    assert f"another sequence.yaml: SHA-256 {used or 'not known'}" in str(fault)


def test_every_key_of_a_clause_can_be_missing_and_is_then_named():
    named = {clause.number for clause, _ in unanswered(sample_lab(NOTHING).value, sample_results())}
    assert {"7.8.2.1 b", "7.8.2.1 c", "7.8.2.1 e", "7.8.2.1 f", "7.8.2.1 g", "7.8.2.1 h", "7.8.2.1 n"} < named
    assert {"7.8.2.1 o", "7.8.2.1 p", "7.8.2.2", "7.8.4.1 b", "7.8.4.1 c", "7.8.4.1 d"} < named


def test_a_reference_without_number_date_or_issuer_is_named():
    without = {**sample_results(), "passport": replace(sample_results()["passport"], number=None, date=None)}
    keys = [key for _, key in unanswered(sample_lab().value, without)]
    assert keys == ["sources.number", "sources.date"]
    none = {**sample_results(), "passport": None}
    assert [key for _, key in unanswered(sample_lab().value, none)] == []
    bare = sample_lab(LAB.replace("number: R-17, ", "")).value
    assert [key for _, key in unanswered(bare, none)] == ["sources"]


def test_the_example_has_every_section_and_names_every_placeholder():
    lines = faults_of(read_document, EXAMPLE, LabConfig)
    assert len(lines) == EXAMPLE.read_text(encoding="utf-8").split("laboratory:", 1)[1].count("REPLACE")
    assert all("REPLACE" in line or "replace this placeholder" in line for line in lines)


def test_the_schema_of_lab_yaml_takes_what_the_reader_takes():
    """An editor reads numbers, dates and booleans; Starbench reads text."""
    jsonschema = pytest.importorskip("jsonschema")
    schema = LabConfig.model_json_schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    check = jsonschema.Draft202012Validator(schema)
    nothing = re.sub(r"(deviations|external): \[.*\]", r"\1: none", LAB).replace(
        "accreditation: {body: DAkkS, number: D-K-00000-01-00, scope: Geometric calibration of cameras}",
        "accreditation: none",
    )
    for text in (LAB, nothing):
        document = json.loads(json.dumps(yaml.safe_load(text), default=str))
        assert [error.message for error in check.iter_errors(document)] == []
        assert sample_lab(text).value.format == "starbench/lab/1"
    assert not check.is_valid({"format": "starbench/lab/1", "customer": {"nam": "x"}})


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ("country: GB", "country: England", r"customer.address.country: must be two capital letters"),
        ("value: 20.3", "value: .nan", "conditions[0].value"),
        ("accreditation: {body", "accreditation: {bodi", "laboratory.accreditation.bodi: "),
        (
            "accreditation: {body: DAkkS, number: D-K-00000-01-00, scope: Geometric calibration of cameras}",
            "accreditation: DAkkS",
            "laboratory.accreditation: must be 'none' or a mapping (key: value) (got 'DAkkS').",
        ),
        ("lower: 3340, upper: 3347", "lower: 3347, upper: 3340", "lower must be less than upper"),
        ("lower: 3340, upper: 3347", "", "needs lower, upper or both"),
        ("received: 2026-11-18", "received: 18.11.2026", "must be a date, year-month-day"),
        ("name: Customer & Sons <GmbH>", 'name: "a\\u0007b"', "a control character is not allowed"),
        ('key: "SHA256:AAA', 'key: "SHA1:AAA', "authorised_by.key: must be SHA256: and 43"),
        ("format: starbench/lab/1", "format: starbench/station/1", "wrong kind of document"),
        ("name: Ada Byron", "name: \u200b", "must contain no control characters"),
        (NUMBERS, "numbers: {format: SB-2026}", "format must contain {number:05d} once"),
        ("{number: SB-2025-00104, ", "{", "previous_certificate.number: "),
    ],
)
def test_a_fault_of_lab_yaml_is_named_with_its_place(old, new, named):
    assert old in LAB
    lines = faults_of(sample_lab, LAB.replace(old, new))
    assert any(named in line and line.startswith("lab.yaml:") for line in lines), lines


def test_a_camera_without_a_number_is_identified_by_the_laboratory():
    devices = sample_results()["devices"]
    camera = {**devices["camera"], "serial": "", "maker": "OpenCV", "model": "/dev/video0"}
    unnamed = {**sample_results(), "devices": {**devices, "camera": camera}}
    faults = faults_of_lab(sample_lab(), unnamed, SEQUENCE)
    assert [fault.path for fault in faults] == ["item.maker", "item.model"]
    own = "  serial: 00050423\n  maker: Basler\n  model: ace 2"
    named = sample_lab(LAB.replace("  serial: 00050423", own))
    assert faults_of_lab(named, unnamed, SEQUENCE) == []
    certificate = compose(unnamed, named.value, identity())
    assert certificate.item.camera.maker == "Basler"
    assert "from the item" in certificate.statement("identity")
    maker, _ = [str(fault) for fault in faults_of_lab(named, sample_results(), SEQUENCE)]
    assert "item.maker: the camera 00050423" in maker
