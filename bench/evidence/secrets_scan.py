"""Secrets in a folder that is about to be sealed: a seal is for ever, and a sealed folder is passed on.

Text files are searched as a whole, other files at their beginning. Besides the forms of `bench.base.secret_patterns`,
the values of the environment variables that the folder's station names (``password_env``, ``url_env``, ...) are
searched. No message contains a secret.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import BinaryIO
from urllib.parse import quote, urlsplit

from bench.base.errors import EvidenceError
from bench.base.secret_patterns import PATTERNS, SecretPattern
from bench.records.captures import CAPTURES
from bench.records.storage import storage_errors

_CHUNK_BYTES = 4 << 20
_OVERLAP_BYTES = 64 << 10
_HEADER_BYTES = 64 << 10
_MOST_TEXT_BYTES = 1 << 30
"""A text file is searched up to here; no journal of ten thousand poses is longer."""
_MOST_FINDINGS = 20
_LEAST_VALUE = 6
_VARIABLE = re.compile(rb"[A-Za-z0-9]_env[\"']?\s*:\s*[\"']?([A-Za-z_][A-Za-z0-9_]{0,99})")


@dataclass(frozen=True, order=True)
class Finding:
    """A place in a file that has the form of a secret."""

    file: str
    line: int  # Its line, from 1; 0 in a file that is not text
    kind: str

    def __str__(self) -> str:
        return f"{self.file}:{self.line}: {self.kind}" if self.line else f"{self.file}: {self.kind}"


def scan(path: Path, environ: Mapping[str, str] = os.environ) -> list[Finding]:
    """Search a folder for secrets.

    path: The folder. Links are not followed.
    Returns: By file and line, at most 20.
    Raises StorageError: When a file cannot be read.
    """
    found: set[Finding] = set()
    with storage_errors(path):
        patterns = (*PATTERNS, *_values_in_use(path, environ))
        for file in _files(path):
            name = file.relative_to(path).as_posix()
            with file.open("rb") as stream:
                found.update(_search(stream, name, patterns))
            if len(found) >= _MOST_FINDINGS:
                break
    return sorted(found)[:_MOST_FINDINGS]


def refuse_secrets(path: Path, environ: Mapping[str, str] = os.environ) -> None:
    """Refuse to seal a folder with secrets in it. Nothing in the folder is changed.

    Raises EvidenceError: When there is one; the message names the places, not the secrets.
    Raises StorageError: When a file cannot be read.
    """
    found = scan(path, environ)
    if not found:
        return
    places = "; ".join(map(str, found))
    raise EvidenceError(
        f"The folder is not sealed, because it contains secrets that everybody who gets it could use: {places}.",
        where=str(path),
        remedy="Nothing is lost. Make each of them worthless first (change the password, withdraw the key or token),"
        " because it is in a file. Then seal a run with `starbench resume RUN --secrets-revoked`; make any other"
        " folder again without the secret.",
    )


def _files(path: Path) -> Iterator[Path]:
    for folder_name, folders, names in os.walk(path):
        folders.sort()
        for name in sorted(names):
            file = Path(folder_name) / name
            if file.is_file() and not file.is_symlink():
                yield file


def _search(stream: BinaryIO, name: str, patterns: tuple[SecretPattern, ...]) -> Iterator[Finding]:
    """Search one file: a text as a whole, another file at its beginning."""
    header = stream.read(_HEADER_BYTES)
    if name.startswith(f"{CAPTURES}/") or b"\0" in header:
        for secret in _matches(header, patterns):
            yield Finding(name, 0, secret[1])
        return
    stream.seek(0)
    line, read, kept = 1, 0, b""
    while read < _MOST_TEXT_BYTES and (chunk := stream.read(_CHUNK_BYTES)):
        read += len(chunk)
        data = kept + chunk
        for begin, kind in islice(_matches(data, patterns), _MOST_FINDINGS):
            yield Finding(name, line + data.count(b"\n", 0, begin), kind)
        kept = data[-_OVERLAP_BYTES:]
        line += data.count(b"\n", 0, len(data) - len(kept))


def _matches(data: bytes, patterns: tuple[SecretPattern, ...]) -> Iterator[tuple[int, str]]:
    for pattern in patterns:
        for begin in pattern.places(data):
            yield begin, pattern.kind


def _values_in_use(path: Path, environ: Mapping[str, str]) -> Iterator[SecretPattern]:
    """Return patterns for the values of the environment variables that the YAML files of a folder name."""
    names: set[str] = set()
    for file in sorted(path.glob("*.yaml")):
        if file.is_file() and not file.is_symlink():
            with file.open("rb") as stream:
                names |= {name.decode() for name in _VARIABLE.findall(stream.read(_CHUNK_BYTES))}
    for name in sorted(names):
        for value in _forms(environ.get(name, "")):
            data = value.encode(errors="surrogateescape")
            regex = re.compile(rb"(?<![A-Za-z0-9_])" + re.escape(data) + rb"(?![A-Za-z0-9_])")
            yield SecretPattern(data, regex, f"the value of the environment variable {name}")


def _forms(value: str) -> set[str]:
    """Return a value as a file may hold it: as it is, within JSON, within a URL; of a URL, also its password."""
    parts = {value}
    try:
        password = urlsplit(value).password
    except ValueError:
        password = None
    if password:
        parts.add(password)
    forms = {form for part in parts for form in (part, json.dumps(part)[1:-1], quote(part, safe=""))}
    return {form for form in forms if len(form) >= _LEAST_VALUE}
