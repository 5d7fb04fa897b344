"""Whether a key could sign at the moment at which it signed: trusted for the purpose, valid then, not revoked.

The moment is that of a trusted time stamp, else the reader's (``verify --at``), else that of the bench's clock:
believed, with a remark if the key has expired since, because whoever has it can write any date. A revoked key needs the
stamp.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path

from bench.evidence.revoked_keys import REVOKED_FILE, RevokedKey, read_revoked
from bench.evidence.signers import SIGNERS_FILE, Signer, read_signers
from bench.evidence.ssh_keys import fingerprint
from bench.evidence.timestamp import Stamp, TrustedAuthorities, read_authorities


@dataclass(frozen=True)
class Trust:
    """Whom the reader trusts; all of it comes from outside the sealed folder."""

    signers: Sequence[Signer] = ()
    revoked: Sequence[RevokedKey] = ()
    authorities: TrustedAuthorities = field(default_factory=TrustedAuthorities)


def read_trust(
    home: Path, *, allowed_signers: Path | None = None, tsa_certificates: Path | None = None
) -> Trust:
    """Read whom the reader trusts, from ``home`` or named files. ``revoked_keys`` lies beside the trusted keys."""
    signers = allowed_signers or home / SIGNERS_FILE
    return Trust(
        read_signers(signers),
        read_revoked(signers.parent / REVOKED_FILE),
        read_authorities(home, tsa_certificates),
    )


@dataclass(frozen=True)
class Moments:
    """What is known about the moment of a signature."""

    now: datetime
    proven: Stamp | None  # Time stamp that proves that the signature is not younger; None if there is none
    at: datetime | None  # Moment that the reader states; None if none
    earliest: datetime  # Begin of the period that the bench's own clock leaves
    latest: datetime  # Its end; for a seal both are its stated time

    @property
    def own_text(self) -> str:
        """Why a key that has expired is accepted by the bench's own clock."""
        sealed = f"{_text(self.earliest)} by the bench's own clock only"
        if self.earliest == self.latest:
            return f"it is accepted because the folder was sealed before, at {sealed}"
        return f"it is accepted because the folder was sealed at {sealed}, and may have been authorised then"


@dataclass(frozen=True)
class Judgement:
    """What was found about a key, or about a signature with it."""

    principal: str | None = None  # Name of the signer; None if the key is rejected
    fault: str = ""  # Why it is rejected; empty if it is accepted
    remark: str = ""  # What a reader should know though it is accepted; empty if nothing
    unchecked: str = ""  # Why the signature could not be checked here; empty if it was
    fingerprint: str = ""  # That of the key; empty if the signature was not read


def judge_key(public_key: bytes, namespace: str, trust: Trust, moments: Moments) -> Judgement:
    """Decide whether a key could sign for a purpose at the moment at which it signed."""
    known = [signer for signer in trust.signers if signer.public_key == public_key]
    if not known:
        what = f"the key that signed is not in the list of trusted keys ({fingerprint(public_key)})"
        return Judgement(fault=what)
    for_it = [signer for signer in known if signer.may_sign(namespace)]
    if not for_it:
        return Judgement(fault=str(known[0].rejection(namespace, moments.now)))
    revoked = min(
        (revoked_key for revoked_key in trust.revoked if revoked_key.public_key == public_key),
        key=lambda revoked_key: revoked_key.since,
        default=None,
    )
    if revoked is not None and (moments.proven is None or moments.proven.utc >= revoked.since):
        proof = (
            "no trusted time stamp proves that the signature is older"
            if moments.proven is None
            else f"the time stamp is not older ({moments.proven.text})"
        )
        return Judgement(fault=f"the key was revoked {revoked.text}, and {proof}")
    judgement = _judge_period(for_it, namespace, moments)
    if revoked is None or moments.proven is None or judgement.fault:
        return judgement
    remark = f"the key was revoked {revoked.text}, but the signature existed before, at {moments.proven.text}"
    return Judgement(judgement.principal, remark=remark)


def _judge_period(known: Sequence[Signer], namespace: str, moments: Moments) -> Judgement:
    """Compare the period of validity with the moment, from the best source."""
    late = ""
    if moments.proven is not None:
        signer, reason = _accepting(known, namespace, moments.proven.utc)
        if signer is not None:
            return Judgement(signer.principal)
        if all(entry.valid_before is not None and entry.valid_before < moments.proven.utc for entry in known):
            late = " The time stamp is younger than that, so it proves nothing here."
        else:
            return Judgement(fault=f"{reason}; the signature existed at {moments.proven.text}")
    _, now_reason = _accepting(known, namespace, moments.now)
    if moments.at is not None:
        signer, reason = _accepting(known, namespace, moments.at)
        if signer is None:
            return Judgement(fault=f"{reason}; it was judged for {_text(moments.at)}")
        remark = (
            f"{now_reason}; it is accepted for {_text(moments.at)}, as asked.{late}" if now_reason else ""
        )
        return Judgement(signer.principal, remark=remark.rstrip("."))
    for entry in known:
        is_late = entry.valid_before is not None and moments.earliest > entry.valid_before
        is_early = entry.valid_after is not None and moments.latest < entry.valid_after
        if not is_late and not is_early:
            remark = f"{now_reason}; {moments.own_text}. No trusted time stamp proves it.{late}".rstrip(".")
            return Judgement(entry.principal, remark=remark if now_reason else "")
    _, reason = _accepting(known, namespace, moments.earliest)
    return Judgement(
        fault=f"{reason}; the folder was sealed at {_text(moments.earliest)} by the bench's own clock"
    )


def _accepting(known: Sequence[Signer], namespace: str, when: datetime) -> tuple[Signer | None, str]:
    """Return the line that accepts a moment, or None and the reason of the first line."""
    rejections = [signer.rejection(namespace, when) for signer in known]
    if None in rejections:
        return known[rejections.index(None)], ""
    return None, str(rejections[0])


def _text(moment: datetime) -> str:
    return f"{moment:%Y-%m-%d %H:%M} UTC"
