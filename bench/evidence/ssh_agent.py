"""A client of ssh-agent: lists keys and asks for signatures (draft-ietf-sshm-ssh-agent, "SSH Agent Protocol").

The agent holds the private keys, or reaches them in a security token or by PKCS#11; they never come here. Two messages
are used: the list of identities and a signature.
"""

from __future__ import annotations

import os
import socket
from collections.abc import Mapping
from dataclasses import dataclass

from bench.base.errors import EvidenceError
from bench.evidence.ssh_keys import RSA, PublicKey, fingerprint, key_type_of
from bench.evidence.ssh_wire import Reader, string

SOCKET_VARIABLE = "SSH_AUTH_SOCK"

_FAILURE, _REQUEST_IDENTITIES, _IDENTITIES, _SIGN_REQUEST, _SIGN_RESPONSE = 5, 11, 12, 13, 14
_RSA_SHA2_512 = 4
"""Flag of a signature request: sign with rsa-sha2-512."""
_MOST_BYTES = 256 * 1024
_MOST_KEYS = 2048
_LIST_S, _SIGN_S = 10.0, 120.0
"""Longest wait for the list, and for a signature, for which a person may have to touch a token or enter a PIN, s."""


@dataclass(frozen=True)
class AgentKey:
    """A key that the agent can sign with."""

    public_key: bytes
    comment: str  # The agent's comment, usually the file or token that the key is from
    agent: str  # Path of the agent's socket

    @property
    def fingerprint(self) -> str:
        """Fingerprint of the key."""
        return fingerprint(self.public_key)

    def sign(self, data: bytes) -> bytes:
        """Ask the agent for a signature.

        Raises EvidenceError: When the agent does not answer, refuses, or returns something else than a valid
          signature of this key.
        """
        flags = _RSA_SHA2_512 if key_type_of(self.public_key) == RSA.decode() else 0
        message = bytes([_SIGN_REQUEST]) + string(self.public_key) + string(data) + flags.to_bytes(4, "big")
        answer = _ask(self.agent, message, _SIGN_S)
        try:
            signature = read_sign_response(answer)
            if PublicKey.parse(self.public_key).is_valid(signature, data):
                return signature
            why = "its signature is not valid for this key"
        except ValueError as error:
            why = str(error)
        raise EvidenceError(
            f"ssh-agent did not sign with {self.fingerprint}: {why}.",
            where=self.agent,
            remedy="Check with `ssh-add -l` that it holds the key; confirm at the token or enter its PIN if asked.",
        )


def agent_socket(environ: Mapping[str, str] = os.environ) -> str | None:
    """Return the socket of the agent of this session.

    Returns: Path of the socket; None if there is no agent.
    """
    return environ.get(SOCKET_VARIABLE) or None


def agent_keys(agent: str) -> list[AgentKey]:
    """List the keys of an agent that can be used here. Keys of other types and certificates are left out.

    agent: Path of the agent's socket.
    Raises EvidenceError: When the agent does not answer, or its answer is not understood.
    """
    answer = _ask(agent, bytes([_REQUEST_IDENTITIES]), _LIST_S)
    try:
        found = read_identities(answer)
    except ValueError as error:
        raise EvidenceError(
            f"The answer of ssh-agent is not understood: {error}.",
            where=agent,
            remedy="Start the agent again.",
        ) from error
    return [AgentKey(key, _printable(comment), agent) for key, comment in found if _is_known(key)]


def read_identities(answer: bytes) -> list[tuple[bytes, str]]:
    """Read the list of identities.

    answer: The message of the agent, without its length.
    Raises ValueError: When it is another message, or incomplete.
    """
    reader = Reader(answer)
    kind = reader.byte()
    if kind != _IDENTITIES:
        raise ValueError("the agent refused" if kind == _FAILURE else f"it is message {kind}")
    count = reader.uint32()
    if count > _MOST_KEYS:
        raise ValueError(f"it has {count} keys")
    found = [(reader.string(), reader.string().decode(errors="replace")) for _ in range(count)]
    reader.end()
    return found


def read_sign_response(answer: bytes) -> bytes:
    """Read a signature.

    answer: The message of the agent, without its length.
    Raises ValueError: When the agent refused, or the message is another one or incomplete.
    """
    reader = Reader(answer)
    kind = reader.byte()
    if kind != _SIGN_RESPONSE:
        raise ValueError("the agent refused" if kind == _FAILURE else f"it answered with message {kind}")
    signature = reader.string()
    reader.end()
    return signature


def _printable(comment: str) -> str:
    return "".join(c if c.isprintable() else "?" for c in comment)


def _is_known(public_key: bytes) -> bool:
    try:
        PublicKey.parse(public_key)
    except ValueError:
        return False
    return True


def _ask(agent: str, message: bytes, wait_s: float) -> bytes:
    """Send one message and return the answer, both without their length."""
    if not hasattr(socket, "AF_UNIX"):
        raise EvidenceError("ssh-agent cannot be used on this system.", remedy="Name the file of the key.")
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
            connection.settimeout(wait_s)
            connection.connect(agent)
            connection.sendall(string(message))
            size = int.from_bytes(_receive(connection, 4), "big")
            if not 0 < size <= _MOST_BYTES:
                raise ValueError(f"it has {size} bytes")  # noqa: TRY301 - all that can go wrong is told below
            return _receive(connection, size)
    except (OSError, ValueError) as error:
        why = f"no answer within {wait_s:.0f} s" if isinstance(error, TimeoutError) else str(error)
        raise EvidenceError(
            f"ssh-agent does not answer: {why}.",
            where=agent,
            remedy=f"Start it and add the key with ssh-add; {SOCKET_VARIABLE} names its socket.",
        ) from error


def _receive(connection: socket.socket, size: int) -> bytes:
    """Receive exactly so many bytes. Raises ValueError when the agent closes the connection earlier."""
    data = b""
    while len(data) < size:
        more = connection.recv(size - len(data))
        if not more:
            raise ValueError("it closed the connection")
        data += more
    return data
