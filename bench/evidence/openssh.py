"""What is left to OpenSSH: signatures of other keys than Ed25519, and keys in ssh-agent or a security token.

``ssh-keygen -Y`` signs and checks, ``ssh-add -L`` lists what the agent holds. A call takes about 5 ms. Messages and
signatures pass through a folder of their own; a private key never does.
"""

from __future__ import annotations

import os
import shutil
import stat
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from bench.base.encoding import printable_only
from bench.base.errors import EvidenceError
from bench.evidence.ssh_keys import (
    key_text,
)

SOCKET_VARIABLE = "SSH_AUTH_SOCK"
_CHECK_S, _SIGN_S = 10.0, 120.0
"""Longest wait for a check or a list, which take no time on an idle computer, and for a signature, for which a person
may have to touch a token, s."""
_ASKED = "STARBENCH_ASKED"
_ASK = f"#!/bin/sh\nprintf '%s\\n' \"${_ASKED}\"\n"


class NotInstalled(EvidenceError):
    """A program of OpenSSH is needed, and is not here."""


@dataclass(frozen=True)
class OpenSshKey:
    """A key with which ssh-keygen signs: in a file, or behind ssh-agent."""

    public_key: bytes  # The public key as SSH encodes it
    path: Path | None = None  # File of the private key; None for a key behind the agent
    passphrase: bytes = b""  # That of the file
    agent: str | None = None  # Path of the agent's socket
    comment: str = ""  # The agent's comment, usually the file or token that the key is from

    def __repr__(self) -> str:
        return f"OpenSshKey({key_text(self.public_key)})"

    def sign(self, message: bytes, namespace: str) -> bytes:
        """Return the armoured signature of a message. Raises EvidenceError when OpenSSH cannot make it."""
        with tempfile.TemporaryDirectory(prefix="starbench-sign-") as folder:
            public, ask, data = (Path(folder) / name for name in ("key.pub", "ask", "message"))
            data.write_bytes(message)
            public.write_text(f"{key_text(self.public_key)}\n")
            ask.write_text(_ASK)
            ask.chmod(stat.S_IRWXU)
            of_key = {"SSH_ASKPASS": str(ask), "SSH_ASKPASS_REQUIRE": "force", "DISPLAY": ":0"}
            of_agent = {SOCKET_VARIABLE: self.agent} if self.agent else {}
            environment = {_ASKED: os.fsdecode(self.passphrase), **of_key} if self.path else of_agent
            if self.path:  # ssh-keygen looks for the public key beside the private one
                (private := public.with_suffix("")).symlink_to(self.path.absolute())
            command = ["-Y", "sign", "-n", namespace, "-f", str(private if self.path else public), str(data)]
            done = _run("ssh-keygen", command, environment, _SIGN_S)
            signature = data.with_name("message.sig")
            if done.returncode == 0 and signature.exists():
                return signature.read_bytes()
        complaint = done.stderr.decode(errors="replace").strip().splitlines() or ["it gave no reason"]
        raise EvidenceError(
            f"ssh-keygen did not sign with this key: {printable_only(complaint[-1])}.",
            where=str(self.path or self.agent or ""),
            remedy="Check with `ssh-add -l` that the agent holds the key; confirm at the token or enter its PIN if"
            " asked.",
        )


def is_valid_for_openssh(armoured: bytes, message: bytes, namespace: str) -> bool:
    """Return whether a signature is valid for a message, by the key in it; whether that is trusted is not asked."""
    with tempfile.TemporaryDirectory(prefix="starbench-check-") as folder:
        signature = Path(folder) / "signature"
        signature.write_bytes(armoured)
        command = ["-Y", "check-novalidate", "-n", namespace, "-s", str(signature)]
        return _run("ssh-keygen", command, {}, _CHECK_S, message).returncode == 0


def agent_socket(environ: Mapping[str, str] = os.environ) -> str | None:
    """Return the path of the socket of this session's agent; None if there is no agent."""
    return environ.get(SOCKET_VARIABLE) or None


def agent_lines(agent: str) -> list[str]:
    """Return the public keys of an agent, a line each: type, base64 and comment."""
    done = _run("ssh-add", ["-L"], {SOCKET_VARIABLE: agent}, _CHECK_S)
    text = done.stdout.decode(errors="replace")
    if done.returncode == 0:
        return [printable_only(line) for line in text.splitlines()]
    if done.returncode == 1 and "no identities" in text:
        return []
    complaint = done.stderr.decode(errors="replace").strip() or f"status {done.returncode}"
    raise EvidenceError(
        f"ssh-agent does not answer: {printable_only(complaint)}.",
        where=agent,
        remedy=f"Start it and add the key with ssh-add; {SOCKET_VARIABLE} names its socket.",
    )


def _run(
    program: str, arguments: Sequence[str], environment: Mapping[str, str], wait_s: float, data: bytes = b""
) -> subprocess.CompletedProcess[bytes]:
    """Run a program of OpenSSH without a shell and without the terminal."""
    path = shutil.which(program)
    if path is None:
        raise NotInstalled(
            f"This needs {program} of OpenSSH, which is not installed.",
            remedy="Install OpenSSH (Debian: apt install openssh-client), or use an Ed25519 key in a file.",
        )
    try:
        return subprocess.run(
            [path, *arguments],
            env={**os.environ, **environment},
            input=data,
            capture_output=True,
            timeout=wait_s,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise EvidenceError(
            f"{program} gave no answer within {wait_s:.0f} s.",
            remedy="Touch the token if it asks, and try again.",
        ) from error
