"""No secret is sealed: keys, tokens, URLs with credentials and the values of variables in use are found, nothing else."""

import base64
import random
import shutil
import subprocess
import time

import pytest

from bench.base.errors import EvidenceError
from bench.base.secret_patterns import find_secrets
from bench.evidence.seal import seal
from bench.evidence.secrets_scan import Finding, refuse_secrets, scan

KEY_LINE = "-----BEGIN %sPRIVATE " + "KEY-----"
SECRETS = {
    "rtsp://admin:pa55@10.0.0.9/stream": "a URL with a password",
    "rtsp://admin:$CAM_PW@10.0.0.9/stream": "a URL with a password",
    "url: 'https://:secret@example.org/'": "a URL with a password",
    "https://0123456789abcdef0123@example.org/x": "a URL with a token before the @",
    "https://example.org/hook?room=7&token=abc": "a URL with a token or password",
    "https://example.org/hook?access_token=abc": "a URL with a token or password",
    "https://example.org/hook?apikey=abc": "a URL with a token or password",
    "https://example.org/hook?X-Api-Key=abc": "a URL with a token or password",
    "http://10.0.0.9/video.cgi?user=admin&pwd=x": "a URL with a token or password",
    "https://hooks.slack.com/services/T0/B0/abc": "a secret address of Slack",
    "https://discord.com/api/webhooks/12345/" + "a" * 30: "a secret address of Discord",
    "https://x.webhook.office.com/webhookb2/" + "1234-" * 8: "a secret address of Teams",
    "https://api.telegram.org/bot12345:" + "A" * 30: "a token of Telegram",
    KEY_LINE % "": "a private key",
    KEY_LINE % "OPENSSH ": "a private key",
    KEY_LINE % "RSA ": "a private key",
    KEY_LINE % "ENCRYPTED ": "a private key",
    "PuTTY-User-Key-" + "File-3: ssh-ed25519": "a private key of PuTTY",
    "key = AKIA" + "ABCDEFGH23456789": "an access key of AWS",
    "aws_secret_access_key = " + "abcd/123" * 5: "an access key of AWS",
    "ghp_" + "a1B2" * 9: "a token of GitHub",
    "github_pat_" + "a1B2" * 9: "a token of GitHub",
    "xoxb-" + "123456789012-abc": "a token of Slack",
    "eyJ" + "hbGciOiJI" + ".eyJ" + "zdWIiOiIx" + "." + "a" * 20: "a web token (JWT)",
}
HARMLESS = [
    "xmlns='http://www.w3.org/2000/svg'",
    "https://example.org/a?page=2&sort=key",
    "https://example.org/a?monkey=2&turnkey=1",
    "a=b?key=1",
    "ssh://git@example.org/repository",
    "socket://10.0.0.7:4001",
    "rtsp://10.0.0.9:554/stream@1",
    "mail: night.shift@lab.example",
    "http://127.0.0.1:8080/runs see bench2@lab.example",
    "ssh-ed25519 AAAAC3NzaC1lZDI1NTE5AAAAIKzx bench@lab",
    "-----BEGIN SSH SIGNATURE-----",
    "-----BEGIN CERTIFICATE-----",
    "password_env: BENCH2_MAIL",
    "the key AKIA is short",
]


@pytest.mark.parametrize(("text", "kind"), SECRETS.items())
def test_a_secret_is_found_at_its_line_and_never_shown(tmp_path, text, kind):
    (tmp_path / "notes.txt").write_text(f"first\nsecond {text} end\n")
    assert scan(tmp_path, {}) == [Finding("notes.txt", 2, kind)]
    with pytest.raises(EvidenceError, match=r"notes.txt:2") as refused:
        refuse_secrets(tmp_path, {})
    assert text not in str(refused.value)


@pytest.mark.parametrize("text", HARMLESS)
def test_what_looks_a_little_like_a_secret_is_none(text):
    assert list(find_secrets(text.encode())) == []


def test_base64_of_pictures_and_hashes_are_no_secrets():
    drawn = random.Random(1)
    data = base64.b64encode(drawn.randbytes(3_000_000))
    assert list(find_secrets(b'<image href="data:image/png;base64,' + data + b'"/>')) == []


@pytest.mark.parametrize(
    "tool", [["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f"], ["openssl", "genrsa", "-out"]]
)
def test_a_private_key_of_another_program_is_found(tmp_path, tool):
    if shutil.which(tool[0]) is None:
        pytest.skip(f"{tool[0]} is not installed")
    subprocess.run([*tool, tmp_path / "id"], check=True, capture_output=True)
    assert [f.kind for f in scan(tmp_path, {})] == ["a private key"]


@pytest.mark.parametrize(
    ("value", "written"),
    [
        ("hunter22", "sent with hunter22."),
        ('a"b\\c-123', '{"said": "a\\"b\\\\c-123"}'),
        ("pass word/1", "?q=pass%20word%2F1&"),
        ("rtsp://admin:pa55word@10.0.0.9/", "the camera said pa55word"),
    ],
)
def test_the_value_of_a_variable_that_the_station_names_is_found(tmp_path, value, written):
    (tmp_path / "station.yaml").write_text("camera: {driver: opencv, source_env: BENCH_CAM}\n")
    (tmp_path / "wire.jsonl").write_text("\n" + written + "\n")
    (found,) = scan(tmp_path, {"BENCH_CAM": value, "OTHER": "station"})
    assert found == Finding("wire.jsonl", 2, "the value of the environment variable BENCH_CAM")
    assert scan(tmp_path, {}) == []


def test_a_short_or_common_value_is_not_searched_within_words(tmp_path):
    (tmp_path / "station.yaml").write_text("password_env: PW\n")
    assert scan(tmp_path, {"PW": "pass"}) == []
    assert scan(tmp_path, {"PW": "passwor"}) == []


def test_a_recording_is_looked_at_only_at_its_head(tmp_path):
    (tmp_path / "captures").mkdir()
    secret = next(iter(SECRETS)).encode()
    (tmp_path / "captures" / "a.raw").write_bytes(b"% " + secret + b"\n" + bytes(100_000))
    (tmp_path / "captures" / "b.raw").write_bytes(bytes(100_000) + secret)
    (tmp_path / "views.h5").write_bytes(bytes(10) + secret)
    assert [str(f) for f in scan(tmp_path, {})] == [
        "captures/a.raw: a URL with a password",
        "views.h5: a URL with a password",
    ]


def test_a_secret_on_the_border_of_two_blocks_is_found_once_at_its_line(tmp_path, monkeypatch):
    monkeypatch.setattr("bench.evidence.secrets_scan._CHUNK_BYTES", 1000)
    monkeypatch.setattr("bench.evidence.secrets_scan._OVERLAP_BYTES", 200)
    for before in (960, 985, 999, 1000, 2990):
        text = (
            ("x" * 9 + "\n") * (before // 10) + "y" * (before % 10) + "rtsp://a:secret@host/\n" + "z\n" * 900
        )
        (tmp_path / "journal.jsonl").write_text(text)
        assert scan(tmp_path, {}) == [Finding("journal.jsonl", 1 + before // 10, "a URL with a password")], (
            before
        )


def test_a_long_line_of_addresses_takes_no_time(tmp_path):
    (tmp_path / "page.html").write_text("http://a/?" * 200_000)
    begun = time.monotonic()
    assert scan(tmp_path, {}) == []
    assert time.monotonic() - begun < 5


def test_many_secrets_make_a_message_that_can_be_read(tmp_path):
    (tmp_path / "notes.txt").write_text("rtsp://a:secret@host/\n" * 10_000)
    assert len(scan(tmp_path, {})) == 20


def test_a_run_with_a_secret_is_not_sealed_and_loses_nothing_and_can_be_sealed_later(make_run, tmp_path, key):
    with make_run(tmp_path / "run") as folder:
        folder.write_atomic("wire.jsonl", b"{}\nrtsp://admin:pa55@10.0.0.9/\n")
        before = {path: path.read_bytes() for path in (tmp_path / "run").rglob("*") if path.is_file()}
        with pytest.raises(EvidenceError, match=r"wire.jsonl:2: a URL with a password.*--secrets-revoked"):
            seal(folder, key)
        after = {path: path.read_bytes() for path in (tmp_path / "run").rglob("*") if path.is_file()}
        assert {
            p: d for p, d in before.items() if p.name not in {".reserve", "reserve"}
        }.items() <= after.items()
        assert not (tmp_path / "run" / "SHA256SUMS").exists()
        seal(folder, key, secrets_revoked=True)
    assert (tmp_path / "run" / "SHA256SUMS.sig").exists()


def test_a_run_as_it_usually_is_has_no_secret(make_run, tmp_path):
    with make_run(tmp_path / "run"):
        assert scan(tmp_path / "run") == []
