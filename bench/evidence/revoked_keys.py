"""The list of revoked keys, ``revoked_keys``: keys that were stolen or lost.

The format is a plain list of public keys, which ``ssh-keygen -Y verify -r revoked_keys`` reads (ssh-
keygen(1), ``-Y verify``). A binary list (KRL) cannot hold a date and a reason; here both stand behind the
key. A revoked key's signatures are refused unless a trusted time stamp proves that they are older than
the revocation: whoever has a stolen key can write any date into a report. A key that is only replaced is
not revoked; its line in ``allowed_signers`` ends (`bench.evidence.keys`).
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from bench.base.errors import EvidenceError
from bench.evidence.private_files import read_list
from bench.evidence.signers import add_line, parse_time, read_lines, read_public_key, time_text
from bench.evidence.ssh_keys import fingerprint, key_text
from bench.record.storage import storage_errors

REVOKED_FILE = "revoked_keys"
_MARK = "revoked"
_EVER = datetime(1970, 1, 1, tzinfo=UTC)


@dataclass(frozen=True)
class RevokedKey:
    """A key that is no longer trusted."""

    public_key: bytes
    since: datetime = _EVER  # Moment from which its signatures are refused; 1970 for a line without a date
    reason: str = ""  # Why; empty for a line without a reason

    @property
    def text(self) -> str:
        """Date and reason, for a message."""
        date = f"{self.since:%Y-%m-%d %H:%M} UTC" if self.since > _EVER else "without a date"
        return f"{date} ({self.reason})" if self.reason else date

    @property
    def line(self) -> str:
        """The line of ``revoked_keys`` for this key."""
        return f"{key_text(self.public_key)} {_MARK} {time_text(self.since)} {self.reason}".rstrip()


def read_revoked(path: Path) -> list[RevokedKey]:
    """Read the revoked keys, in the order of the lines (no file: none); the error names a line that is none."""
    if not path.exists():
        return []
    with storage_errors(path):
        text = read_list(path, "the list of revoked keys")
    return read_lines(path, text, _read_revoked)


def revoke(folder: Path, key: RevokedKey) -> None:
    """Add a key to the list of revoked keys, with a reason of one line."""
    path = folder / REVOKED_FILE
    if not key.reason.strip() or not key.reason.isprintable():
        raise EvidenceError(
            "A revocation needs a reason of one line.",
            remedy="Say what happened, for example: stolen laptop.",
        )
    known = next((revoked for revoked in read_revoked(path) if revoked.public_key == key.public_key), None)
    if known is not None:
        raise EvidenceError(
            f"The key {fingerprint(key.public_key)} is revoked already: {known.text}.", where=str(path)
        )
    with storage_errors(path):
        present = path.read_text(encoding="utf-8") if path.exists() else ""
    add_line(path, present, key.line)


def _read_revoked(line: str) -> RevokedKey:
    """Read one line of ``revoked_keys``."""
    try:
        public_key = read_public_key(line)
        comment = line.split(maxsplit=2)[2:]
        mark, _, rest = comment[0].strip().partition(" ") if comment else ("", "", "")
        if mark != _MARK:
            return RevokedKey(public_key)
        date, _, reason = rest.partition(" ")
        return RevokedKey(public_key, parse_time(date), reason)
    except ValueError as error:
        raise EvidenceError(
            f"This is not a line of a revoked key: {error}.",
            remedy="Expected form: ssh-ed25519 AAAA... revoked YYYYMMDDHHMMSSZ reason",
        ) from error
