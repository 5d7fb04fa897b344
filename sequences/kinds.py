"""The kinds of document that Starbench reads, in words, and which command takes each."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

_HEAD_BYTES = 4096
"""A document states its format in its first lines."""
_FORMAT = re.compile(rb"""^["']?format["']?[ \t]*:[ \t]*["']?(starbench/[a-z-]+/\d+)""", re.MULTILINE)
_KIND = re.compile(r"starbench/([a-z-]+)/\d+")


@dataclass(frozen=True)
class DocumentKind:
    """One kind of document."""

    words: str  # What it is, with its article
    use: str = ""  # Where such a file is named, a sentence; empty where no command takes it by itself


STATION = DocumentKind("a station file", "Name a station file with --station.")
QUEUE = DocumentKind("a queue", "`starbench batch`, `plan` and `rehearse` take a queue.")
_KINDS = {
    "sequence": DocumentKind(
        "a sequence", "`starbench run` and `starbench plan` take a sequence, with --station."
    ),
    "station": STATION,
    "queue": QUEUE,
    "job": DocumentKind("a job of a batch", "`starbench tell FOLDER add` takes a job."),
    "lab": DocumentKind(
        "a description of a laboratory (lab.yaml)", "`starbench certificate issue` takes it with --config."
    ),
    "stage-protocol": DocumentKind("a description of a stage", "A station file names it."),
    "light-protocol": DocumentKind("a description of a light", "A station file names it."),
}


def kind_of_format(stated: object) -> DocumentKind | None:
    """Return the kind that the value of ``format`` names; None for one that is not known.

    >>> kind_of_format("starbench/queue/1").words
    'a queue'
    """
    named = _KIND.fullmatch(stated) if isinstance(stated, str) else None
    return _KINDS.get(named[1]) if named else None


def kind_of_file(path: Path) -> DocumentKind | None:
    """Return the kind that a file says it is, valid or not; None for any other file, and for one that is not read."""
    try:
        if not path.is_file():  # a pipe would never answer
            return None
        with path.open("rb") as stream:
            stated = _FORMAT.search(stream.read(_HEAD_BYTES))
    except (OSError, ValueError):  # ValueError: a NUL in the name
        return None
    return kind_of_format(stated[1].decode()) if stated else None
