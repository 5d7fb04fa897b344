"""`certificate authorise` and `certificate timestamp`, as a person uses them."""

import json
import shutil
import stat
from datetime import UTC, datetime

import pytest
from authorising import Authority, make_key, needs_openssl, needs_ssh_keygen
from click.testing import CliRunner

from bench.base.clock import VirtualClock
from bench.commands.cli import cli
from bench.evidence.authorisations import known_authorisations
from bench.evidence.keys import load_key
from bench.evidence.seal import seal
from bench.evidence.states import home_trust, shown_state
from bench.record.ledger import Ledger
from tests.unit.bench.commands import test_evidence_commands as of_keys
from tests.unit.bench.commands.test_evidence_commands import call

pytestmark = needs_ssh_keygen
home = of_keys.home


@pytest.fixture
def ada(home, tmp_path):
    """The path of a key that the bench trusts for authorisations."""
    path = make_key(tmp_path)
    call("keys", "trust", f"{path}.pub", "--person", "ada@lab.example")
    return path


@pytest.fixture
def run(home, make_run, tmp_path):
    """A sealed run of the bench."""
    with make_run(tmp_path / "run") as folder:
        seal(folder, load_key(home))
    return tmp_path / "run"


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

    monkeypatch.setattr(verify_command, "derivations", lambda *_, **__: [verify_command.check_authorisation])
    Ledger(home, VirtualClock(datetime(2026, 3, 1, tzinfo=UTC))).append("begun")
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
    assert "authorisation that is missing" in with_a_fault("verify", copy)


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
    assert "Not entered in a ledger" in done.output
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
    assert "SHA256SUMS.sig" in call(*stamp, "--request", tmp_path / "q.tsq")
    (tmp_path / "reply.tsr").write_bytes(tsa.reply((tmp_path / "q.tsq").read_bytes()))
    (tmp_path / "token").write_bytes(tsa.reply((tmp_path / "q.tsq").read_bytes(), "-token_out"))
    call(*stamp, "--token", tmp_path / "reply.tsr", fails="authority is trusted")
    call(*stamp, "--token", tmp_path / "q.tsq", fails="is not a time stamp")
    (tmp_path / "other.tsr").write_bytes(tsa.reply(other_request(tmp_path)))
    trusted = ("--tsa-certificates", tsa.root)
    call(*stamp, "--token", tmp_path / "other.tsr", *trusted, fails="time stamp of another file")
    shutil.copy(tsa.root, home / "tsa_laboratory.pem")
    output = call(*stamp, "--token", tmp_path / "token")
    assert output.startswith("SHA256SUMS.tsr: SHA256SUMS.sig existed at ")
    assert "laboratory's clock (Example TSA)" in output
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
