"""Keys: made once, kept from others, opened with their passphrase, and whom to trust."""

import os
import stat
import threading
from datetime import UTC, datetime

import pytest
from authorising import make_key, needs_ssh_keygen
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import ec

from bench.base.errors import EvidenceError, StorageError
from bench.base.home import home_folder
from bench.evidence.keys import create_key, ensure_key, load_key
from bench.evidence.public_half import load_public_key
from bench.evidence.signers import read_signers, trust
from bench.record.folder_lock import locked_folder


def test_a_key_is_made_at_first_use_kept_and_can_be_read_by_its_owner_alone(tmp_path):
    home = tmp_path / "home"
    first, second = (ensure_key(home, principal=name) for name in ("bench1@lab", "other@lab"))
    assert (first.created, second.created) == (True, False)
    assert first.fingerprint == second.fingerprint
    assert second.principal == "bench1@lab"
    assert [stat.S_IMODE(path.stat().st_mode) for path in (home / "bench_key", home)] == [0o600, 0o700]


def test_the_default_principal_names_the_machine(tmp_path, monkeypatch):
    monkeypatch.setattr("socket.gethostname", lambda: "bench 7/ü")
    assert create_key(tmp_path).principal == "bench@bench-7--"


@pytest.mark.parametrize(("mode", "user"), [(0o640, 0), (0o604, 0), (0o600, 4242)])
def test_a_key_of_others_or_that_others_can_read_is_refused(tmp_path, monkeypatch, mode, user):
    create_key(tmp_path)
    (tmp_path / "bench_key").chmod(mode)
    monkeypatch.setattr(os, "getuid", lambda: user)
    with pytest.raises(EvidenceError, match=rf"\(mode {mode:04o}\).*chmod 600"):
        load_key(tmp_path)


def test_two_first_runs_at_once_do_not_make_two_keys(tmp_path):
    with locked_folder(tmp_path):  # as while a key is made
        made = []
        other = threading.Thread(target=lambda: made.append(ensure_key(tmp_path)))
        other.start()
        other.join(0.2)
        assert other.is_alive()
        assert not (tmp_path / "bench_key").exists()
        first = create_key(tmp_path)
    other.join()
    assert made[0].fingerprint == first.fingerprint


def test_others_use_the_folder_while_a_passphrase_is_asked_for(tmp_path):
    create_key(tmp_path, passphrase=b"secret")

    def ask(_):
        with locked_folder(tmp_path):
            return b"secret"

    assert not ensure_key(tmp_path, ask_passphrase=ask).created


def test_a_key_is_never_made_over_another_and_a_missing_one_is_told_with_how_to_make_it(tmp_path):
    with pytest.raises(EvidenceError, match="Make one"):
        load_key(tmp_path)
    create_key(tmp_path)
    before = (tmp_path / "bench_key").read_bytes()
    with pytest.raises(EvidenceError, match="has a key already"):
        create_key(tmp_path)
    assert (tmp_path / "bench_key").read_bytes() == before


def test_a_protected_key_opens_with_its_passphrase_alone(tmp_path):
    made = create_key(tmp_path, passphrase=b"correct horse")
    assert load_key(tmp_path, ask_passphrase=lambda _: b"correct horse").fingerprint == made.fingerprint
    with pytest.raises(EvidenceError, match="wrong passphrase"):
        load_key(tmp_path, ask_passphrase=lambda _: b"battery staple")
    with pytest.raises(EvidenceError, match="no terminal to ask"):
        load_key(tmp_path)


def test_what_is_no_ed25519_key_is_refused(tmp_path):
    create_key(tmp_path)
    other = ec.generate_private_key(ec.SECP256R1()).private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.OpenSSH, serialization.NoEncryption()
    )
    for content, words in ((other, "not an Ed25519 key"), (b"garbage", "not an OpenSSH key")):
        (tmp_path / "bench_key").write_bytes(content)
        with pytest.raises(EvidenceError, match=words):
            load_key(tmp_path)


def test_the_secret_does_not_show_when_printed(key):
    assert "PRIVATE" not in repr(key)
    assert repr(key) == f"BenchKey(bench1@lab.example, {key.fingerprint})"


@needs_ssh_keygen
def test_a_key_made_by_ssh_keygen_is_taken(tmp_path):
    make_key(tmp_path, "me@lab", passphrase="pass phrase").rename(tmp_path / "bench_key")
    (tmp_path / "me@lab.pub").rename(tmp_path / "bench_key.pub")
    key = load_key(tmp_path, ask_passphrase=lambda _: b"pass phrase")
    assert key.principal == "me@lab"
    blob = (tmp_path / "bench_key.pub").read_text().split()[1]
    assert load_public_key(tmp_path).line.endswith(f" {blob}")


def test_the_folder_of_keys_follows_the_environment():
    assert home_folder({"STARBENCH_HOME": "/a", "XDG_CONFIG_HOME": "/b", "HOME": "/c"}).as_posix() == "/a"
    assert home_folder({"XDG_CONFIG_HOME": "/b", "HOME": "/c"}).as_posix() == "/b/starbench"
    assert home_folder({"HOME": "/c"}).as_posix() == "/c/.config/starbench"


# ------------------------------------------------------------------ whom to trust

LINE = "ssh-ed25519 AAAAC3NzaC1lZDI1NTE5AAAAIOMqqnkVzrm0SdG6UOoqKLsabgH5C9okWi0dh2l9GKJl"
NOW = datetime(2026, 6, 1, 12, tzinfo=UTC)
NO_TIMES = (
    "tomorrow", "", "20261301", "\uff12\uff10\uff12\uff16\uff10\uff11\uff10\uff11", "00010101", "20260101ZZ", "19700101Z",
)  # fmt: skip


def read_one(tmp_path, line):
    (tmp_path / "signers").write_text(f"# comment\n\n{line}\n")
    (signer,) = read_signers(tmp_path / "signers")
    return signer


@pytest.mark.parametrize(
    ("options", "rejection"),
    [
        ('valid-after="20260601130000Z" ', "not valid before 2026-06-01 13:00"),
        ('valid-before="202606011300Z",namespaces="starbench-report@v1" ', None),
        ('valid-before="20260601Z" ', "expired 2026-06-01 00:00"),
    ],
)
def test_options_of_a_trusted_key_are_heeded(tmp_path, options, rejection):
    rejected = read_one(tmp_path, f"bench1@lab {options}{LINE} comment").rejection("starbench-report@v1", NOW)
    assert (rejected is None) if rejection is None else (rejection in rejected)


@pytest.mark.parametrize(
    "line",
    [
        LINE,
        "bench1@lab ssh-ed25519",
        "bench1@lab ssh-ed25519 !!!!",
        *(f'bench1@lab valid-after="{time}" {LINE}' for time in NO_TIMES),
        "bench1@lab ssh-rsa AAAA",
        f"bench1@lab cert-authority {LINE}",
        *(f"{name}@lab {LINE}" for name in ("\x1b[2Jada", "ada\x7f", "\u202eada")),  # cannot be printed
    ],
)
def test_a_line_that_is_not_understood_is_named(tmp_path, line):
    with pytest.raises(EvidenceError, match="signers:3: "):
        read_one(tmp_path, line)


def test_a_list_that_is_missing_or_a_pipe_is_refused_at_once(tmp_path):
    path = tmp_path / "signers"
    with pytest.raises(EvidenceError, match=r"signers: .*No such file"):
        read_signers(path)
    os.mkfifo(path, 0o600)
    with pytest.raises(StorageError, match="a pipe"):
        read_signers(path)


def test_a_further_key_is_trusted_once(tmp_path):
    create_key(tmp_path)
    for _ in range(2):
        assert trust(tmp_path, f"bench2@lab {LINE}\n").principal == "bench2@lab"
    assert [s.principal for s in read_signers(tmp_path / "allowed_signers")][1:] == ["bench2@lab"]
    with pytest.raises(EvidenceError, match="not a line"):
        trust(tmp_path, "nonsense")


@pytest.mark.parametrize("passphrase", [None, b"secret"])
def test_the_public_half_is_read_from_the_private_key_without_its_passphrase(tmp_path, passphrase):
    key = create_key(tmp_path, principal="bench1@lab", passphrase=passphrase)
    create_key(tmp_path / "other", principal="bench1@lab")
    (tmp_path / "bench_key.pub").write_bytes((tmp_path / "other" / "bench_key.pub").read_bytes())
    own = load_public_key(tmp_path)
    assert (own.public_key, own.principal, own.line) == (key.public_key, "bench1@lab", key.signers_line)
    (tmp_path / "bench_key").chmod(0o644)
    with pytest.raises(EvidenceError, match="chmod 600"):
        load_public_key(tmp_path)


@pytest.mark.parametrize(
    ("old", "new", "why"),
    [
        (b"-----BEGIN", b"-----BEGUN", "not in OpenSSH's format"),
        (b"b3BlbnNzaC", b"b3BlbnNzaD", "not in OpenSSH's format"),
        (b"b3Blb", b"!!!!!", "not base64"),
    ],
)
def test_a_damaged_private_key_gives_no_public_half(tmp_path, old, new, why):
    create_key(tmp_path, principal="bench1@lab")
    data = (tmp_path / "bench_key").read_bytes()
    assert old in data
    (tmp_path / "bench_key").write_bytes(data.replace(old, new))
    with pytest.raises(EvidenceError, match=why):
        load_public_key(tmp_path)
