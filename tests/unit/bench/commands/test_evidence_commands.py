"""The command `keys`, as a person uses it."""

import json
import re
from datetime import UTC, datetime

import pytest
from authorising import make_key, needs_ssh_keygen
from click.testing import CliRunner

from bench.base.errors import BenchError
from bench.commands.cli import cli
from bench.evidence.keys import create_key, load_key
from bench.evidence.revoked_keys import RevokedKey, revoke
from bench.evidence.signers import read_signers
from bench.record.run_folder import RunFolder

pytestmark = needs_ssh_keygen


@pytest.fixture
def home(tmp_path, monkeypatch):
    """The configuration folder of the commands; nobody's agent and passphrase."""
    folder = tmp_path / "home"
    create_key(folder, principal="bench1@lab.example")
    monkeypatch.setenv("STARBENCH_HOME", str(folder))
    for name in ("SSH_AUTH_SOCK", "STARBENCH_PASSPHRASE"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("bench.commands.verify.derivations", lambda *_, **__: [])
    return folder


def call(*arguments, answer=None, fails=None):
    """Run a command; return its output, or the message of its error."""
    done = CliRunner().invoke(cli, [str(a) for a in arguments], input=answer)
    if fails is None:
        assert done.exception is None, (done.exception, done.output)
        return done.stdout or done.stderr
    assert isinstance(done.exception, BenchError | SystemExit), done.output
    message = f"{done.output} {done.exception}"
    assert fails in message, message
    return message


def test_keys_are_listed_with_purpose_and_validity(home, tmp_path):
    path = make_key(tmp_path)
    more = ("--valid-after", "2026-01-01", "--valid-before", "2026-01-02T12:00")
    call("keys", "trust", f"{path}.pub", "--person", "ada@lab.example", *more)
    listed = call("keys", "show")
    assert "bench1@lab.example" in listed
    assert re.search("authorises.* 2026-01-01 00:00 UTC, expired 2026-01-02 12:00 UTC", listed)
    rows = json.loads(call("keys", "show", "--json"))["keys"]
    assert rows[1]["purposes"] == ["starbench-authorisation@v1"]
    assert rows[1]["valid_before"] == "2026-01-02T12:00:00+00:00"
    call("keys", "trust", f"{path}.pub", "--bench", "ada@lab.example", fails="cannot both seal and authorise")
    call("keys", "trust", f"{path}.pub", "--person", "a@b", "--bench", "a@b", fails="not both")
    call("keys", "trust", "nonsense", fails="not a line of a trusted key")
    call("keys", "trust", f"{path}.pub", "--person", "not a name", fails="not of the form")


def test_keys_are_replaced_and_revoked(home):
    old = load_key(home)
    output = call("keys", "rotate", "--old-key", "delete")
    assert f"Old key: {old.fingerprint}" in output
    new = load_key(home)
    assert f"New key: {new.fingerprint}" in output
    assert not (home / "old_keys").exists()
    line = read_signers(home / "allowed_signers")[1].line
    assert "valid-after" in line
    assert f"  {line}\n" in call("keys", "show")
    assert new.principal == "bench1@lab.example"
    call("keys", "revoke", "SHA256:unknown", "--reason", "lost", fails="No trusted key has the fingerprint")
    call("keys", "revoke", old.fingerprint, fails="--reason")
    output = call("keys", "revoke", old.fingerprint, "--reason", "laptop stolen", "--since", "2026-02-03")
    assert "own key" not in output
    assert "REVOKED 2026-02-03 00:00 UTC (laptop stolen)" in call("keys", "show")
    assert "own key" in call("keys", "revoke", new.fingerprint, "--reason", "lost")


def test_keys_show_asks_for_no_passphrase(tmp_path, monkeypatch):
    monkeypatch.setenv("STARBENCH_HOME", str(tmp_path))

    def never(_):
        raise AssertionError("asked for a passphrase")

    monkeypatch.setattr("bench.commands.keys.ask_passphrase", never)
    key = create_key(tmp_path, principal="bench1@lab.example", passphrase=b"secret")
    output = call("keys", "show")
    assert key.fingerprint in output
    assert f"  {key.signers_line}\n" in output
    (tmp_path / "bench_key").write_text("no key")
    call("keys", "show", fails="The key cannot be read: it is not in OpenSSH's format.")


# ------------------------------------------------------------------ the key before the run


RUN = ("run", "three_pose", "--station", "simulated", "-o", "new")


@pytest.mark.parametrize("words", [RUN, ("batch", "queue.yaml", "-o", "new")], ids=["run", "batch"])
@pytest.mark.parametrize("trouble", ["locked", "revoked"])
def test_a_key_that_cannot_seal_stops_a_run_before_its_folder_is_made(
    home, tmp_path, monkeypatch, trouble, words
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "queue.yaml").write_text("format: starbench/queue/1\n")
    says = "cannot seal: the key was revoked"
    if trouble == "revoked":
        revoke(home, RevokedKey(load_key(home).public_key, datetime.now(UTC), "laptop stolen"))
    else:
        (home / "bench_key").unlink()
        create_key(home, passphrase=b"a secret")
        says = "there is no terminal to ask for it"
    monkeypatch.setattr(RunFolder, "create", None)  # it would fail otherwise than expected
    call(*words, fails=says)
    assert not (tmp_path / "new").exists()
