"""What can be wrong with a YAML document: faults, each at its place, all of them together.

SequencesError
└── DocumentFaults        a sequence, station or other document that cannot be used; holds every fault
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sequences.yaml_text import Tree


@dataclass(frozen=True, order=True)
class Fault:
    """One thing wrong at one place.

    Attributes
    ----------
    file
        The file, as its reader was given it.
    line, column
        From 1, counted in characters; 0 where the fault has no place inside the file.
    path
        Keys and indices from the top, as in ``steps[2].record.window_ms``; empty for the whole document.
    message
        What is wrong and, where it can be told, what to write instead.

    Examples
    --------
    >>> print(Fault("a.yaml", 4, 13, "run.light_hz", "not a number (got 'sixty')"))
    a.yaml:4:13: run.light_hz: not a number (got 'sixty')
    >>> print(Fault("b.yaml", 0, 0, "", "there is no such file."))
    b.yaml: there is no such file.
    """

    file: str
    line: int
    column: int
    path: str
    message: str

    def __str__(self) -> str:
        """``file:line:column: path: message``, without the parts that are not known."""
        place = f"{self.file}:{self.line}:{self.column}" if self.line else self.file
        return f"{place}: {self.path}: {self.message}" if self.path else f"{place}: {self.message}"


class SequencesError(Exception):
    """Whatever this folder raises."""


class DocumentFaults(SequencesError):
    """A document that cannot be used.

    Parameters
    ----------
    faults
        Every fault found, at least one; kept in the order of their places.
    tree
        The document as far as it could be read, for a caller with more to check; None where there is none.
    """

    def __init__(self, faults: Iterable[Fault], tree: Tree | None = None) -> None:
        self.faults = sorted(set(faults))
        self.tree = tree
        super().__init__("\n".join(str(fault) for fault in self.faults))
