import json

import certificate_sample
import lab_pki
import pytest
from click.testing import CliRunner

from bench.base.errors import EvidenceError, UsageError
from bench.certificate.dcc_signature import sign_dcc
from bench.commands.certificate_dcc import check

SIGNED = (
    "Signature: valid, by CN=Lab seal P-256,O=Lab (issued by CN=Lab authority,O=Lab), who states"
    " 2026-07-20 00:00:00 UTC as its time."
)


@pytest.fixture(autouse=True)
def no_schemas(monkeypatch):
    monkeypatch.delenv("STARBENCH_DCC_SCHEMAS", raising=False)


@pytest.fixture
def signed(tmp_path):
    key, certificate = lab_pki.seal()
    path = tmp_path / "dcc.xml"
    path.write_bytes(
        sign_dcc(certificate_sample.full_dcc(), key, [certificate], signed_utc=lab_pki.signed_at())
    )
    (tmp_path / "trusted.pem").write_bytes(lab_pki.pem(lab_pki.authority()[1]))
    (tmp_path / "other.pem").write_bytes(lab_pki.pem(lab_pki.authority("Other")[1]))
    return path


def run(*arguments):
    done = CliRunner().invoke(check, [str(one) for one in arguments], standalone_mode=False)
    if done.exception is not None:
        raise done.exception
    return done.return_value, done.output


def test_a_valid_certificate_and_what_was_not_checked(signed):
    trusted = ("--trusted", signed.parent / "trusted.pem")
    status, said = run(signed, *trusted)
    assert status == 0
    assert said.splitlines() == [
        "Certificate SIMULATED-SB-2026-00017: DCC 3.2.1 with D-SI 2.1.0.",
        SIGNED,
        "Not checked: the form. Name the folder of PTB's schemas with --schemas or in STARBENCH_DCC_SCHEMAS to check it.",
    ]
    assert "Not checked: who signed" in run(signed)[1]
    assert run(signed.parent)[0] == 0  # the folder of a certificate
    found = json.loads(run(signed, "--json", *trusted)[1])
    assert found["ok"] is True
    assert found["signature"]["trusted"] is True
    assert found["signature"]["stated_utc"] == "2026-07-20T00:00:00Z"


def test_faults(signed):
    signed.write_bytes(signed.read_bytes().replace(b">3346.4<", b">3346.5<", 1))
    status, said = run(signed)
    assert status == 1
    assert "1 fault:\n  signature: The signature is not valid" in said
    found = json.loads(run(signed, "--json")[1])
    assert (found["ok"], found["signature"], found["schema"]) == (False, None, None)
    assert found["signature_fault"].startswith("The signature is not valid")


def test_a_signature_of_others_is_a_fault(signed):
    status, said = run(signed, "--trusted", signed.parent / "other.pem")
    assert (status, "leads to no trusted certificate" in said) == (1, True)
    signed.write_bytes(certificate_sample.full_dcc())
    status, said = run(signed, "--trusted", signed.parent / "trusted.pem")
    assert (status, "you named a certificate that you trust" in said) == (1, True)


def test_wrong_input(signed, tmp_path):
    (tmp_path / "empty").mkdir()
    (tmp_path / "other.xml").write_text("<a/>")
    for words, error, said in (
        ((tmp_path / "none.xml",), UsageError, "no such file or folder"),
        ((tmp_path / "empty",), UsageError, r"has no dcc\.xml"),
        ((signed, "--schemas", tmp_path / "none"), UsageError, "no such folder of schemas"),
        ((signed, "--trusted", signed), EvidenceError, "no certificates in PEM"),
        ((tmp_path / "other.xml",), EvidenceError, "not a digital calibration certificate"),
    ):
        with pytest.raises(error, match=said):
            run(*words)
