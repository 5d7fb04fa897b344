"""Every error of the script language; each says what is wrong, where, and what to do.

SequencesError
└── DocumentFaults        a sequence, station or other document that cannot be used; holds every fault
"""

from __future__ import annotations

from collections.abc import Iterable

from sequences.tree import Fault, Tree


class SequencesError(Exception):
    """What is wrong, where, and what to do about it."""

    def __init__(self, what: str, *, where: str = "", remedy: str = "") -> None:
        self.what = _one_stop(what)
        self.where = where
        self.remedy = remedy
        place = f"{where}: " if where else ""
        advice = f" {remedy}" if remedy else ""
        super().__init__(f"{place}{self.what}{advice}")


def _one_stop(text: str) -> str:
    """Return a text with one full stop at its end, where it has two because it ends with a quoted sentence."""
    return text[:-1] if text.endswith("..") and not text.endswith("...") else text


class DocumentFaults(SequencesError):
    """A document that cannot be used, with every fault in it, in the order of their places.

    The message has one line for each fault. Of a single fault, ``what`` is its message and ``where`` its place; of
    several, ``what`` holds all lines, each with its own place. ``remedy`` is empty: each message says what to write.
    ``tree`` is the document as far as it could be read, for a caller with more to check.
    """

    def __init__(self, faults: Iterable[Fault], tree: Tree | None = None) -> None:
        self.faults = sorted(set(faults))
        self.tree = tree
        if len(self.faults) == 1:
            super().__init__(self.faults[0].message, where=self.faults[0].where)
        else:
            super().__init__("\n".join(str(fault) for fault in self.faults))
