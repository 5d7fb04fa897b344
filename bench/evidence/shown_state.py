"""The state of a folder as one line, for lists and pages. Signatures are checked; files are not hashed."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from bench.base.errors import EvidenceError, StorageError
from bench.evidence.faults import SealFault
from bench.evidence.key_trust import Trust, read_trust
from bench.evidence.ledger_authorisation import NOTHING_KNOWN, Known, compare_authorisation
from bench.evidence.seal import AUTHORISATION
from bench.evidence.states import Standing, State, standing_of
from bench.records.run_folder import is_sealed


@dataclass(frozen=True)
class ShownState:
    """The state of a folder, to be shown."""

    state: State = State.DRAFT  # ``DRAFT``, ``SEALED`` or ``AUTHORISED``
    text: str = "DRAFT: not sealed"


def home_trust(home: Path) -> Trust:
    """Return whom this bench trusts; nobody, if its lists cannot be used."""
    try:
        return read_trust(home)
    except (EvidenceError, StorageError):
        return Trust()


def shown_state(folder: Path, trust: Trust, now: datetime, known: Known = NOTHING_KNOWN) -> ShownState:
    """Return the state of a folder as one line.

    folder: A run folder, a certificate folder, or a folder of results.
    now: The present time, with its time zone.
    known: Authorisations that the ledger names, from
      `bench.evidence.ledger_authorisation.known_authorisations`.
    """
    if not is_sealed(folder):
        return ShownState()
    try:
        standing = standing_of(folder, trust, now)
        compared = compare_authorisation(folder, known)
        if compared.fault:
            standing.faults.append(SealFault("authorisation", AUTHORISATION, compared.fault))
    except StorageError as error:
        return ShownState(State.DRAFT, f"DRAFT: the seal cannot be read: {error.what}")
    text = _text(standing)
    return ShownState(standing.state, f"{text}. Note: {compared.note}" if compared.note else text)


def _text(standing: Standing) -> str:
    if standing.state is State.DRAFT:
        return "DRAFT: the seal does not hold; see `starbench verify`"
    bench = standing.signer or f"a key that is not accepted here ({standing.fingerprint})"
    text = f"SEALED by {bench}"
    if standing.state is State.AUTHORISED:
        text = f"AUTHORISED by {standing.person}, sealed by {bench}"
    beside = [fault for fault in standing.faults if fault.kind in {"authorisation", "timestamp"}]
    return f"{text}. FAULT: {beside[0]}" if beside else text
