"""The state of a folder as evidence: DRAFT, SEALED or AUTHORISED.

A state follows from signatures that hold. It does not follow from hashes of the files: `bench.evidence.verify` compares
those. Nothing is written.
"""

from __future__ import annotations

from collections.abc import Iterable
from datetime import datetime
from enum import StrEnum
from pathlib import Path

from bench.base.errors import EvidenceError
from bench.evidence.keys import AUTHORISATION_NAMESPACE, NAMESPACE, Signer
from bench.evidence.seal import AUTHORISATION
from bench.evidence.sshsig import SshSignature, is_valid, read_signature
from bench.records.run_folder import MANIFEST, SIGNATURE
from bench.records.storage import storage_errors


class State(StrEnum):
    """State of a folder as evidence; the value is the word that is shown."""

    DRAFT = "DRAFT"
    """Not sealed, or its seal does not hold."""
    SEALED = "SEALED"
    """Sealed by a bench; no person has authorised it."""
    AUTHORISED = "AUTHORISED"
    """Sealed, and authorised by a person with a trusted key."""


def state_of(folder: Path, signers: Iterable[Signer], when: datetime) -> State:
    """Return the state of a folder.

    Parameters
    ----------
    folder
        A run folder, a certificate folder, or a folder of results.
    signers
        Trusted keys, from `bench.evidence.keys.read_signers`.
    when
        Moment at which the person's key must be valid, with its time zone.

    Returns
    -------
    State
        The state. ``SEALED`` needs a seal whose signature holds, ``AUTHORISED`` also a person's signature of the
        seal that holds and is by a trusted key.

    Raises
    ------
    StorageError
        When a file cannot be read.
    """
    with storage_errors(folder):
        seal = _signed(folder, MANIFEST, SIGNATURE, NAMESPACE)
        if seal is None:
            return State.DRAFT
        person = _signed(folder, SIGNATURE, AUTHORISATION, AUTHORISATION_NAMESPACE)
    if person is None or person.public_key == seal.public_key:
        return State.SEALED
    known = [signer for signer in signers if signer.public_key == person.public_key]
    trusted = any(signer.rejection(AUTHORISATION_NAMESPACE, when) is None for signer in known)
    return State.AUTHORISED if trusted else State.SEALED


def _signed(folder: Path, name: str, signature_name: str, namespace: str) -> SshSignature | None:
    """Return the signature of a file if it holds, else None."""
    if not (folder / name).is_file() or not (folder / signature_name).is_file():
        return None
    try:
        signature = read_signature((folder / signature_name).read_bytes())
    except EvidenceError:
        return None
    holds = signature.namespace == namespace and is_valid(signature, (folder / name).read_bytes())
    return signature if holds else None
