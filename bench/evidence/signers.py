"""The list of trusted keys, ``allowed_signers``, in OpenSSH's format (ssh-keygen(1), ALLOWED SIGNERS).

A line names signer, purposes, period and key. One key never both seals (``starbench-report@v1``) and authorises
(``starbench-authorisation@v1``).
"""

from __future__ import annotations

import base64
import binascii
import os
import re
import stat
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TypeVar

from bench.base.errors import EvidenceError
from bench.evidence.sshsig import KEY_TYPES, check_key, fingerprint, key_text, key_type_of
from bench.record.storage import make_folder, storage_errors, write_atomic

# Refuse files on which the trust rests if other users can read or write them.
#
# The rule is that of OpenSSH (sshd_config(5), ``StrictModes``): neither the group nor others may write the
# file or its folder. A folder with the sticky bit is safe, because nobody can replace the files of another
# user in it.

Line = TypeVar("Line")
_WRITABLE_BY_OTHERS = 0o022
_MOST_BYTES = 16 << 20
_ANY_ACCESS_BY_OTHERS = 0o077


def refuse_writable_by_others(path: Path, what: str) -> None:
    """Refuse a file, or a folder, that group or others can change or replace."""
    if not hasattr(os, "getuid"):  # Windows has no such modes
        return
    real = path.resolve()
    for place in (real, real.parent):
        mode = place.stat().st_mode
        is_sticky_folder = stat.S_ISDIR(mode) and mode & stat.S_ISVTX
        if mode & _WRITABLE_BY_OTHERS and not is_sticky_folder:
            thing = what if place == real else f"the folder of {what}"
            raise EvidenceError(
                f"Other users can change {thing} (mode {stat.S_IMODE(mode):04o}), so it proves nothing.",
                where=str(place),
                remedy=f"If nobody has changed it: chmod go-w '{place}'. Otherwise get it again.",
            )


def read_list(path: Path, what: str) -> str:
    """Read a list on which the trust rests: text of at most 16 MB that other users cannot change."""
    refuse_writable_by_others(path, what)
    if not path.is_file():  # a pipe would never answer
        raise EvidenceError(
            f"{what[0].upper()}{what[1:]} is not a file.",
            where=str(path),
            remedy="Copy it into a file, and name that.",
        )
    with path.open("rb") as stream:
        data = stream.read(_MOST_BYTES + 1)
    try:
        text = data.decode("utf-8")
        if len(data) <= _MOST_BYTES:
            return text
        why = f"it has more than {_MOST_BYTES >> 20} MB"
    except UnicodeDecodeError:
        why = "it is not text"
    raise EvidenceError(
        f"{what[0].upper()}{what[1:]} cannot be read: {why}.",
        where=str(path),
        remedy="Expected is one key a line, in OpenSSH's format; a binary list (KRL) is not supported.",
    )


def refuse_readable_by_others(path: Path) -> None:
    """Refuse a private key that other users can read, or own."""
    if not hasattr(os, "getuid"):
        return
    status = path.stat()
    if status.st_mode & _ANY_ACCESS_BY_OTHERS or status.st_uid != os.getuid():
        raise EvidenceError(
            f"Other users can read the key (mode {stat.S_IMODE(status.st_mode):04o}): its signatures prove nothing.",
            where=str(path),
            remedy=f"If nobody has read it: chmod 600 '{path}'. Otherwise make a new key.",
        )


NAMESPACE = "starbench-report@v1"
"""Purpose of a bench's signature, the seal: the namespace of SSHSIG."""
AUTHORISATION_NAMESPACE = "starbench-authorisation@v1"
"""Purpose of the signature by which a person authorises a sealed folder."""
SIGNERS_FILE = "allowed_signers"
PRINCIPAL = re.compile(r"[A-Za-z0-9._+-]{1,64}@[A-Za-z0-9._-]{1,128}")

_FIELD = re.compile(r'(?:[^\s"]|"[^"]*")+')
_OPTION = re.compile(r'([a-z-]+)(?:="([^"]*)")?(?:,|$)')
_OPTIONS = {"namespaces", "valid-after", "valid-before"}
_TYPES = {key_type.decode() for key_type in KEY_TYPES}


@dataclass(frozen=True)
class Signer:
    """A trusted key: one line of ``allowed_signers``."""

    principal: str  # Name of the signer, as ``name@place``
    public_key: bytes  # The key as SSH encodes it (the part in base64 after the type)
    # Patterns of the purposes that it may sign for; empty if it may sign for all.
    namespaces: tuple[str, ...] = ()
    # valid_after, valid_before: Period in which it may sign; None where there is no limit.
    valid_after: datetime | None = None
    valid_before: datetime | None = None

    @property
    def line(self) -> str:
        """The line of ``allowed_signers`` for this key."""
        options = [f'namespaces="{",".join(self.namespaces)}"'] if self.namespaces else []
        for name, moment in (("valid-after", self.valid_after), ("valid-before", self.valid_before)):
            options += [f'{name}="{time_text(moment)}"'] if moment is not None else []
        return " ".join(filter(None, (self.principal, ",".join(options), key_text(self.public_key))))

    @property
    def is_bench(self) -> bool:
        """Whether the key is named as one that seals."""
        return bool(self.namespaces) and self.may_sign(NAMESPACE)

    def may_sign(self, namespace: str) -> bool:
        """Return whether a pattern of the key's purposes matches, and none with ``!`` (ssh_config(5), PATTERNS)."""
        if not self.namespaces:
            return True
        matching = [pattern for pattern in self.namespaces if _matches(pattern.removeprefix("!"), namespace)]
        return bool(matching) and not any(pattern.startswith("!") for pattern in matching)

    def rejection(self, namespace: str, when: datetime) -> str | None:
        """Return why a signature of this key at a moment is rejected; None if the key may sign."""
        if not self.may_sign(namespace):
            return f"the key is trusted for {', '.join(self.namespaces)}, not for {namespace}"
        if self.valid_after is not None and when < self.valid_after:
            return f"the key is not valid before {self.valid_after:%Y-%m-%d %H:%M} UTC"
        if self.valid_before is not None and when > self.valid_before:
            return f"the key expired {self.valid_before:%Y-%m-%d %H:%M} UTC"
        return None


def read_signers(path: Path) -> list[Signer]:
    """Read a list of trusted keys, in the order of the lines; the error names a line that is not understood."""
    try:
        text = read_list(path, "the list of trusted keys")
    except OSError as error:
        raise EvidenceError(
            f"The list of trusted keys cannot be read: {error.strerror}.",
            where=str(path),
            remedy="Get the file allowed_signers from the laboratory, and name it.",
        ) from error
    return _read_lines(path, text, read_signer)


def signers_of(folder: Path) -> list[Signer]:
    """Return the trusted keys of a configuration folder; none if it has no list."""
    path = folder / SIGNERS_FILE
    return read_signers(path) if path.exists() else []


def _read_lines(path: Path, text: str, read: Callable[[str], Line]) -> list[Line]:
    """Read each line with a key; the error names the line."""
    found = []
    for number, line in _lines_of_keys(text):
        try:
            found.append(read(line))
        except EvidenceError as error:
            raise EvidenceError(error.what, where=f"{path}:{number}", remedy=error.remedy) from error
    return found


def _lines_of_keys(text: str) -> Iterator[tuple[int, str]]:
    """Yield each line with a key and its number from 1: not those that are empty or a comment."""
    for number, line in enumerate(text.splitlines(), start=1):
        if line.strip() and not line.lstrip().startswith("#"):
            yield number, line


def _add_line(path: Path, present: str, line: str) -> None:
    separator = "" if not present or present.endswith("\n") else "\n"
    make_private_folder(path.parent)
    write_atomic(path, f"{present}{separator}{line}\n".encode())


def read_signer(line: str) -> Signer:
    """Read one line of ``allowed_signers``; its key must be of a known type."""
    fields = _FIELD.findall(line.strip())
    options_text = fields[1] if len(fields) > 1 and fields[1] not in _TYPES else ""
    key_fields = fields[2:4] if options_text else fields[1:3]
    options = dict(_OPTION.findall(options_text))
    try:
        _refuse_unknown(options, options_text, fields)
        public_key = read_public_key(" ".join(key_fields))
        after, before = (
            parse_time(options[name]) if name in options else None for name in ("valid-after", "valid-before")
        )
    except ValueError as error:
        raise EvidenceError(
            f"This is not a line of a trusted key: {error}.",
            remedy='Expected form: name@place namespaces="' + NAMESPACE + '" ssh-ed25519 AAAA...',
        ) from error
    namespaces = tuple(filter(None, options.get("namespaces", "").split(",")))
    return Signer(fields[0], public_key, namespaces, after, before)


def _refuse_unknown(options: Mapping[str, str], text: str, fields: Sequence[str]) -> None:
    if set(options) - _OPTIONS or _OPTION.sub("", text):
        raise ValueError("it has an unknown option")
    if not all(map(str.isprintable, fields[:2])):
        raise ValueError("it has characters that cannot be printed")


def read_public_key(text: str) -> bytes:
    """Read a public key of a known type as OpenSSH writes it: type, base64, and a comment that is not used."""
    key_type, _, rest = text.strip().partition(" ")
    if key_type not in _TYPES or not rest.split():
        raise ValueError("it has no public key of a known type")
    try:
        blob = base64.b64decode(rest.split()[0], validate=True)
    except binascii.Error as error:
        raise ValueError("the key is not base64") from error
    if key_type_of(blob) != key_type:
        raise ValueError("the key is not of the type that its line names")
    check_key(blob)
    return blob


def trust(folder: Path, line: str) -> Signer:
    """Add a line to ``allowed_signers``, once; a key that is trusted for the other purpose already is refused."""
    signer = read_signer(line)
    path = folder / SIGNERS_FILE
    present = _read_list(path)
    _refuse_two_purposes(folder, signer)
    if line.strip() not in present.splitlines():
        _add_line(path, present, line.strip())
    return signer


def replace_lines(folder: Path, public_key: bytes, valid_before: datetime, added: Sequence[str]) -> None:
    """Put ``valid-before`` on the lines of a key that do not end earlier, and add lines, in one step."""
    path = folder / SIGNERS_FILE
    signers = signers_of(folder)
    present = _read_list(path)
    lines = present.splitlines()
    for (number, _), signer in zip(_lines_of_keys(present), signers, strict=True):
        if signer.public_key == public_key:
            before = min(filter(None, (signer.valid_before, valid_before)))
            lines[number - 1] = replace(signer, valid_before=before).line
    make_private_folder(folder)
    write_atomic(path, "".join(f"{line}\n" for line in (*lines, *added)).encode())


def make_private_folder(folder: Path) -> None:
    """Make the configuration folder, which other users cannot change. A folder that exists is left as it is."""
    if not folder.exists():
        make_folder(folder)
        with storage_errors(folder):
            folder.chmod(0o700)


def _read_list(path: Path) -> str:
    with storage_errors(path):
        if not path.exists():
            return ""
        return read_list(path, "the list of trusted keys")


def _refuse_two_purposes(folder: Path, signer: Signer) -> None:
    """Refuse a key that would both seal and authorise: a bench must not be able to authorise its own work."""
    signs = {NAMESPACE, AUTHORISATION_NAMESPACE}
    known = [one for one in signers_of(folder) if one.public_key == signer.public_key]
    for one in (*known, signer):
        if one.namespaces and signer.namespaces:
            purposes = {name for name in signs for each in (one, signer) if each.may_sign(name)}
            if purposes == signs:
                raise EvidenceError(
                    f"The key {fingerprint(signer.public_key)} cannot both seal and authorise.",
                    where=str(folder / SIGNERS_FILE),
                    remedy="Use a key of the person's own, which no bench has: ssh-keygen -t ed25519.",
                )


def parse_time(text: str) -> datetime:
    """Read a time of ssh-keygen(1): ``YYYYMMDD[HHMM[SS]][Z]``, which is local time without the Z."""
    digits = text.removesuffix("Z")
    form = {8: "%Y%m%d", 12: "%Y%m%d%H%M", 14: "%Y%m%d%H%M%S"}.get(
        len(digits) if digits.isdecimal() and digits.isascii() else 0
    )
    if form is None:
        raise ValueError(f"{text!r} is not a time of the form YYYYMMDDHHMMSSZ")
    moment = datetime.strptime(digits, form)  # noqa: DTZ007 - the zone follows from the Z
    try:
        return moment.replace(tzinfo=UTC) if text.endswith("Z") else moment.astimezone(UTC)
    except OverflowError as error:
        raise ValueError(f"{text!r} is too early or too late") from error


def time_text(moment: datetime) -> str:
    """Write a time as ssh-keygen(1) reads it: ``YYYYMMDDHHMMSSZ``."""
    return f"{moment.astimezone(UTC):%Y%m%d%H%M%SZ}"


def _matches(pattern: str, text: str) -> bool:
    """Compare with ``*`` and ``?`` as ssh does (ssh_config(5), PATTERNS)."""
    translated = re.escape(pattern).replace(r"\*", ".*").replace(r"\?", ".")
    return re.fullmatch(translated, text) is not None


# The list of revoked keys, ``revoked_keys``: keys that were stolen or lost.
#
# The format is a plain list of public keys, which ``ssh-keygen -Y verify -r revoked_keys`` reads (ssh-
# keygen(1), ``-Y verify``). A binary list (KRL) cannot hold a date and a reason; here both stand behind the
# key. A revoked key's signatures are refused unless a trusted time stamp proves that they are older than
# the revocation: whoever has a stolen key can write any date into a report. A key that is only replaced is
# not revoked; its line in ``allowed_signers`` ends (`bench.evidence.keys`).

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
    return _read_lines(path, text, _read_revoked)


def revoke(folder: Path, key: RevokedKey) -> None:
    """Add a key to the list of revoked keys, with a reason of one line."""
    path = folder / REVOKED_FILE
    if not key.reason.strip() or not key.reason.isprintable():
        raise EvidenceError(
            "A revocation needs a reason of one line.",
            remedy="Say what happened, for example: stolen laptop.",
        )
    known = next((one for one in read_revoked(path) if one.public_key == key.public_key), None)
    if known is not None:
        raise EvidenceError(
            f"The key {fingerprint(key.public_key)} is revoked already: {known.text}.", where=str(path)
        )
    with storage_errors(path):
        present = path.read_text(encoding="utf-8") if path.exists() else ""
    _add_line(path, present, key.line)


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
