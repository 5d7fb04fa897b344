"""Where a step's setting stands in a sequence file."""

from __future__ import annotations

from sequences.reader import Located
from sequences.schema import Sequence
from sequences.tree import DocumentPath


def setting_path(document: Located[Sequence], path: DocumentPath, key: str, word: str) -> DocumentPath:
    """Return the path of a step's setting in the file."""
    places = ((*path, key), ("defaults", word, key))
    return next((place for place in places if place in document.tree.values), path)
