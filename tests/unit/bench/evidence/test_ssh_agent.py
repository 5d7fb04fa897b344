"""The client of ssh-agent: with the real agent, with a PKCS#11 token in it, and without one."""

import os
import shutil
import subprocess
from contextlib import contextmanager
from pathlib import Path
from unittest import mock

import pytest
from authorising import make_key

from bench.base.errors import EvidenceError
from bench.evidence.personal_key import agent_keys, find_key
from bench.evidence.ssh_keys import fingerprint
from bench.evidence.sshsig import is_valid, read_signature

needs_agent = pytest.mark.skipif(
    not all(map(shutil.which, ("ssh-agent", "ssh-add", "ssh-keygen"))), reason="ssh-agent is not installed"
)
_PLACES = map(Path, ("/usr/lib/softhsm/libsofthsm2.so", "/usr/lib64/softhsm/libsofthsm2.so"))
_MODULE = next(filter(Path.exists, _PLACES), None)
needs_token = pytest.mark.skipif(
    _MODULE is None or not all(map(shutil.which, ("softhsm2-util", "pkcs11-tool", "ssh-agent"))),
    reason="SoftHSM2 and OpenSC are not installed",
)


@contextmanager
def running_agent(path, environment=None):
    """Start a real agent behind a socket; its process ends with the block."""
    command = ["ssh-agent", "-D", "-a", path, "-P", "*"]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, env=environment)
    try:
        while not path.exists():
            assert process.poll() is None
        yield str(path)
    finally:
        process.terminate()
        process.wait(10)


@pytest.fixture
def agent(tmp_path):
    """The socket of a real agent."""
    with running_agent(tmp_path / "agent") as socket:
        yield socket


def add(agent, *arguments, **environment):
    command = ["ssh-add", "-q", *arguments]
    env = {**os.environ, "SSH_AUTH_SOCK": agent, **environment}
    subprocess.run(command, env=env, check=True, capture_output=True)


@needs_agent
@pytest.mark.parametrize("kind", ["ed25519", "nistp256", "nistp384", "rsa"])
def test_a_key_in_the_agent_signs(agent, tmp_path, kind):
    path = make_key(tmp_path, kind=kind)
    add(agent, path)
    path.unlink()  # the agent alone has it now
    (agent_key,) = agent_keys(agent)
    assert agent_key.comment == "ada"
    for name in (None, fingerprint(agent_key.public_key), str(path.with_suffix(".pub"))):
        key = find_key(name, agent, lambda _: b"")
        assert is_valid(read_signature(key.sign(b"message", "a@v1")), b"message")


@needs_agent
def test_of_several_keys_one_must_be_named(agent, tmp_path):
    with pytest.raises(EvidenceError, match="holds 0 keys"):
        find_key(None, agent, lambda _: b"")
    for name in ("ada", "bea"):
        add(agent, make_key(tmp_path, name))
    with pytest.raises(EvidenceError, match=r"holds 2 keys.*\(ada\).*\(bea\)"):
        find_key(None, agent, lambda _: b"")
    with pytest.raises(EvidenceError, match="key SHA256:x"):
        find_key("SHA256:x", agent, lambda _: b"")
    with pytest.raises(EvidenceError, match="There is no ssh-agent"):
        find_key(None, None, lambda _: b"")


@needs_token
def test_a_key_in_a_pkcs11_token_signs(tmp_path):
    (tmp_path / "tokens").mkdir()
    (tmp_path / "softhsm2.conf").write_text(f"directories.tokendir = {tmp_path / 'tokens'}\n")
    (tmp_path / "pin").write_text("#!/bin/sh\necho 1234\n")
    (tmp_path / "pin").chmod(0o700)
    environment = {**os.environ, "SOFTHSM2_CONF": str(tmp_path / "softhsm2.conf")}
    init = ["softhsm2-util", "--init-token", "--free", "--label", "p", "--pin", "1234", "--so-pin", "5678"]
    subprocess.run(init, env=environment, check=True, capture_output=True)
    make = ["pkcs11-tool", "--module", _MODULE, "--login", "--pin", "1234", "--keypairgen", "--id", "01"]
    make += ["--key-type", "EC:prime256v1", "--label", "ada", "--usage-sign"]
    subprocess.run(make, env=environment, check=True, capture_output=True)
    with running_agent(tmp_path / "token-agent", environment) as own:
        asking = {"SSH_ASKPASS": str(tmp_path / "pin"), "SSH_ASKPASS_REQUIRE": "force", "DISPLAY": ":0"}
        add(own, "-s", str(_MODULE), **asking, SOFTHSM2_CONF=environment["SOFTHSM2_CONF"])
        key = find_key(None, own, lambda _: b"")
        signature = read_signature(key.sign(b"message", "a@v1"))
    assert is_valid(signature, b"message")


def test_an_agent_that_is_none_is_told_plainly(tmp_path):
    with pytest.raises(EvidenceError, match="ssh-agent does not answer"):
        agent_keys(str(tmp_path / "none"))


def test_an_agent_that_does_not_answer_is_given_up(tmp_path, monkeypatch):
    monkeypatch.setattr(subprocess, "run", mock.Mock(side_effect=subprocess.TimeoutExpired("ssh-add", 10)))
    with pytest.raises(EvidenceError, match=r"ssh-add .* 10 s"):
        agent_keys(str(tmp_path / "s"))


@needs_agent
def test_an_agent_that_refuses_to_sign_is_told_with_its_reason(agent, tmp_path):
    path = make_key(tmp_path)
    add(agent, path)
    (key,) = agent_keys(agent)
    add(agent, "-D")
    path.unlink()
    with pytest.raises(EvidenceError, match="ssh-keygen did not sign"):
        key.sign(b"message", "a@v1")
