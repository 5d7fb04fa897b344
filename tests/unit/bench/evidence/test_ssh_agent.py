"""The client of ssh-agent: with the real agent, with a PKCS#11 token in it, and with agents that answer anything."""

import os
import shutil
import socket
import subprocess
import threading
from contextlib import contextmanager
from pathlib import Path

import pytest
from authorising import make_key
from hypothesis import given
from hypothesis import strategies as st

from bench.base.errors import EvidenceError
from bench.evidence import ssh_agent
from bench.evidence.person_key import find_key
from bench.evidence.ssh_agent import AgentKey, agent_keys, read_identities, read_sign_response
from bench.evidence.ssh_wire import string
from bench.evidence.sshsig import is_valid, read_signature, sign_with

needs_agent = pytest.mark.skipif(
    not all(map(shutil.which, ("ssh-agent", "ssh-add", "ssh-keygen"))), reason="ssh-agent is not installed"
)
_MODULE = next(
    (
        p
        for p in map(Path, ("/usr/lib/softhsm/libsofthsm2.so", "/usr/lib64/softhsm/libsofthsm2.so"))
        if p.exists()
    ),
    None,
)
needs_token = pytest.mark.skipif(
    _MODULE is None or not all(map(shutil.which, ("softhsm2-util", "pkcs11-tool", "ssh-agent"))),
    reason="SoftHSM2 and OpenSC are not installed",
)


@pytest.fixture
def agent(tmp_path):
    """The socket of a real agent; its process ends with the test."""
    path = tmp_path / "agent"
    process = subprocess.Popen(["ssh-agent", "-D", "-a", path, "-P", "*"], stdout=subprocess.DEVNULL)
    while not path.exists():
        assert process.poll() is None
    yield str(path)
    process.terminate()
    process.wait(10)


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
    (found,) = agent_keys(agent)
    assert found.comment == "ada"
    for name in (None, found.fingerprint, str(path.with_suffix(".pub"))):
        key = find_key(name, agent, lambda _: b"")
        assert is_valid(read_signature(sign_with(key, b"message", "a@v1")), b"message")


@needs_agent
def test_of_several_keys_one_must_be_named(agent, tmp_path):
    with pytest.raises(EvidenceError, match="holds 0 keys"):
        find_key(None, agent, lambda _: b"")
    for name in ("ada", "bea"):
        add(agent, make_key(tmp_path, name))
    with pytest.raises(EvidenceError, match=r"holds 2 keys.*\(ada\).*\(bea\)"):
        find_key(None, agent, lambda _: b"")
    with pytest.raises(EvidenceError, match="does not hold the key SHA256:x"):
        find_key("SHA256:x", agent, lambda _: b"")
    with pytest.raises(EvidenceError, match="There is no ssh-agent"):
        find_key(None, None, lambda _: b"")


@needs_token
def test_a_key_in_a_pkcs11_token_signs(agent, tmp_path):
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
    own = str(tmp_path / "token-agent")
    process = subprocess.Popen(
        ["ssh-agent", "-D", "-a", own, "-P", "*"], env=environment, stdout=subprocess.DEVNULL
    )
    try:
        while not Path(own).exists():
            assert process.poll() is None
        asking = {"SSH_ASKPASS": str(tmp_path / "pin"), "SSH_ASKPASS_REQUIRE": "force", "DISPLAY": ":0"}
        add(own, "-s", str(_MODULE), **asking, SOFTHSM2_CONF=environment["SOFTHSM2_CONF"])
        key = find_key(None, own, lambda _: b"")
        signature = read_signature(sign_with(key, b"message", "a@v1"))
    finally:
        process.terminate()
        process.wait(10)
    assert is_valid(signature, b"message")


@contextmanager
def answering(tmp_path, answer):
    """An agent that gives this answer to everything."""
    server = socket.socket(socket.AF_UNIX)
    path = str(tmp_path / "s")
    server.bind(path)
    server.listen(4)

    def serve():
        while True:
            try:
                connection, _ = server.accept()
            except OSError:
                return
            with connection:
                connection.recv(65536)
                connection.sendall(answer)

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    try:
        yield path
    finally:
        server.shutdown(socket.SHUT_RDWR)
        server.close()
        thread.join(5)


@pytest.mark.parametrize(
    ("answer", "why"),
    [
        (b"", "closed the connection"),
        (b"\0\0\0\x05\x0c", "closed the connection"),
        (b"\xff\xff\xff\xff", "4294967295 bytes"),
        (b"\0\0\0\0", "0 bytes"),
        (string(b"\x05"), "refused"),
        (string(b"\x0c\0\0\xff\xff"), "65535 keys"),
        (string(b"\x0c\0\0\0\x01"), "incomplete"),
        (string(b"\x63"), "message 99"),
    ],
)
def test_an_agent_that_answers_anything_else_is_told_plainly(tmp_path, answer, why):
    with answering(tmp_path, answer) as path, pytest.raises(EvidenceError, match=why):
        agent_keys(path)


@pytest.mark.parametrize(
    "answer",
    [
        string(b"\x05"),
        string(b"\x0e" + string(b"")),
        string(b"\x0e" + string(string(b"ssh-ed25519") + string(b"x" * 64))),
    ],
)
def test_a_signature_that_is_none_is_refused(tmp_path, key, answer):
    with answering(tmp_path, answer) as path, pytest.raises(EvidenceError, match="did not sign"):
        AgentKey(key.public_key, "ada", path).sign(b"data")


def test_an_agent_that_does_not_answer_is_given_up(tmp_path, monkeypatch):
    monkeypatch.setattr(ssh_agent, "_LIST_S", 0.1)
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(tmp_path / "s"))
        server.listen(1)
        with pytest.raises(EvidenceError, match="no answer within 0 s"):
            agent_keys(str(tmp_path / "s"))
    with pytest.raises(EvidenceError, match="does not answer"):
        agent_keys(str(tmp_path / "none"))


@given(st.binary(max_size=200))
def test_any_bytes_are_an_answer_or_a_value_error(data):
    for read, kind in ((read_identities, list), (read_sign_response, bytes)):
        for answer in (data, b"\x0c" + data, b"\x0e" + data):
            try:
                found = read(answer)
            except ValueError:
                continue
            assert isinstance(found, kind)


@given(st.lists(st.tuples(st.binary(max_size=60), st.text(max_size=20)), max_size=5))
def test_a_list_of_keys_is_read_as_written(keys):
    answer = b"\x0c" + len(keys).to_bytes(4, "big")
    answer += b"".join(string(blob) + string(comment.encode()) for blob, comment in keys)
    assert read_identities(answer) == keys
