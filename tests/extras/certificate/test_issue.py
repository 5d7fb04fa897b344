"""Certificates issued from sealed runs: complete or refused, whatever is wrong and whenever the process dies."""

import json
import re
import shutil
from dataclasses import replace
from datetime import timedelta
from unittest import mock

import pytest
from certificate_lab import FIRST, Lab
from certificate_sample import LAB
from sealed_bench import NOW, sample_results, write_sealed_run

from bench.base.bounded_json import canonical_json
from bench.base.clock import VirtualClock
from bench.base.errors import EvidenceError, RunFolderError, UsageError
from bench.evidence.findings import SealFault
from bench.extras.certificate import certificate_folder, sealed_run
from bench.extras.certificate import issue as issue_module
from bench.extras.certificate.amend import amend, plots_in
from bench.extras.certificate.certificate_data import Certificate, Software
from bench.extras.certificate.certificate_folder import certificate_files
from bench.extras.certificate.check import check_certificate
from bench.extras.certificate.issue import issue
from bench.extras.certificate.series import numbers
from bench.record.ledger import Ledger
from bench.record.storage import sha256_of
from tests.unit.bench.evidence.resealed import copied as copy_of


class Killed(BaseException):
    """Stands for a process that ends at once."""


@pytest.fixture(scope="module")
def real(tmp_path_factory):
    """A certificate with PDF, DCC and plots, and its laboratory."""
    bench = Lab(tmp_path_factory.mktemp("real"))
    bench.issued = bench.issue()
    return bench


@pytest.fixture
def copied(real, tmp_path):
    """A copy of the real certificate that a test may change."""
    return copy_of(real.issued.folder, tmp_path / "copy")


def test_what_was_issued_is_derived_again_to_the_byte(real):
    verification = check_certificate(real.issued.folder, real.ledger)
    assert (verification.faults, verification.not_compared) == ([], [])
    assert real.issued.certificate.run.seal_sha256 == sha256_of(real.run / "SHA256SUMS")


def test_the_same_input_gives_the_same_bytes(real, tmp_path):
    other = Lab(tmp_path)
    for name in ("bench_key", "bench_key.pub"):
        shutil.copy(real.home / name, other.home / name)
    other.run = real.run
    assert other.issue("another name").seal == real.issued.seal


MUTATIONS = {
    "a value": ("certificate.json", b'"U": 2.0,', b'"U": 1.9,'),
    "a verdict": ("certificate.json", b'"verdict": "conditionalPass"', b'"verdict": "pass"'),
    "simulated": ("certificate.json", b'"simulated": true', b'"simulated": false'),
    "spaces": ("certificate.json", b'"number":', b'"number" :'),
    "lab.yaml": ("lab.yaml", b"Mill Lane 3", b"Mill Lane 9"),
    "a clause taken out": ("lab.yaml", b"external: [Humidity", b"# external: [Humidity"),
    "results.json": ("results.json", b'"fx": 3345.9', b'"fx": 3347.9'),
    "the DCC": ("dcc.xml", b"3346.0", b"3346.5"),
    "the PDF": ("certificate.pdf", b"\n%%EOF", b"\n%%EOG"),
    "a plot": ("plots/uncertainty.svg", b"</svg>", b'<rect width="99" height="99"/></svg>'),
}


@pytest.mark.parametrize("name", MUTATIONS)
def test_a_change_by_whoever_holds_the_key_is_found_and_no_version_takes_other_numbers(copied, name):
    file, old, new = MUTATIONS[name]
    data = (copied / file).read_bytes()
    assert old in data
    (copied / file).write_bytes(data.replace(old, new, 1))
    assert check_certificate(copied).faults, f"{name} was overlooked"
    if name in {"a value", "a verdict", "simulated"}:
        with by_another_program():
            assert check_certificate(copied).faults


def test_a_file_that_is_missing_is_found(copied):
    (copied / "dcc.xml").unlink()
    assert ("dcc.xml", "missing") in [(fault.where, fault.kind) for fault in check_certificate(copied).faults]


def test_a_signature_inside_the_dcc_is_named_as_not_checked_and_hides_no_change(copied):
    """Earlier versions signed the DCC on request."""
    end = b"</dcc:digitalCalibrationCertificate>\n"
    signature = b'<ds:Signature xmlns:ds="http://www.w3.org/2000/09/xmldsig#"></ds:Signature>\n'
    certificate = Certificate.from_json((copied / "certificate.json").read_bytes())
    results, lab = ((copied / name).read_bytes() for name in ("results.json", "lab.yaml"))
    signed = (copied / "dcc.xml").read_bytes().replace(end, signature + end)
    files = certificate_files(
        certificate, json.loads(results), results, lab, plots_in(copied), stored_dcc=signed
    )
    for name, data in files.items():
        (copied / name).write_bytes(data)
    verification = check_certificate(copied)
    assert (verification.faults, verification.not_compared) == ([], [])
    assert any("xmlsec1" in remark for remark in verification.remarks)
    (copied / "dcc.xml").write_bytes(signed.replace(b"3346.0", b"3346.5", 1))
    assert [fault.where for fault in check_certificate(copied).faults] == ["dcc.xml", "certificate.pdf"]


def test_a_statement_that_issuing_does_not_make_is_found(copied):
    path = copied / "certificate.json"
    old = "the sealed run was verified: its seal"
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, "an independent laboratory calibrated again: its seal"))
    (fault,) = check_certificate(copied).faults
    assert "what was verified" in fault.what


def by_another_program():
    """This program as another version of itself."""
    here = (Software("certificate_form", "0" * 16),)
    return mock.patch.object(sealed_run, "written_with", return_value=here)


def test_documents_and_words_of_another_version_are_no_fault_but_named(copied):
    pdf, path = copied / "certificate.pdf", copied / "certificate.json"
    pdf.write_bytes(pdf.read_bytes().replace(b"\n%%EOF", b"\n%%EOG"))
    with by_another_program():
        verification = check_certificate(copied)
    assert verification.faults == []
    named = r"certificate\.pdf: it was written with certificate form \w{16} \(here 0{16}\)"
    assert re.fullmatch(named, verification.not_compared[0])
    path.write_bytes(path.read_bytes().replace(b"Nothing was adjusted", b"Nobody adjusted anything"))
    assert "does not follow" in str(check_certificate(copied).faults[0])
    with by_another_program():
        verification = check_certificate(copied)
    assert verification.faults == []
    assert verification.not_compared[0].startswith("certificate.json, certificate.pdf and dcc.xml: ")


def test_an_earlier_version_may_have_divided_u_of_a_method_of_reference_otherwise(tmp_path, monkeypatch):
    results = sample_results()
    calibration = {**results["calibration"], "coverage_factors": {}, "coverage_factor": 2.2215}
    path = tmp_path / "reference.json"
    path.write_bytes(canonical_json({**results, "calibration": calibration}))
    monkeypatch.setattr("sealed_bench.RESULTS", path)
    issued = Lab(tmp_path).issue()
    first, *others = issued.certificate.results
    for changed, passes in (
        ({"u": first.u / 1.25, "k": first.k * 1.25}, True),
        ({"U": 1.25 * first.U}, False),
    ):
        stated = replace(issued.certificate, results=(replace(first, **changed), *others))
        (issued.folder / "certificate.json").chmod(0o644)
        (issued.folder / "certificate.json").write_bytes(stated.to_json())
        with by_another_program():
            assert (check_certificate(issued.folder).faults == []) == passes


def test_the_ledger_tells_of_another_seal_and_of_a_void_number(real, copied):
    (copied / "SHA256SUMS").write_bytes(b"")
    assert "another seal" in str(check_certificate(copied, real.ledger).faults[0])
    unknown = check_certificate(copied, Ledger(copied, VirtualClock(NOW)))
    assert "not in the ledger" in unknown.remarks[0]


CHANGED = {"faults": (SealFault("changed", "views.h5", "it was changed"),)}


@pytest.mark.parametrize(
    ("say", "named"),
    [
        (CHANGED, "does not verify: views.h5: it was changed"),
        ({"kind": "results"}, "is a results folder, not a run"),
        ({"kind": "certificate"}, "is a certificate folder, not a run.*amend"),
    ],
)
def test_a_run_that_does_not_verify_is_refused(lab, say, named):
    lab.says = say
    with pytest.raises(EvidenceError, match=named):
        lab.issue()
    assert lab.numbers() == {}


@pytest.mark.parametrize("part", ["not_compared", "not_confirmed"])
def test_no_certificate_is_issued_over_what_was_not_compared_or_is_not_confirmed(lab, part):
    lab.says = {part: ["report.html: it was made by another version"], "again": True}
    with pytest.raises(EvidenceError, match=r"report\.html") as refused:
        lab.issue()
    assert "version" in refused.value.remedy
    assert lab.numbers() == {}


@pytest.mark.parametrize(("again", "words"), [(True, "are the same"), (False, "were not made again")])
def test_a_certificate_states_whether_the_results_were_made_again(lab, again, words):
    lab.says = {"again": again}
    assert words in lab.issue().certificate.statement("verification")


NOT_CONVERGED = {**sample_results(), "calibration": {**sample_results()["calibration"], "converged": False}}


@pytest.mark.parametrize(
    ("facts", "named"),
    [
        ({"how": "failed"}, "did not finish: it failed"),
        ({"rehearsal": True}, "is a rehearsal: nothing was measured"),
        ({"results": NOT_CONVERGED}, "did not converge"),
    ],
)
def test_a_run_without_a_result_is_refused(lab, facts, named):
    lab.run = write_sealed_run(lab.path / "other", lab.home, **facts)
    with pytest.raises(EvidenceError, match=named):
        lab.issue()


def unsealed(lab):
    lab.run.chmod(0o755)
    (lab.run / "SHA256SUMS.sig").unlink()


def of_results(**parts):
    """Let the laboratory have a run with other results."""

    def change(lab):
        results = {**sample_results(), **parts}
        lab.run = write_sealed_run(lab.path / "run2", lab.home, results=results)

    return change


OF_A_BOARD = {**sample_results()["run"], "board": "checkerboard:9x7:2mm"}
ENDED_LATER = {**sample_results()["run"], "finished_utc": (NOW + timedelta(days=1)).isoformat()}


@pytest.mark.parametrize(
    ("change", "error", "named"),
    [
        (unsealed, EvidenceError, "is not sealed"),
        (lambda lab: setattr(lab, "run", lab.path), RunFolderError, "is not a run folder"),
        (lambda lab: (lab.path / "certificate").touch(), UsageError, "already exists"),
        (of_results(run=OF_A_BOARD), EvidenceError, "a board"),
        (of_results(poses=None), RunFolderError, "have another form: poses is of another type"),
        (of_results(run=ENDED_LATER), EvidenceError, "but the calibration ended on 2026-11-22"),
    ],
    ids=["not sealed", "no run", "folder exists", "board", "another form", "ends after its issue"],
)
def test_what_cannot_become_a_certificate_is_refused_and_takes_no_number(lab, change, error, named):
    change(lab)
    with pytest.raises(error, match=named):
        lab.issue()
    assert lab.numbers() == {}


def test_a_certificate_is_not_written_into_a_sealed_folder(lab):
    with pytest.raises(UsageError, match="is sealed"):
        issue(lab.run, lab.lab, lab.run / "certificate", lab.laboratory())
    assert lab.numbers() == {}


def test_missing_clauses_are_named_all_at_once_with_their_key(lab):
    lines = lab.faults("format: starbench/lab/1\n")
    assert len(lines) > 20
    clause = "ISO/IEC 17025, 7.8.2.1 e: name and contact of the customer"
    named = f"lab.yaml:1:1: customer.name: is missing. {clause}. Add it."
    assert any(line.endswith(named) for line in lines)


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ("serial: 00050423", "serial: 50423", "item.serial: the run calibrated camera 00050423, not 50423"),
        ("received: 2026-11-18", "received: 2026-11-22", "item.received: .* 2026-11-21"),
        ("result: fx", "result: fz", r"decision_rules\[0\].result: .* 'fz'. .* fx, fy"),
        ("scale of the print", "scale of print", r"sources\[1\].row: .* 'scale of print'"),
        ("collimator, issuer", "collimator, number: X-1, issuer", "number: .* 'SIM-2026-01', not 'X-1'"),
        ("name: warm-up", "name: camera temperature", "the run itself recorded this condition"),
        ("{number: SB-2025-00104, date: 2025", "{number: X, date: 2027", "before"),
        ("name: Customer & Sons <GmbH>", "name: TBD", "customer.name: 'TBD' identifies nothing"),
        ("external: [Humidity sensor calibrated by Klimalabor GmbH.]\n", "", "external: .* 7.8.2.1 p"),
    ],
)
def test_contradictions_and_gaps_are_refused_with_their_place(lab, old, new, named):
    assert old in LAB
    (line,) = lab.faults(LAB.replace(old, new))
    assert re.search(named, line), line


def test_no_interval_is_printed_unless_the_customer_agreed(lab):
    assert "agreed with the customer" in lab.faults(LAB + "recalibration: every 12 months\n")[0]
    lab.lab.write_text(LAB + "recalibration: agreed with the customer, 12 months\n", encoding="utf-8")
    text = lab.issue().certificate.to_json().decode()
    assert "customer, 12 months" in text
    lab.lab.write_text(LAB, encoding="utf-8")
    assert not re.search("ecalibration| due", lab.issue("second", also="x").certificate.to_json().decode())


@pytest.mark.parametrize("at", ["certificate_files", "write_sealed", "seal_folder", "_enter"])
def test_killed_at_any_point_the_next_command_ends_it_with_the_same_number(lab, at):
    module = certificate_folder if at == "seal_folder" else issue_module
    with mock.patch.object(module, at, side_effect=Killed), pytest.raises(Killed):
        lab.issue()
    assert lab.numbers() == {FIRST: "reserved"}
    whole = at == "_enter"
    assert (lab.path / "certificate").exists() == whole
    if whole:
        second = write_sealed_run(lab.path / "run2", lab.home, results={**sample_results(), "states": []})
        lab.run = second
        issued = lab.issue("second")
        assert issued.completed == (FIRST,)
        assert lab.numbers() == {FIRST: "issued", issued.certificate.number: "issued"}
    else:
        assert lab.issue("another name").certificate.number == FIRST
        assert lab.numbers() == {FIRST: "issued"}
    assert [path.name for path in lab.path.iterdir() if path.name.endswith(".tmp")] == []


def test_an_amendment_names_the_old_one_by_hash_and_what_changed(lab):
    first = lab.issue("first")
    second = lab.amend("first", "second")
    amends = second.certificate.amends
    assert (amends.number, amends.sha256, amends.reason) == (FIRST, first.seal, "wrong address")
    assert [(c.field, c.before, c.after) for c in amends.changes] == [
        ("customer.address.street", "Mill Lane 3", "Mill Lane 4")
    ]
    assert numbers(lab.ledger.entries())[FIRST].superseded_by == second.certificate.number
    assert lab.path.joinpath("first", "certificate.json").exists()


@pytest.mark.parametrize(
    ("says", "text", "named"),
    [
        ({}, "Mill Lane 3", "Nothing would change"),
        ({"faults": (SealFault("changed", "dcc.xml", "changed"),)}, "Mill Lane 4", r"verify: dcc\.xml"),
        ({"kind": "run"}, "Mill Lane 4", "is a run folder, not a certificate"),
    ],
)
def test_only_a_changed_certificate_that_verifies_is_amended(lab, says, text, named):
    lab.issue("first")
    lab.says = says
    with pytest.raises(EvidenceError, match=named):
        lab.amend("first", "second", new_text=text)
    assert lab.numbers() == {FIRST: "issued"}


def superseded(real, lab):
    """Amend a certificate on this bench; return the folder of the old one, and the new one."""
    shutil.copytree(real.home, lab.home, dirs_exist_ok=True)
    lab.lab.write_text(LAB.replace("Mill Lane 3", "Mill Lane 4"), encoding="utf-8")
    second = amend(real.issued.folder, lab.lab, lab.path / "second", lab.laboratory(), reason="x")
    return real.issued.folder, second


def test_a_superseded_certificate_says_so(real, lab):
    folder, second = superseded(real, lab)
    verification = check_certificate(folder, lab.ledger)
    remark = f"SUPERSEDED: {second.certificate.number} replaces this certificate"
    assert (verification.faults, verification.remarks) == ([], [remark])
    lab.ledger.path.write_bytes(b"")
    (lab.home / "ledger_high").unlink()
    faults = [fault.what for fault in check_certificate(folder, lab.ledger).faults]
    assert any("ledger does not contain it" in what for what in faults)


def cut(ledger, lines):
    """Take lines from the end of a ledger; its mark stays."""
    whole = ledger.path.read_bytes().splitlines(keepends=True)
    ledger.path.write_bytes(b"".join(whole[:-lines]))


def test_a_replaced_certificate_is_not_valid_after_a_rollback_and_not_known_when_that_is_explained(real, lab):
    folder, _ = superseded(real, lab)
    cut(lab.ledger, 2)
    (fault,) = check_certificate(folder, lab.ledger).faults
    assert fault.kind == "ledger"
    assert "2 are missing" in fault.what
    assert "a lost line" in fault.what
    lab.ledger.explain("The disk was restored from a copy.", "Ada")
    verification = check_certificate(folder, lab.ledger)
    assert verification.faults == []
    assert "replaced or declared void" in verification.not_compared[0]


def test_an_amendment_that_the_ledger_does_not_know_is_found(real, lab):
    with mock.patch.object(issue_module, "certificate_files", certificate_files):
        _, second = superseded(real, lab)
    assert check_certificate(second.folder, lab.ledger).faults == []
    path = second.folder / "certificate.json"
    path.chmod(0o644)
    path.write_bytes(path.read_bytes().replace(real.issued.seal.encode(), b"0" * 64))
    faults = [fault.what for fault in check_certificate(second.folder, lab.ledger).faults]
    assert any(f"replaces {FIRST}" in what for what in faults)
