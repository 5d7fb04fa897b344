"""Time stamps beside a seal, of an authority that openssl plays: what is accepted, what is refused, what is asked."""

import sys
import threading
from contextlib import contextmanager, suppress
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from http.server import BaseHTTPRequestHandler, HTTPServer
from types import SimpleNamespace

import pytest
from authorising import Authority, armoured, needs_openssl
from hypothesis import given
from hypothesis import strategies as st
from servers import serving

from bench.base.errors import EvidenceError, UsageError
from bench.evidence import timestamp, tsa_client
from bench.evidence.authorisation import authorise
from bench.evidence.beside_seal import add_beside
from bench.evidence.der import sets_in_order
from bench.evidence.findings import Findings
from bench.evidence.key_trust import Trust
from bench.evidence.ssh_keys import string
from bench.evidence.states import standing_of
from bench.evidence.timestamp import (
    TrustedAuthorities,
    UncheckedError,
    as_reply,
    check_reply,
    check_timestamps,
    read_authorities,
)
from bench.evidence.tsa_client import ask_authority, check_url, make_request

pytest.importorskip("rfc3161_client", reason="the extra `certificate` is not installed")
pytestmark = needs_openssl

NOW = datetime.now(UTC)


@pytest.fixture(scope="module")
def others(authority, tmp_path_factory):
    return read_authorities(tmp_path_factory.mktemp("home"), authority.root)


@pytest.fixture(scope="module")
def reply(authority):
    return authority.reply(make_request(b"signature", nonce=False).data)


def stamped(folder, authority, name="SHA256SUMS.tsr", of="SHA256SUMS.sig"):
    add_beside(folder, name, authority.reply(make_request((folder / of).read_bytes(), nonce=True).data))


def test_a_request_is_that_of_openssl(authority):
    (authority.folder / "m").write_bytes(b"signature")
    authority.run("ts", "-query", "-data", "m", "-sha256", "-cert", "-no_nonce", "-out", "theirs.tsq")
    assert make_request(b"signature", nonce=False).data == (authority.folder / "theirs.tsq").read_bytes()
    assert make_request(b"signature", nonce=True).nonce


def test_a_time_stamp_proves_when_the_seal_existed(sealed, signers, authority, others):
    stamped(sealed, authority)
    standing = standing_of(sealed, Trust(signers, (), others), datetime.now(UTC))
    assert (standing.faults, standing.not_compared) == ([], [])
    (stamp,) = check_timestamps(sealed, others, Findings()).values()
    assert abs(stamp.utc - datetime.now(UTC)) < timedelta(minutes=1)
    (statement,) = standing.statements
    assert f"{stamp.utc:%Y-%m-%d %H:%M:%S} UTC" in statement
    assert "Example TSA" in statement
    assert authority.accepts(sealed, "SHA256SUMS.tsr", "SHA256SUMS.sig")


def test_without_a_trusted_certificate_it_is_not_checked(sealed, signers, authority):
    stamped(sealed, authority)
    standing = standing_of(sealed, Trust(signers), NOW)
    assert (standing.faults, standing.statements) == ([], [])
    assert all(fact in standing.not_compared[0] for fact in ("Example TSA", "--tsa-certificates FILE"))


def test_without_the_package_it_is_not_checked(sealed, signers, authority, others, monkeypatch):
    stamped(sealed, authority)
    monkeypatch.setitem(sys.modules, "rfc3161_client", None)
    standing = standing_of(sealed, Trust(signers, (), others), NOW)
    (unchecked,) = standing.not_compared
    assert unchecked.startswith("SHA256SUMS.tsr: ")
    with pytest.raises(UncheckedError, match=r"pip install 'starbench\[certificate\]'"):
        make_request(b"signature", nonce=False)


def test_a_time_stamp_of_another_seal_is_a_fault_and_openssl_agrees(sealed, signers, authority, others):
    add_beside(sealed, "SHA256SUMS.tsr", authority.reply(make_request(b"another seal", nonce=False).data))
    (fault,) = standing_of(sealed, Trust(signers, (), others), NOW).faults
    assert (fault.kind, fault.where) == ("timestamp", "SHA256SUMS.tsr")
    assert "another file" in fault.what
    assert not authority.accepts(sealed, "SHA256SUMS.tsr", "SHA256SUMS.sig")


def test_each_bit_of_a_reply_counts(reply, others):
    """Every changed byte is refused, or the time stamp is the same one."""
    good = check_reply(reply, b"signature", others, "SHA256SUMS.tsr")
    kept = 0
    for at in range(0, len(reply), 2):
        changed = bytearray(reply)
        changed[at] ^= 0x20
        try:
            assert check_reply(bytes(changed), b"signature", others, "SHA256SUMS.tsr").utc == good.utc
            kept += 1
        except EvidenceError:
            continue
    assert kept < len(reply) // 2 // 3


def test_a_second_certificate_of_the_authority_is_refused(reply, others, monkeypatch):
    """It could be a forged one with another name."""
    response = timestamp.read_reply(reply)
    (own,) = map(bytes, response.signed_data.certificates)
    for certificates in ([own, own], []):
        signed = SimpleNamespace(signer_infos=response.signed_data.signer_infos, certificates=certificates)
        read = SimpleNamespace(signed_data=signed, tst_info=response.tst_info)
        monkeypatch.setattr(timestamp, "read_reply", lambda *_, read=read: read)
        with pytest.raises(EvidenceError, match=f"holds {len(certificates)} certificates"):
            check_reply(reply, b"signature", others, "SHA256SUMS.tsr")


@given(st.binary(max_size=300))
def test_any_bytes_are_no_reply_and_keep_their_content_when_sets_are_put_in_order(data):
    with pytest.raises(EvidenceError, match="not a time stamp"):
        as_reply(data)
    assert sorted(sets_in_order(data)) == sorted(data)


def test_a_file_of_authorities_that_others_can_change_is_refused(tmp_path, authority):
    path = tmp_path / "tsa.pem"
    path.write_bytes(authority.root.read_bytes())
    path.chmod(0o666)
    with pytest.raises(EvidenceError, match="chmod go-w"):
        read_authorities(tmp_path, path)
    path.chmod(0o644)
    path.write_text("nothing")
    with pytest.raises(EvidenceError, match="no certificates"):
        read_authorities(tmp_path, path)
    assert read_authorities(tmp_path) == TrustedAuthorities()


def test_a_clock_that_contradicts_a_time_stamp_is_told(sealed, signers, authority, others, monkeypatch):
    stamped(sealed, authority)
    monkeypatch.setattr("bench.evidence.states.stated_time", lambda _: NOW + timedelta(days=2))
    standing = standing_of(sealed, Trust(signers, (), others), NOW)
    assert any("both clocks" in remark for remark in standing.remarks)
    assert any("a time in the future" in remark for remark in standing.remarks)


# ------------------------------------------------------------------ over the network


@contextmanager
def answering(respond):
    """An authority's server; ``respond(handler, body)`` answers each request."""

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self):
            asked.append(self.path)
            respond(self, self.rfile.read(int(self.headers["Content-Length"])))

        def log_message(self, *_):
            pass

    asked = []
    with serving(HTTPServer(("127.0.0.1", 0), Handler)) as server:
        yield f"http://127.0.0.1:{server.server_port}", asked


def answer(handler, body, kind="application/timestamp-reply", status=200, **headers):
    handler.send_response(status)
    handler.send_header("Content-Type", kind)
    handler.send_header("Content-Length", str(len(body)))
    for name, value in headers.items():
        handler.send_header(name, value)
    handler.end_headers()
    handler.wfile.write(body)


def test_an_authority_is_asked_once_and_a_redirect_is_not_followed(authority, others):
    with answering(lambda handler, body: answer(handler, authority.reply(body))) as (url, asked):
        reply = ask_authority(f"{url}/tsr?x=1", make_request(b"signature", nonce=True))
    assert check_reply(reply, b"signature", others, "SHA256SUMS.tsr").authority == "Example TSA"
    assert asked == ["/tsr?x=1"]
    with (
        answering(lambda handler, _: answer(handler, b"", status=302, Location="/other")) as (url, asked),
        pytest.raises(EvidenceError, match=r"302.*'/other'"),
    ):
        ask_authority(url, make_request(b"signature", nonce=True))
    assert asked == ["/"]


@pytest.mark.parametrize(
    ("respond", "why"),
    [
        (lambda h, *_: answer(h, b"<html>", kind="text/html"), "type 'text/html'"),
        (lambda h, *_: answer(h, b"no", status=500), "500"),
        (lambda h, *_: answer(h, b"0" * (1 << 21)), "more than 1048576 bytes"),
        (lambda h, *_: answer(h, b"no time stamp"), "not a time stamp"),
        (lambda h, *_: h.wfile.write(b"\0\r\n\r\n"), "cannot be asked"),
        (lambda h, _, other: answer(h, other), "random number differs"),
    ],
    ids=["page", "error", "large", "other", "no HTTP", "of another request"],
)
def test_an_answer_that_is_no_time_stamp_of_this_request_is_told(authority, respond, why):
    other = authority.reply(make_request(b"signature", nonce=True).data)
    with (
        answering(lambda handler, body: respond(handler, body, other)) as (url, _),
        pytest.raises(EvidenceError, match=why),
    ):
        ask_authority(url, make_request(b"signature", nonce=True))


def test_an_authority_that_drips_is_given_up(monkeypatch):
    monkeypatch.setattr(tsa_client, "WAIT_S", 0.3)
    stop = threading.Event()

    def drip(handler, _):
        with suppress(OSError):
            while not stop.wait(0.05):
                handler.wfile.write(b"H")
        handler.close_connection = True

    with answering(drip) as (url, _):
        try:
            with pytest.raises(EvidenceError, match="no answer within"):
                ask_authority(url, make_request(b"signature", nonce=True))
        finally:
            stop.set()


@pytest.mark.parametrize(
    "url",
    ["tsa.example", "ftp://tsa.example", "file:///etc/passwd", "https://", "http://h:99999/", "http://h:0/", "http://h/\n"],
)  # fmt: skip
def test_an_address_that_is_none_is_refused(url):
    with pytest.raises(UsageError, match="--tsa"):
        check_url(url)


# ------------------------------------------------------------------ what a time stamp of an authorisation proves


def expiring(signers):
    return tuple(replace(signer, valid_before=datetime.now(UTC) + timedelta(hours=1)) for signer in signers)


def test_a_stamped_authorisation_proves_the_time_of_the_seal(sealed, signers, authority, others, ada):
    key, line = ada
    trust = Trust((*expiring(signers), line), (), others)
    authorise(sealed, key, trust, NOW)
    later = datetime.now(UTC) + timedelta(days=1)
    assert "No trusted time stamp" in standing_of(sealed, trust, later).remarks[0]
    stamped(sealed, authority, "SHA256SUMS.authorised.tsr", "SHA256SUMS.authorised.sig")
    standing = standing_of(sealed, trust, later)
    assert (standing.faults, standing.remarks, standing.signer) == ([], [], "bench1@lab.example")
    assert any(s.startswith("The authorisation existed at") for s in standing.statements)
    assert authority.accepts(sealed, "SHA256SUMS.authorised.tsr", "SHA256SUMS.authorised.sig")
    (sealed / "SHA256SUMS.authorised.sig").unlink()
    faults = [fault for fault in standing_of(sealed, trust, NOW).faults if fault.kind == "timestamp"]
    assert [fault.what.endswith("SHA256SUMS.authorised.sig, which is missing") for fault in faults] == [True]


@pytest.mark.parametrize(
    "by", ["a person of another seal", "somebody who is not trusted", "a key that fits any message"]
)
def test_a_stamped_signature_that_is_not_accepted_proves_nothing(sealed, signers, authority, others, ada, by):
    """Otherwise an old time stamp could be put beside a new seal by an expired key."""
    key, line = ada
    of = b"another seal" if by == "a person of another seal" else (sealed / "SHA256SUMS.sig").read_bytes()
    data = key.sign(of, "starbench-authorisation@v1")
    if by == "a key that fits any message":
        data = fits_any("starbench-authorisation@v1")
    add_beside(sealed, "SHA256SUMS.authorised.sig", data)
    stamped(sealed, authority, "SHA256SUMS.authorised.tsr", "SHA256SUMS.authorised.sig")
    people = (line,) if by == "a person of another seal" else ()
    trust = Trust((*expiring(signers), *people), (), others)
    standing = standing_of(sealed, trust, datetime.now(UTC) + timedelta(days=1))
    assert [fault.kind for fault in standing.faults] == ["authorisation"]
    assert "No trusted time stamp" in standing.remarks[0]


@pytest.mark.parametrize("times", range(2))
def test_a_reply_with_the_chain_of_certificates_is_accepted(authority, others, tmp_path, times):
    """OpenSSL writes certificates in the order of their chain, not in that of DER; each authority has another order."""
    del times
    chained = Authority.create(tmp_path / "chained")
    request = make_request(b"signature", nonce=False).data
    data = chained.reply(request, "-chain", "root.pem")
    trusted = read_authorities(tmp_path, chained.root)
    assert as_reply(data) == data
    assert check_reply(data, b"signature", trusted, "SHA256SUMS.tsr").authority == "Example TSA"
    with pytest.raises(EvidenceError, match="not trusted"):
        check_reply(data, b"signature", others, "SHA256SUMS.tsr")
    with pytest.raises(EvidenceError, match="another file"):
        check_reply(data, b"Signature", trusted, "SHA256SUMS.tsr")
    (tmp_path / "signed").write_bytes(b"signature")
    (tmp_path / "r.tsr").write_bytes(data)
    assert chained.accepts(tmp_path, tmp_path / "r.tsr", tmp_path / "signed")


def fits_any(namespace):
    """A signature by an Ed25519 key of order one, with which one signature is valid for every message."""
    public = string(b"ssh-ed25519") + string(b"\x01" + b"\0" * 31)
    signature = string(b"ssh-ed25519") + string(b"\x01" + b"\0" * 63)
    return armoured(public, signature, namespace)
