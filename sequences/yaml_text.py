"""Strict YAML text: mappings, lists and plain text, every one with its place, and nothing clever.

Knows the part of YAML our documents may use. All scalars stay text (``serial: 00051234`` is no number, ``no``
is not false); only an empty value, ``~`` and ``null`` mean "nothing". Duplicate keys, anchors, aliases, tags,
directives, several documents and bottomless or bloated ones are refused. Knows no schema and opens no file.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import yaml

from sequences.errors import Fault

MOST_BYTES = 1_000_000
MOST_NODES = 20_000
MOST_DEPTH = 40

DocumentPath = tuple[str | int, ...]
"""Keys and list indices from the top of a document."""


class Spot(NamedTuple):
    """A place in a file, from 1; columns count characters."""

    line: int
    column: int


@dataclass
class Tree:
    """A document's values as text, with their places.

    Attributes
    ----------
    value
        Nested dicts, lists, str and None.
    values, keys
        Where each value, and each key of a mapping, begins.
    complete
        False where reading broke off, so that what is missing may just not have been reached.
    faults
        What was refused; the value then holds the rest.
    """

    file: str
    value: Any = None
    complete: bool = False
    values: dict[DocumentPath, Spot] = field(default_factory=dict)
    keys: dict[DocumentPath, Spot] = field(default_factory=dict)
    faults: list[Fault] = field(default_factory=list)

    def spot(self, path: DocumentPath) -> Spot:
        """Where the value at a path begins; for what is not written, the nearest thing around it."""
        while path and path not in self.values:
            path = path[:-1]
        return self.values.get(path, Spot(1, 1))

    def add_fault(self, spot: Spot, path: DocumentPath, message: str) -> None:
        """Note what is wrong at a place."""
        self.faults.append(Fault(self.file, spot.line, spot.column, path_text(path), message))


class _Refused(Exception):
    """Reading on makes no sense; the fault is noted."""


def path_text(path: DocumentPath) -> str:
    """Write a path as people do.

    Examples
    --------
    >>> path_text(("steps", 2, "record", "window_ms"))
    'steps[2].record.window_ms'
    """
    parts = (f"[{part}]" if isinstance(part, int) else f".{part}" for part in path)
    return "".join(parts).removeprefix(".")


def parse(data: bytes, file: str) -> Tree:
    """Read a document's bytes. Never raises: what is wrong stands in ``faults``.

    Parameters
    ----------
    data
        The file's content; UTF-8.
    file
        Its name, for the messages.
    """
    tree = Tree(file)
    with contextlib.suppress(_Refused):
        _Walk(_decoded(data, tree), tree).document()
        tree.complete = True
    return tree


def _decoded(data: bytes, tree: Tree) -> str:
    """Decode the text, if it is small enough and all of it is printable UTF-8."""
    if len(data) > MOST_BYTES:
        tree.faults.append(
            Fault(tree.file, 0, 0, "", f"larger than {MOST_BYTES} bytes: no file of this kind is.")
        )
        raise _Refused
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        before = data[: error.start].decode("utf-8", errors="replace")
        message = f"not UTF-8 text (byte 0x{data[error.start]:02x}): save the file as UTF-8."
        tree.add_fault(_end_of(before), (), message)
        raise _Refused from None
    strange = yaml.reader.Reader.NON_PRINTABLE.search(text)
    if strange:
        message = f"a character that is not text (U+{ord(strange.group()):04X})."
        tree.add_fault(_end_of(text[: strange.start()]), (), message)
        raise _Refused
    return text


def _end_of(text: str) -> Spot:
    return Spot(text.count("\n") + 1, len(text) - (text.rfind("\n") + 1) + 1)


@dataclass
class _Open:
    """A collection whose end has not come yet."""

    value: dict[str, Any] | list[Any]
    path: DocumentPath
    kept: bool = True  # a value under a refused key is read, and dropped
    key: str | None = None
    has_key: bool = False


class _Walk:
    """The parser's events taken one by one: no recursion, bounds before memory."""

    def __init__(self, text: str, tree: Tree) -> None:
        self.tree = tree
        self.loader: Any = yaml.SafeLoader(text)  # the pure one: libyaml's dies of deep nesting
        self.nodes = 0
        self.open: list[_Open] = []

    def document(self) -> None:
        """Read to the end of the first document, and see that no second follows."""
        documents = 0
        while not isinstance(event := self._next_event(), yaml.StreamEndEvent):
            if isinstance(event, yaml.DocumentStartEvent):
                documents += 1
                if event.version or event.tags:
                    self._fault(event, (), "a directive (%) has no place here.")
                if documents > 1:
                    self._fault(event, (), "a second document; one file holds one.")
                    raise _Refused
            elif isinstance(event, yaml.NodeEvent):
                self._node(event)
            elif isinstance(event, yaml.CollectionEndEvent):
                self.open.pop()

    def _next_event(self) -> Any:
        try:
            return self.loader.get_event()
        except yaml.MarkedYAMLError as error:
            mark = error.problem_mark or error.context_mark or self.loader.get_mark()
            hint = " Indent with spaces, not tabs." if "'\\t'" in str(error.problem) else ""
            context = f" {error.context}" if error.context else ""
            self._fault_at(mark, (), f"not valid YAML{context}: {error.problem}.{hint}")
        except (ValueError, OverflowError):  # an escape or a version number that is no number
            self._fault_at(
                self.loader.get_mark(), (), "not valid YAML: an escape that stands for no character."
            )
        raise _Refused

    def _node(self, event: Any) -> None:
        self.nodes += 1
        if self.nodes > MOST_NODES:
            self._fault(event, (), f"more than {MOST_NODES} values: no file of this kind has so many.")
            raise _Refused
        self._refuse_the_clever(event)
        parent = self.open[-1] if self.open else None
        if parent is not None and isinstance(parent.value, dict) and not parent.has_key:
            self._key(event, parent)
        else:
            self._value(event, parent)

    def _refuse_the_clever(self, event: Any) -> None:
        where = self.open[-1].path if self.open else ()
        if isinstance(event, yaml.AliasEvent):
            self._fault(event, where, f"an alias (*{event.anchor}) is not allowed: write the value out.")
        elif event.anchor is not None:
            self._fault(
                event,
                where,
                f"an anchor (&{event.anchor}) is not allowed: write values out.",
            )
        if getattr(event, "tag", None) is not None:
            self._fault(event, where, f"a tag ({event.tag}) is not allowed: values stand as text.")

    def _key(self, event: Any, parent: _Open) -> None:
        parent.has_key, parent.key = True, None  # no key: its value is dropped
        if not isinstance(event, yaml.ScalarEvent):
            if not isinstance(event, yaml.AliasEvent):
                self._fault(event, parent.path, "a key must be plain text.")
            self._enter(event, parent.path, kept=False)
            return
        text = self._text(event, parent.path)
        if text is None:
            self._fault(event, parent.path, "a key must not be empty.")
            return
        path = (*parent.path, text)
        if path in self.tree.keys and parent.kept:
            first = self.tree.keys[path]
            self._fault(event, path, f"duplicate key; it stands in line {first.line} already.")
        elif parent.kept:
            self.tree.keys[path] = _spot(event.start_mark)
            parent.key = text

    def _value(self, event: Any, parent: _Open | None) -> None:
        path: DocumentPath = ()
        kept = True
        if parent is not None:
            is_list = isinstance(parent.value, list)
            kept = parent.kept and (is_list or parent.key is not None)
            path = (*parent.path, len(parent.value) if is_list else parent.key or "")
        value = self._enter(event, path, kept=kept)
        if kept:
            self.tree.values[path] = _spot(event.start_mark)
        if parent is None:
            self.tree.value = value
        elif isinstance(parent.value, list):
            parent.value.append(value)
        else:
            if kept:
                parent.value[parent.key or ""] = value
            parent.has_key = False

    def _enter(self, event: Any, path: DocumentPath, *, kept: bool) -> Any:
        """Give the event's value; a collection is opened, to be filled by the events that follow."""
        if isinstance(event, yaml.ScalarEvent):
            return self._text(event, path)
        if not isinstance(event, yaml.CollectionStartEvent):
            return None
        if len(self.open) >= MOST_DEPTH:
            self._fault(event, path, f"nested deeper than {MOST_DEPTH} levels.")
            raise _Refused
        value: Any = {} if isinstance(event, yaml.MappingStartEvent) else []
        self.open.append(_Open(value, path, kept))
        return value

    def _text(self, event: Any, path: DocumentPath) -> str | None:
        text: str = event.value
        if event.style is None and text in {"", "~", "null"}:
            return None
        if any((ord(char) < 32 and char not in "\n\t") or 0xD800 <= ord(char) < 0xE000 for char in text):
            self._fault(event, path, "a control character has no place here.")
            return ""
        return text

    def _fault(self, event: Any, path: DocumentPath, message: str) -> None:
        self._fault_at(event.start_mark, path, message)

    def _fault_at(self, mark: Any, path: DocumentPath, message: str) -> None:
        self.tree.add_fault(_spot(mark), path, message)


def _spot(mark: Any) -> Spot:
    return Spot(mark.line + 1, mark.column + 1)
