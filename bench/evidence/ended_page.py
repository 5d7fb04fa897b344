"""Checks the signed page of a run that failed or was aborted: its signature, the key, and the journal it names."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path

from bench.base.errors import BenchError, EvidenceError
from bench.evidence.findings import SealFault
from bench.evidence.key_trust import Moments, Trust, judge_key
from bench.evidence.seal import read_beside
from bench.evidence.signers import NAMESPACE
from bench.evidence.sshsig import fingerprint, is_valid, read_signature
from bench.records.journal import read_journal
from bench.records.run_folder import JOURNAL, PAGE_SIGNATURE, REPORT


def check_ended_page(
    folder: Path, trust: Trust, now: datetime, stated: datetime
) -> tuple[list[SealFault], list[str]]:
    """Check the page that stands in a folder without a seal.

    Returns: What does not hold, and what does: a sentence without a full stop. Both are empty without a page.
    """
    try:
        armoured = read_beside(folder, PAGE_SIGNATURE)
        if armoured is None:
            return [], []
        signature = read_signature(armoured)
        page = (folder / REPORT).read_bytes() if (folder / REPORT).is_file() else b""
        holds = signature.namespace == NAMESPACE and is_valid(signature, page)
    except EvidenceError as error:
        return [SealFault("signature", PAGE_SIGNATURE, error.what)], []
    judged = judge_key(signature.public_key, NAMESPACE, trust, Moments(now, None, None, stated, stated))
    if not holds:
        fault = SealFault("signature", PAGE_SIGNATURE, f"the signature does not match this {REPORT}")
    elif judged.fault:
        fault = SealFault("key", PAGE_SIGNATURE, judged.fault)
    elif why := _of_another_journal(folder, page):
        fault = SealFault("journal", JOURNAL, why)
    else:
        signer = f"{judged.principal} ({fingerprint(signature.public_key)})"
        return [], [
            f"{REPORT} is the page of a run that did not finish, signed by {signer}; its journal is whole"
        ]
    return [fault], []


def _of_another_journal(folder: Path, page: bytes) -> str:
    """Return why the page is not that of the folder's journal; empty if it names its last line."""
    try:
        head = read_journal(folder / JOURNAL)[0][-1].hash
    except (BenchError, IndexError) as error:
        return f"it cannot be compared with {REPORT}: {error}"
    return "" if head.encode() in page else f"its last line is not the one that {REPORT} names"
