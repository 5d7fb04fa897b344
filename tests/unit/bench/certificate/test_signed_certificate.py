"""A certificate whose digital part carries a signature: issued, derived again, and refused where it was changed."""

import shutil

import lab_pki
import pytest
from certificate_sample import LAB, NOW, verified, write_sealed_run

from bench.base.errors import EvidenceError
from bench.certificate.check import check_certificate
from bench.certificate.dcc_signature import sign_dcc, verify_signature, without_signature
from bench.certificate.issue import Laboratory, issue
from bench.certificate.series import numbers
from bench.evidence.keys import ensure_key
from bench.records.ledger import Ledger


def laboratory(path, sign):
    home = path / "home"
    run = write_sealed_run(path / "run", home)
    (path / "lab.yaml").write_text(LAB, encoding="utf-8")
    ledger = Ledger(home, utc_now=lambda: NOW, monotonic=lambda: 0.0)
    place = ledger.begin(run_id="run", folder=run, camera="00050423", simulated=True)
    ledger.end(place["number"], how="finished", folder=run)
    return run, Laboratory(ledger, lambda: ensure_key(home), lambda: NOW, verified, sign)


def signer(begin=lab_pki.BEGIN):
    key, certificate = lab_pki.seal(begin=begin)
    return lambda data, when: sign_dcc(data, key, [certificate], signed_utc=when)


@pytest.fixture(scope="module")
def signed(tmp_path_factory):
    path = tmp_path_factory.mktemp("signed")
    run, lab = laboratory(path, signer())
    return issue(run, path / "lab.yaml", path / "certificate", lab).folder


def test_a_signed_certificate_is_derived_again(signed):
    found = verify_signature((signed / "dcc.xml").read_bytes(), "dcc.xml", trusted=[lab_pki.authority()[1]])
    assert found.trusted
    again = check_certificate(signed)
    assert (again.faults, again.not_compared) == ([], [])
    assert any("signature of CN=Lab seal P-256" in remark for remark in again.remarks)


def attack(signed, tmp_path, change):
    folder = tmp_path / "copy"
    shutil.copytree(signed, folder)
    for path in (folder, *folder.rglob("*")):
        path.chmod(0o755)
    data = (folder / "dcc.xml").read_bytes()
    (folder / "dcc.xml").write_bytes(change(data))
    return check_certificate(folder).faults


def test_a_changed_or_missing_signature_is_a_fault(signed, tmp_path):
    assert attack(signed, tmp_path / "1", lambda data: data.replace(b"Mill Lane 3", b"Mill Lane 4"))
    assert attack(signed, tmp_path / "2", without_signature), "the PDF has the signed DCC attached"

    def other(data):
        key, certificate = lab_pki.seal("P-384")
        return sign_dcc(without_signature(data), key, [certificate], signed_utc=NOW)

    assert attack(signed, tmp_path / "3", other), "the PDF has the DCC with the first signature attached"


def test_a_key_that_cannot_sign_is_refused_before_a_number_is_taken(tmp_path):
    run, lab = laboratory(tmp_path, signer(begin=lab_pki.signed_at(700)))
    with pytest.raises(EvidenceError, match="is valid from 2027-12-02"):
        issue(run, tmp_path / "lab.yaml", tmp_path / "certificate", lab)
    assert not numbers(lab.ledger.entries())
    assert not (tmp_path / "certificate").exists()
