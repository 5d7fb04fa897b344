"""The state of a folder as evidence: DRAFT, SEALED or AUTHORISED, and what its signatures and time stamps say.

It follows from signatures, not from hashes (`bench.evidence.verify`). Nothing is written or asked over a network.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

from bench.base.bounded_json import parse_json
from bench.base.errors import BenchError, EvidenceError, StorageError
from bench.evidence.authorisation import check_authorisation
from bench.evidence.authorisations import NOTHING_KNOWN, Known, compare_authorisation
from bench.evidence.beside_seal import read_beside
from bench.evidence.findings import State, Verification
from bench.evidence.key_trust import Moments, Trust, judge_key, read_trust
from bench.evidence.openssh import NotInstalled
from bench.evidence.seal import AUTHORISATION, AUTHORISATION_TIMESTAMP, TIMESTAMP
from bench.evidence.signers import NAMESPACE
from bench.evidence.ssh_keys import fingerprint
from bench.evidence.sshsig import is_valid, read_signature
from bench.evidence.timestamp import Stamp, check_timestamps
from bench.record.run_folder import (
    CERTIFICATE,
    JOURNAL,
    MANIFEST,
    PAGE_SIGNATURE,
    REPORT,
    RESULTS,
    SIGNATURE,
    is_sealed,
)
from bench.record.storage import is_plain_file, read_json, storage_errors
from bench.record.stored_run import StoredRun

_PLACES = ((CERTIFICATE, ("issued_utc",)), (RESULTS, ("run", "calibrated_utc")))
_LAST_BYTES = 1 << 20
"""The last line of a journal is shorter than this."""
_STAMPED = {SIGNATURE: "The seal", AUTHORISATION: "The authorisation"}
_CLOCK_SLACK = timedelta(minutes=10)
"""Clocks of a bench and of a time stamping authority may differ so much without a remark: that of a computer without a
time server may be minutes off."""
LARGEST_SEAL_BYTES = 64 << 20
"""Seals of ten thousand poses are smaller; a larger file is not read."""


def stated_time(folder: Path) -> datetime | None:
    """Return when a folder was made, UTC: end of run, issue, or recalculation; None if no file states it."""
    journal = folder / JOURNAL
    if is_plain_file(journal):
        return _last_time(journal)
    for name, keys in _PLACES:
        path = folder / name
        if is_plain_file(path):
            try:
                content = read_json(path)
                for key in keys:
                    content = content[key]
            except (StorageError, ValueError, LookupError, TypeError):
                continue
            if moment := _moment(content):
                return moment
    return None


def _last_time(journal: Path) -> datetime | None:
    """Return the time of the last line of a journal. Its hash chain is checked elsewhere."""
    with journal.open("rb") as stream:
        size = stream.seek(0, os.SEEK_END)
        stream.seek(max(0, size - _LAST_BYTES))
        end = stream.read()
    try:
        return _moment(parse_json(end[end.rfind(b"\n", 0, -1) + 1 :])["utc"])
    except (ValueError, LookupError, TypeError):
        return None


def _moment(text: object) -> datetime | None:
    try:
        moment = datetime.fromisoformat(str(text))
        return moment.astimezone(UTC) if moment.tzinfo is not None else None
    except (ValueError, OverflowError):
        return None


def standing_of(folder: Path, trust: Trust, now: datetime, *, at: datetime | None = None) -> Verification:
    """Check signatures and time stamps beside a folder; the listed files themselves are not hashed.

    The kinds of the faults are ``unsealed``, ``signature``, ``manifest``, ``key``, ``authorisation``, ``timestamp``.
    ``at`` is the moment at which keys must be valid; None for the seal's by the bench's clock. A trusted stamp goes
    before.
    """
    verification = Verification(folder=str(folder))
    with storage_errors(folder):
        stamps = check_timestamps(folder, trust.authorities, verification)
        verification.stated = stated_time(folder)
        sealed = verification.stated or now
        seal_key = _seal(verification, folder)
        own = stamps.get(AUTHORISATION_TIMESTAMP)
        check = check_authorisation(folder, trust, Moments(now, own, at, min(sealed, now), now), seal_key)
    if seal_key is not None:
        # An authorisation that is accepted signs the seal: its time stamp proves that the seal existed.
        proofs = [stamps.get(TIMESTAMP), own if check.principal is not None else None]
        proven = min(filter(None, proofs), key=lambda stamp: stamp.utc, default=None)
        _judge_seal(verification, seal_key, trust, Moments(now, proven, at, sealed, sealed))
    if seal_key is None and not (folder / MANIFEST).exists():
        with storage_errors(folder):
            check_ended_page(folder, trust, now, sealed, verification)
    if check.unchecked:
        verification.not_compared.append(f"{AUTHORISATION}: {check.unchecked}")
    if check.fault:
        verification.fault("authorisation", AUTHORISATION, check.fault)
    elif check.principal is not None and verification.state is State.SEALED:
        verification.state = State.AUTHORISED
        verification.person, verification.person_fingerprint = check.principal, check.fingerprint
        verification.statements.append(
            f"Authorised by {verification.person} ({verification.person_fingerprint})"
        )
        verification.remarks += [f"{AUTHORISATION}: {check.remark}"] if check.remark else []
    verification.statements += [f"{_STAMPED[stamp.of]} existed at {stamp.text}" for stamp in stamps.values()]
    _clocks(verification, stamps.values(), now)
    return verification


def _seal(verification: Verification, folder: Path) -> bytes | None:
    """Check the signature of the list of files; return the key that made it."""
    try:
        manifest = folder / MANIFEST
        for path in (manifest, folder / SIGNATURE):
            if not is_plain_file(path):
                why = "this is a link, not a file" if path.is_symlink() else "the file is missing"
                verification.fault("unsealed", path.name, f"{why}; this folder is not sealed")
                return None
        if manifest.stat().st_size > LARGEST_SEAL_BYTES:
            verification.fault("manifest", MANIFEST, f"more than {LARGEST_SEAL_BYTES} bytes")
            return None
        signature = read_signature(read_beside(folder, SIGNATURE) or b"")
    except EvidenceError as error:
        verification.fault("signature", SIGNATURE, error.what)
        return None
    verification.fingerprint = fingerprint(signature.public_key)
    what = ""
    try:
        if signature.namespace != NAMESPACE:
            what = f"the signature is for {signature.namespace!r}, not for a report"
        elif not is_valid(signature, manifest.read_bytes()):
            what = f"the signature does not match this {MANIFEST}"
    except NotInstalled as error:
        what = error.what
    if not what:
        verification.state = State.SEALED
    else:
        verification.fault("signature", SIGNATURE, what)
    return signature.public_key


def _judge_seal(verification: Verification, public_key: bytes, trust: Trust, moments: Moments) -> None:
    """Decide whether the bench's key could seal then."""
    judged = judge_key(public_key, NAMESPACE, trust, moments)
    verification.signer = judged.principal
    if judged.fault:
        verification.fault("key", SIGNATURE, judged.fault)
    elif judged.remark:
        verification.remarks.append(f"{SIGNATURE}: {judged.remark}")


def _clocks(verification: Verification, stamps: Iterable[Stamp], now: datetime) -> None:
    """Remark on times that contradict each other."""
    if verification.stated is None:
        return
    stated = f"{verification.stated:%Y-%m-%d %H:%M} UTC"
    for stamp in stamps:
        if stamp.utc < verification.stated - _CLOCK_SLACK:
            verification.remarks.append(
                f"{stamp.file}: {stamp.of} existed at {stamp.text}, but the bench's own clock stated the later time"
                f" {stated}. One of both clocks was wrong"
            )
    if verification.stated > now + _CLOCK_SLACK:
        verification.remarks.append(f"the bench's own clock stated a time in the future: {stated}")


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
    """Return the state of a folder as one line; ``known`` holds the authorisations that the ledger names."""
    if not is_sealed(folder):
        return ShownState()
    try:
        standing = standing_of(folder, trust, now)
        compared = compare_authorisation(folder, known)
        standing.add(compared)
    except StorageError as error:
        return ShownState(State.DRAFT, f"DRAFT: the seal cannot be read: {error.what}")
    text = _text(standing)
    return ShownState(standing.state, ". Note: ".join([text, *compared.remarks]))


def _text(standing: Verification) -> str:
    if standing.state is State.DRAFT:
        return "DRAFT: the seal does not hold; see `starbench verify`"
    bench = standing.signer or f"a key that is not accepted here ({standing.fingerprint})"
    text = f"SEALED by {bench}"
    if standing.state is State.AUTHORISED:
        text = f"AUTHORISED by {standing.person}, sealed by {bench}"
    other_faults = [fault for fault in standing.faults if fault.kind in {"authorisation", "timestamp"}]
    return f"{text}. FAULT: {other_faults[0]}" if other_faults else text


def check_ended_page(
    folder: Path, trust: Trust, now: datetime, stated: datetime, verification: Verification
) -> None:
    """Tell what does not hold on the page of a folder without a seal, or what does; nothing without a page."""
    try:
        armoured = read_beside(folder, PAGE_SIGNATURE)
        if armoured is None:
            return
        signature = read_signature(armoured)
        page = (folder / REPORT).read_bytes() if is_plain_file(folder / REPORT) else b""
        holds = signature.namespace == NAMESPACE and is_valid(signature, page)
    except EvidenceError as error:
        verification.fault("signature", PAGE_SIGNATURE, error.what)
        return
    judged = judge_key(signature.public_key, NAMESPACE, trust, Moments(now, None, None, stated, stated))
    if not holds:
        verification.fault("signature", PAGE_SIGNATURE, f"the signature does not match this {REPORT}")
    elif judged.fault:
        verification.fault("key", PAGE_SIGNATURE, judged.fault)
    elif why := _of_another_journal(folder, page):
        verification.fault("journal", JOURNAL, why)
    else:
        signer = f"{judged.principal} ({fingerprint(signature.public_key)})"
        verification.statements.append(
            f"{REPORT} is the page of a run that did not finish, signed by {signer}; its journal is whole"
        )


def _of_another_journal(folder: Path, page: bytes) -> str:
    """Return why the page is not that of the folder's journal; empty if it names its last line."""
    try:
        head = StoredRun(folder).head
    except BenchError as error:
        return f"it cannot be compared with {REPORT}: {error}"
    return "" if head and head.encode() in page else f"its last line is not the one that {REPORT} names"
