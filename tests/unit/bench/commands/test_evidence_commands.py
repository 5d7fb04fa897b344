"""`certificate authorise`, `certificate timestamp` and `keys`, as a person uses them."""

import json
import shutil
import stat
from datetime import UTC, datetime

import pytest
from authorising import Authority, make_key, needs_openssl, needs_ssh_keygen
from click.testing import CliRunner

from bench.base.errors import BenchError
from bench.commands.cli import cli
from bench.evidence.authorisations import known_authorisations
from bench.evidence.keys import create_key, load_key
from bench.evidence.revoked_keys import RevokedKey, revoke
from bench.evidence.seal import seal
from bench.evidence.signers import read_signers
from bench.evidence.states import home_trust, shown_state
from bench.record.ledger import Ledger
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
    monkeypatch.setattr("bench.commands.verify.derivations", lambda *_, **__: {})
    return folder


@pytest.fixture
def run(home, make_run, tmp_path):
    """A sealed run of the bench."""
    with make_run(tmp_path / "run") as folder:
        seal(folder, load_key(home))
    return tmp_path / "run"


@pytest.fixture
def ada(home, tmp_path):
    """The path of a key that the bench trusts for authorisations."""
    path = make_key(tmp_path)
    call("keys", "trust", f"{path}.pub", "--person", "ada@lab.example")
    return path


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


def test_a_person_authorises_what_is_shown(run, home, tmp_path):
    path = make_key(tmp_path, passphrase="a secret")
    authorise = ("certificate", "authorise", run, "--key", path)
    call(*authorise, fails="Put it into the variable STARBENCH_PASSPHRASE")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("STARBENCH_PASSPHRASE", "a secret")
        call(*authorise, fails="not in the list of trusted keys")
        call("keys", "trust", f"{path}.pub", fails="needs the name of its owner")
        call("keys", "trust", f"{path}.pub", "--person", "Anna Berg", fails="not of the form NAME@PLACE")
        trusted = call("keys", "trust", f"{path}.pub", "--person", "ada@lab.example")
        assert trusted.startswith("Trusted: ada@lab.example  SHA256:")
        assert trusted.endswith("authorises\n")
        done = CliRunner().invoke(cli, list(map(str, authorise)), input="n\n", standalone_mode=False)
        assert done.return_value == 3
        assert not (run / "SHA256SUMS.authorised.sig").exists()
        for shown in ("Run", "00050423", "SIMULATED", "SHA-256 of SHA256SUMS: ", "ada@lab.example (SHA256:"):
            assert shown in done.output
        call(*authorise, fails="There is no terminal to ask for confirmation. Add --yes.")
        assert "AUTHORISED by ada@lab.example" in call(*authorise, answer="y\n")
        call(*authorise, "--yes", fails="authorised already")
    assert "  AUTHORISED" in call("runs", run.parent)
    assert json.loads(call("runs", run.parent, "--json"))["runs"][0]["state"] == "AUTHORISED"
    assert "AUTHORISED" in call("verify", run)


@pytest.fixture
def authorised(run, home, ada, monkeypatch):
    """The run, authorised by Ada and entered in the ledger of the bench; and the path of her key."""
    from bench.commands import verify as verify_command

    monkeypatch.setattr(
        verify_command, "derivations", lambda *_, **__: {"run": [verify_command.check_authorisation]}
    )
    Ledger(home, utc_now=lambda: datetime(2026, 3, 1, tzinfo=UTC), monotonic=lambda: 0.0).append("begun")
    shown = json.loads(call("certificate", "authorise", run, "--key", ada, "--json", "--yes"))
    assert shown["in_ledger"] is True
    return run, ada


def with_a_fault(*arguments):
    """Run a command that finds a fault; return its output."""
    done = CliRunner().invoke(cli, [str(a) for a in arguments], standalone_mode=False)
    assert done.return_value == 1, done.output
    return done.output


def removed(run):
    run.chmod(0o755)
    (run / "SHA256SUMS.authorised.sig").unlink()


def test_an_authorisation_that_was_removed_is_told(authorised, home):
    run, path = authorised
    assert "AUTHORISED" in call("verify", run)
    assert "FAULT" not in call("ledger")
    removed(run)
    what = "the ledger names an authorisation that is missing: by ada@lab.example (SHA256:"
    for words in (("verify", run), ("runs", run.parent), ("ledger",)):
        assert what in with_a_fault(*words)
    state = shown_state(run, home_trust(home), datetime.now(UTC), known_authorisations(home))
    assert state.state == "SEALED"
    assert what in state.text
    done = CliRunner().invoke(cli, ["certificate", "authorise", str(run), "--key", str(path), "--yes"])
    assert what in done.output
    assert "Authorised by ada@lab.example" in call("verify", run)
    assert "FAULT" not in call("ledger")


def test_a_copy_that_may_be_older_than_the_authorisation_is_no_fault(authorised, home, tmp_path):
    run, _ = authorised
    copy = tmp_path / "copy"
    shutil.copytree(run, copy, ignore=shutil.ignore_patterns("*.authorised.sig"))
    what = "the ledger names an authorisation that this copy does not have: by ada@lab.example (SHA256:"
    assert what in call("verify", copy)
    known = known_authorisations(home)
    assert f"Note: {what}" in shown_state(copy, home_trust(home), datetime.now(UTC), known).text
    assert "FAULT" not in call("runs", copy)
    run.rename(run.with_name("away"))  # the folder itself may have been moved to there
    assert "the ledger names an authorisation that is missing" in with_a_fault("verify", copy)


def test_another_authorisation_than_that_of_the_ledger_is_told(authorised, home, tmp_path):
    run, _ = authorised
    removed(run)
    other = make_key(tmp_path, "eve")
    call("keys", "trust", f"{other}.pub", "--person", "eve@lab.example")
    (home / "ledger.jsonl").rename(home / "away")
    call("certificate", "authorise", run, "--key", other, "--yes")
    (home / "away").rename(home / "ledger.jsonl")
    what = "the ledger names another authorisation than SHA256SUMS.authorised.sig: by ada@lab.example"
    assert what in with_a_fault("verify", run)


def test_a_computer_without_a_ledger_says_that_nothing_was_entered(run, home, ada):
    done = CliRunner().invoke(cli, ["certificate", "authorise", str(run), "--key", str(ada), "--yes"])
    assert "Not entered in a ledger, so nobody would notice that it was removed" in done.output
    assert not (home / "ledger.jsonl").exists()


def test_a_script_authorises_with_json(run, ada):
    call("certificate", "authorise", run, "--key", ada, "--json", fails="--json cannot ask")
    shown = json.loads(call("certificate", "authorise", run, "--key", ada, "--json", "--yes"))
    assert (shown["state"], shown["person"]) == ("AUTHORISED", "ada@lab.example")
    assert shown["facts"]["Devices"] == "SIMULATED"


def test_a_folder_with_a_fault_is_not_authorised(run, ada):
    (run / "results.json").chmod(0o644)
    (run / "results.json").write_text("{}")
    call("certificate", "authorise", run, "--key", ada, "--yes", fails="the file was changed after sealing")
    assert not (run / "SHA256SUMS.authorised.sig").exists()


def test_a_draft_and_no_agent_are_told(home, make_run, tmp_path):
    with make_run(tmp_path / "draft"):
        pass
    call("certificate", "authorise", tmp_path / "draft", fails="not sealed")
    call("certificate", "timestamp", tmp_path / "draft", "--tsa", "https://tsa.example", fails="not sealed")
    assert "DRAFT" in call("runs", tmp_path)


@needs_openssl
def test_a_time_stamp_without_a_network(run, home, tmp_path):
    pytest.importorskip("rfc3161_client", reason="the extra `certificate` is not installed")
    tsa = Authority.create(tmp_path / "tsa")
    stamp = ("certificate", "timestamp", run)
    call(*stamp, fails="Give one of --tsa, --token and --request")
    assert "Request for a time stamp of SHA256SUMS.sig" in call(*stamp, "--request", tmp_path / "q.tsq")
    (tmp_path / "reply.tsr").write_bytes(tsa.reply((tmp_path / "q.tsq").read_bytes()))
    (tmp_path / "token").write_bytes(tsa.reply((tmp_path / "q.tsq").read_bytes(), "-token_out"))
    call(
        *stamp,
        "--token",
        tmp_path / "reply.tsr",
        fails="no certificate of a time stamping authority is trusted",
    )
    call(*stamp, "--token", tmp_path / "q.tsq", fails="is not a time stamp")
    (tmp_path / "other.tsr").write_bytes(tsa.reply(other_request(tmp_path)))
    trusted = ("--tsa-certificates", tsa.root)
    call(*stamp, "--token", tmp_path / "other.tsr", *trusted, fails="time stamp of another file")
    shutil.copy(tsa.root, home / "tsa_laboratory.pem")
    output = call(*stamp, "--token", tmp_path / "token")
    assert output.startswith("SHA256SUMS.tsr: SHA256SUMS.sig existed at ")
    assert "by the laboratory's clock (Example TSA)" in output
    assert tsa.accepts(run, "SHA256SUMS.tsr", "SHA256SUMS.sig")
    assert stat.S_IMODE(run.stat().st_mode) == 0o555
    call(*stamp, "--token", tmp_path / "token", fails="never replaced")
    call(*stamp, "--of", "authorisation", "--token", tmp_path / "token", fails="not authorised")
    assert "laboratory's clock" in call("verify", run)


def other_request(tmp_path):
    from bench.evidence.tsa_client import make_request

    return make_request(b"another file", nonce=False).data


def test_an_address_with_a_password_is_refused_first(run, home):
    output = call(
        "certificate",
        "timestamp",
        run,
        "--tsa",
        "https://ada:secret@tsa.example",
        fails="must not contain a user or a password",
    )
    assert "secret" not in output


# ------------------------------------------------------------------ keys


def test_keys_are_listed_with_purpose_and_validity(home, tmp_path):
    path = make_key(tmp_path)
    more = ("--valid-after", "2026-01-01", "--valid-before", "2026-01-02T12:00")
    call("keys", "trust", f"{path}.pub", "--person", "ada@lab.example", *more)
    listed = call("keys", "show")
    assert "bench1@lab.example" in listed
    assert "authorises, valid from 2026-01-01 00:00 UTC, expired 2026-01-02 12:00 UTC" in listed
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
    assert new.principal == "bench1@lab.example"
    call("keys", "revoke", "SHA256:unknown", "--reason", "lost", fails="No trusted key has the fingerprint")
    call("keys", "revoke", old.fingerprint, fails="--reason")
    output = call("keys", "revoke", old.fingerprint, "--reason", "laptop stolen", "--since", "2026-02-03")
    assert "This is this bench's own key" not in output
    assert "REVOKED 2026-02-03 00:00 UTC (laptop stolen)" in call("keys", "show")
    assert "own key. Replace it now" in call("keys", "revoke", new.fingerprint, "--reason", "lost")


def test_the_line_that_keys_show_prints_is_the_trusted_one(home):
    call("keys", "rotate")
    line = read_signers(home / "allowed_signers")[1].line
    assert f"  {line}\n" in call("keys", "show")
    assert "valid-after" in line


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
