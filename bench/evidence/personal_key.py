"""A person's own key: in a file, or in ssh-agent. It never belongs to a bench."""

from __future__ import annotations

import base64
from collections.abc import Callable
from pathlib import Path

from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import ec, rsa
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from bench.base.errors import EvidenceError
from bench.evidence.openssh import SOCKET_VARIABLE, OpenSshKey, agent_lines
from bench.evidence.private_files import refuse_readable_by_others
from bench.evidence.signers import read_public_key
from bench.evidence.ssh_keys import check_key, fingerprint
from bench.evidence.sshsig import Ed25519Signer, SigningKey
from bench.record.storage import open_to_read

_MOST_BYTES = 1 << 20  # No answer of an agent and no key is as long


def load_file_key(path: Path, ask_passphrase: Callable[[Path], bytes]) -> SigningKey:
    """Load a person's key from a file in OpenSSH's format or PEM (PKCS#8), which other users cannot read."""
    with open_to_read(path) as stream:
        refuse_readable_by_others(path)
        data = stream.read(_MOST_BYTES)
    load = serialization.load_ssh_private_key if b"OPENSSH" in data else serialization.load_pem_private_key
    passphrase = b""
    try:
        try:
            private = load(data, password=None)
        except TypeError:  # cryptography raises it if the key is protected
            passphrase = ask_passphrase(path)
            private = load(data, password=passphrase)
        return _signing_key(private, path, passphrase)
    except (ValueError, UnsupportedAlgorithm) as error:
        why = "the passphrase is wrong, or the file is damaged" if passphrase else _reason(error)
        raise EvidenceError(
            f"The key cannot be used: {why}.",
            where=str(path),
            remedy="Try again. A key in a token is used by ssh-agent: name its file .pub.",
        ) from error


def _signing_key(private: object, path: Path, passphrase: bytes) -> SigningKey:
    """Return a key that was read. Raises ValueError if it cannot sign here."""
    if isinstance(private, Ed25519PrivateKey):
        return Ed25519Signer(private)
    if not isinstance(private, ec.EllipticCurvePrivateKey | rsa.RSAPrivateKey):
        raise ValueError("its type of key is not supported")  # noqa: TRY004 - not a wrong argument, but a wrong file
    public = private.public_key().public_bytes(
        serialization.Encoding.OpenSSH, serialization.PublicFormat.OpenSSH
    )
    blob = base64.b64decode(public.split()[1])
    check_key(blob)
    return OpenSshKey(blob, path, passphrase)


def find_key(name: str | None, agent: str | None, ask_passphrase: Callable[[Path], bytes]) -> SigningKey:
    """Find a key by its file, by its public key's, or by ``SHA256:...`` in ssh-agent; None is the only key there."""
    if name is None or name.startswith("SHA256:"):
        return _agent_key(name, agent)
    path = Path(name)
    with open_to_read(path) as stream:
        text = stream.read(_MOST_BYTES)
    try:
        public_key = read_public_key(text.decode(errors="replace"))
    except ValueError:
        return load_file_key(path, ask_passphrase)
    return _agent_key(fingerprint(public_key), agent)


def agent_keys(agent: str) -> list[OpenSshKey]:
    """List the keys of an agent that can be used here. Keys of other types and certificates are left out."""
    keys = []
    for line in agent_lines(agent):
        try:
            blob = read_public_key(line)
        except ValueError:
            continue
        comment = "".join(line.split(maxsplit=2)[2:])
        keys.append(OpenSshKey(blob, agent=agent, comment=comment))
    return keys


def _agent_key(wanted: str | None, agent: str | None) -> OpenSshKey:
    """Return the key of the agent with a fingerprint, or the only one."""
    if agent is None:
        raise EvidenceError(
            f"There is no ssh-agent: {SOCKET_VARIABLE} is not set.",
            remedy="Name the file of the private key with --key, or start ssh-agent and add the key with ssh-add.",
        )
    keys = agent_keys(agent)
    fitting = [key for key in keys if wanted in {None, fingerprint(key.public_key)}]
    if len(fitting) == 1:
        return fitting[0]
    held = ", ".join(f"{fingerprint(key.public_key)} ({key.comment})" for key in keys[:5]) or "none"
    what = f"ssh-agent does not hold the key {wanted}." if wanted else f"ssh-agent holds {len(keys)} keys."
    raise EvidenceError(
        what,
        where=agent,
        remedy=f"Its keys: {held}. Name one with --key SHA256:..., or add yours with ssh-add.",
    )


def _reason(error: Exception) -> str:
    """Return the first sentence of a message of the library, without its end."""
    return str(error).split(". ", maxsplit=1)[0].rstrip(".") or "wrong passphrase"
