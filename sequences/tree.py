"""A YAML document as it was read: values as text, the place of each value, and the faults found on the way."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

DocumentPath = tuple[str | int, ...]
"""Keys and list indices from the top of a document."""


class Spot(NamedTuple):
    """A place in a file."""

    line: int  # From 1
    column: int  # From 1, in characters, not bytes


@dataclass(frozen=True, order=True)
class Fault:
    """One fault at one place of a document.

    >>> print(Fault("a.yaml", 4, 13, "run.light_hz", "not a number (got 'sixty')"))
    a.yaml:4:13: run.light_hz: not a number (got 'sixty')
    >>> print(Fault("b.yaml", 0, 0, "", "there is no such file."))
    b.yaml: there is no such file.
    """

    file: str
    line: int  # From 1; 0 if the fault has no place inside the file
    column: int  # From 1, in characters; 0 likewise
    # Keys and indices from the top, for example ``steps[2].record.window_ms``; empty for the whole document.
    path: str
    message: str  # What is wrong and, if the reader can know it, what to write instead

    @property
    def where(self) -> str:
        """``file:line:column: path``, without the parts that are unknown."""
        place = f"{self.file}:{self.line}:{self.column}" if self.line else self.file
        return f"{place}: {self.path}" if self.path else place

    def __str__(self) -> str:
        """``file:line:column: path: message``, without the parts that are unknown."""
        return f"{self.where}: {self.message}"


@dataclass
class Tree:
    """The values of a document as text, with their places."""

    file: str  # The file's name, for faults
    value: Any = None  # Nested dicts, lists, str and None
    # False if the reader stopped before the end of the document: a missing key may then stand in the part not
    # read.
    complete: bool = False
    values: dict[DocumentPath, Spot] = field(default_factory=dict)  # Where each value begins
    keys: dict[DocumentPath, Spot] = field(default_factory=dict)  # Where each key of a mapping begins
    faults: list[Fault] = field(default_factory=list)  # What the reader refused; ``value`` holds the rest

    def spot(self, path: DocumentPath) -> Spot:
        """Return where the value at a path begins, or the nearest value around it if the document has no such path."""
        while path and path not in self.values:
            path = path[:-1]
        return self.values.get(path, Spot(1, 1))

    def add_fault(self, spot: Spot, path: DocumentPath, message: str) -> None:
        """Add a fault to ``faults``: the spot is in the file, the path in the document."""
        self.faults.append(Fault(self.file, spot.line, spot.column, path_text(path), message))


def path_text(path: DocumentPath) -> str:
    """Write a path as text: keys joined by dots, indices in brackets; empty for the top of the document.

    >>> path_text(("steps", 2, "record", "window_ms"))
    'steps[2].record.window_ms'
    """
    parts = (f"[{part}]" if isinstance(part, int) else f".{part}" for part in path)
    return "".join(parts).removeprefix(".")
