"""The list of trusted keys, ``allowed_signers``, in OpenSSH's format (ssh-keygen(1), ALLOWED SIGNERS).

A line names signer, purposes, period and key. One key never both seals (``starbench-report@v1``) and authorises
(``starbench-authorisation@v1``).
"""

from __future__ import annotations

import base64
import binascii
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

from bench.base.errors import EvidenceError
from bench.evidence.private_files import Line, read_list
from bench.evidence.ssh_keys import KEY_TYPES, check_key, fingerprint, key_text, key_type_of
from bench.record.storage import make_folder, storage_errors, write_atomic

NAMESPACE = "starbench-report@v1"
"""Purpose of a bench's signature, the seal: the namespace of SSHSIG."""
AUTHORISATION_NAMESPACE = "starbench-authorisation@v1"
"""Purpose of the signature by which a person authorises a sealed folder."""
SIGNERS_FILE = "allowed_signers"
PRINCIPAL = re.compile(r"[A-Za-z0-9._+-]{1,64}@[A-Za-z0-9._-]{1,128}")

_OPTION = re.compile(r'(namespaces|valid-after|valid-before)="([^"]+)"')
_LINE = re.compile(  # What OpenSSH reads as this does, and no more: no signer that is excepted, no quotes around one
    rf'[ \t]*(?P<signer>[^\s"!]+)[ \t]+(?:(?P<options>{_OPTION.pattern}(?:,{_OPTION.pattern})*)[ \t]+)?'
    r'(?P<key>[a-z][^\s"=]*[ \t]+[A-Za-z0-9+/=]+)(?:[ \t].*)?'
)
_TYPES = {key_type.decode() for key_type in KEY_TYPES}


@dataclass(frozen=True)
class Signer:
    """A trusted key: one line of ``allowed_signers``."""

    principal: str  # Name of the signer, as ``name@place``
    public_key: bytes  # The key as SSH encodes it (the part in base64 after the type)
    # Patterns of the purposes that it may sign for; empty if it may sign for all.
    namespaces: tuple[str, ...] = ()
    valid_after: datetime | None = None  # Begin of the period in which it may sign; None: no limit
    valid_before: datetime | None = None  # Its end; None: no limit

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
            remedy="Get the file allowed_signers from the laboratory, and name it with --allowed-signers.",
        ) from error
    return read_lines(path, text, read_signer)


def signers_of(folder: Path) -> list[Signer]:
    """Return the trusted keys of a configuration folder; none if it has no list."""
    path = folder / SIGNERS_FILE
    return read_signers(path) if path.exists() else []


def read_lines(path: Path, text: str, read: Callable[[str], Line]) -> list[Line]:
    """Read each line with a key; the error names the line."""
    lines = []
    for number, line in _lines_of_keys(text):
        try:
            lines.append(read(line))
        except EvidenceError as error:
            raise EvidenceError(error.what, where=f"{path}:{number}", remedy=error.remedy) from error
    return lines


def _lines_of_keys(text: str) -> Iterator[tuple[int, str]]:
    """Yield each line with a key and its number from 1: not those that are empty or a comment."""
    for number, line in enumerate(text.split("\n"), start=1):
        if line.strip() and not line.lstrip().startswith("#"):
            yield number, line


def add_line(path: Path, present: str, line: str) -> None:
    """Write a list of keys again, with one line more."""
    separator = "" if not present or present.endswith("\n") else "\n"
    make_private_folder(path.parent)
    write_atomic(path, f"{present}{separator}{line}\n".encode())


def read_signer(line: str) -> Signer:
    """Read one line of ``allowed_signers``; its key must be of a known type."""
    try:
        signer, options, key = _fields(line)
        public_key = read_public_key(key)
        after, before = (
            parse_time(options[name]) if name in options else None for name in ("valid-after", "valid-before")
        )
    except ValueError as error:
        raise EvidenceError(
            f"This is not a line of a trusted key: {error}.",
            remedy='Expected form: name@place namespaces="' + NAMESPACE + '" ssh-ed25519 AAAA...',
        ) from error
    namespaces = tuple(options["namespaces"].split(",")) if "namespaces" in options else ()
    return Signer(signer, public_key, namespaces, after, before)


def _fields(line: str) -> tuple[str, dict[str, str], str]:
    """Return signer, options and key of a line."""
    if (parts := _LINE.fullmatch(line.rstrip(" \t\r\n"))) is None:
        raise ValueError("ssh-keygen refuses it, or reads it otherwise")
    pairs = _OPTION.findall(parts["options"] or "")
    if len(dict(pairs)) < len(pairs):
        raise ValueError("it has an option twice")
    if any(value.rstrip("Z") <= "19700101000000" for name, value in pairs if name != "namespaces"):
        raise ValueError("it has a time before 1970, which ssh-keygen refuses")
    if not f"{parts['signer']}{parts['options']}".isprintable():
        raise ValueError("it has characters that cannot be printed")
    return parts["signer"], dict(pairs), " ".join(parts["key"].split())


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
    if line.strip() not in present.split("\n"):
        add_line(path, present, line.strip())
    return signer


def replace_lines(folder: Path, public_key: bytes, valid_before: datetime, added: Sequence[str]) -> None:
    """Put ``valid-before`` on the lines of a key that do not end earlier, and add lines, in one step."""
    path = folder / SIGNERS_FILE
    signers = signers_of(folder)
    present = _read_list(path)
    lines = present.removesuffix("\n").split("\n") if present else []
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
    known = [each_signer for each_signer in signers_of(folder) if each_signer.public_key == signer.public_key]
    for each_signer in (*known, signer):
        if each_signer.namespaces and signer.namespaces:
            purposes = {name for name in signs for each in (each_signer, signer) if each.may_sign(name)}
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
