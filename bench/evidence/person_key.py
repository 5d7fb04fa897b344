"""A person's own key: in a file, or in ssh-agent. It never belongs to a bench."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec, padding, rsa
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from bench.base.errors import EvidenceError
from bench.evidence.safe_files import refuse_readable_by_others
from bench.evidence.signers import read_public_key
from bench.evidence.ssh_agent import SOCKET_VARIABLE, AgentKey, agent_keys
from bench.evidence.ssh_keys import (
    KEY_TYPE,
    PublicKey,
    curve_hash,
    encode_ecdsa_signature,
    encode_public_key,
    fingerprint,
)
from bench.evidence.ssh_wire import string
from bench.evidence.sshsig import SigningKey
from bench.records.storage import storage_errors

_PrivateKey = Ed25519PrivateKey | ec.EllipticCurvePrivateKey | rsa.RSAPrivateKey
_MOST_BYTES = 1 << 20


@dataclass(frozen=True)
class FileKey:
    """A person's key from a file."""

    private: _PrivateKey  # The private key; ``repr`` does not show it

    def __repr__(self) -> str:
        return f"FileKey({fingerprint(self.public_key)})"

    @property
    def public_key(self) -> bytes:
        """The public key as SSH encodes it."""
        return encode_public_key(self.private.public_key())

    def sign(self, data: bytes) -> bytes:
        """Sign data (see `bench.evidence.sshsig.SigningKey.sign`).

        Returns: The signature as SSH encodes it; RSA keys sign with rsa-sha2-512 (RFC 8332).
        """
        if isinstance(self.private, Ed25519PrivateKey):
            return string(KEY_TYPE) + string(self.private.sign(data))
        if isinstance(self.private, rsa.RSAPrivateKey):
            signature = self.private.sign(data, padding.PKCS1v15(), hashes.SHA512())
            return string(b"rsa-sha2-512") + string(signature)
        key_type = PublicKey.parse(self.public_key).key_type
        return encode_ecdsa_signature(key_type, self.private.sign(data, ec.ECDSA(curve_hash(key_type))))


def load_file_key(path: Path, ask_passphrase: Callable[[Path], bytes]) -> FileKey:
    """Load a person's key from a file: in OpenSSH's format, or PEM (PKCS#8).

    ask_passphrase: Returns the passphrase of a protected key, given the path of its file.
    Raises EvidenceError: When other users can read the file, the passphrase is wrong, or it is not a key that
      can sign here.
    Raises StorageError: When the file cannot be read.
    """
    with storage_errors(path):
        refuse_readable_by_others(path)
        with path.open("rb") as stream:
            data = stream.read(_MOST_BYTES)
    load = serialization.load_ssh_private_key if b"OPENSSH" in data else serialization.load_pem_private_key
    is_protected = False
    try:
        try:
            private = load(data, password=None)
        except TypeError:  # cryptography raises it if the key is protected
            is_protected = True
            private = load(data, password=ask_passphrase(path))
        key = _file_key(private)
    except (ValueError, UnsupportedAlgorithm) as error:
        why = "the passphrase is wrong, or the file is damaged" if is_protected else _reason(error)
        raise EvidenceError(
            f"The key cannot be used: {why}.",
            where=str(path),
            remedy="Try again. A key in a token is used by ssh-agent: name its file .pub.",
        ) from error
    return key


def _file_key(private: object) -> FileKey:
    """Return a key that was read. Raises ValueError if it cannot sign here."""
    if not isinstance(private, Ed25519PrivateKey | ec.EllipticCurvePrivateKey | rsa.RSAPrivateKey):
        raise ValueError("its type of key is not supported")  # noqa: TRY004 - not a wrong argument, but a wrong file
    PublicKey.parse(encode_public_key(private.public_key()))
    return FileKey(private)


def find_key(name: str | None, agent: str | None, ask_passphrase: Callable[[Path], bytes]) -> SigningKey:
    """Find a person's key by its file, by the file of its public key, or by its fingerprint.

    name: File of the private key; or file of the public key, or fingerprint (``SHA256:...``), of a key in
      ssh-agent. None for the only key in ssh-agent.
    agent: Path of the agent's socket; None if there is no agent.
    ask_passphrase: Returns the passphrase of a protected key, given the path of its file.
    Raises EvidenceError: When there is no such key, more than one, or it cannot be used.
    Raises StorageError: When a file cannot be read.
    """
    if name is None or name.startswith("SHA256:"):
        return _agent_key(name, agent)
    path = Path(name)
    with storage_errors(path), path.open("rb") as stream:
        text = stream.read(_MOST_BYTES)
    try:
        public_key = read_public_key(text.decode(errors="replace"))
    except ValueError:
        return load_file_key(path, ask_passphrase)
    return _agent_key(fingerprint(public_key), agent)


def _agent_key(wanted: str | None, agent: str | None) -> AgentKey:
    """Return the key of the agent with a fingerprint, or the only one."""
    if agent is None:
        raise EvidenceError(
            f"There is no ssh-agent: {SOCKET_VARIABLE} is not set.",
            remedy="Name the file of the private key with --key, or start ssh-agent and add the key with ssh-add.",
        )
    keys = agent_keys(agent)
    found = [key for key in keys if wanted in {None, key.fingerprint}]
    if len(found) == 1:
        return found[0]
    held = ", ".join(f"{key.fingerprint} ({key.comment})" for key in keys[:5]) or "none"
    what = f"ssh-agent does not hold the key {wanted}." if wanted else f"ssh-agent holds {len(keys)} keys."
    raise EvidenceError(
        what,
        where=agent,
        remedy=f"Its keys: {held}. Name one with --key SHA256:..., or add yours with ssh-add.",
    )


def _reason(error: Exception) -> str:
    """Return the first sentence of a message of the library, without its end."""
    return str(error).split(". ", maxsplit=1)[0].rstrip(".") or "wrong passphrase"
