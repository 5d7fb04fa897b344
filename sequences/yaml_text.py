"""Strict YAML reader: from bytes to mappings, lists and plain text, each with its place.

The documents use a part of YAML only. All scalars stay text (``serial: 00051234`` is not a number, ``no`` is not
false); only an empty value, ``~`` and ``null`` mean None. The reader refuses duplicate keys, anchors, aliases, tags,
directives, several documents in a file, and documents that are too large or too deeply nested. It checks no schema and
opens no file.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from typing import Any

import yaml

from sequences.tree import DocumentPath, Fault, Spot, Tree

MOST_BYTES = 1_000_000
"""Bytes that a document may have at most. Sequences have some thousand; a larger document would keep the reader
busy."""
MOST_NODES = 20_000
"""Values and keys that a document may have at most."""
MOST_DEPTH = 40
"""Levels of nesting that a document may have at most."""


_NO_COLON = "could not find expected ':'"
"""What the parser says of a line without a colon, or without a space behind it."""
_NO_BREAK = "\N{NO-BREAK SPACE}"
_HINTS = {
    _NO_COLON: "Write `key: value`, with a space behind the colon.",
    "mapping values are not allowed here": "Check the indentation; put a text that holds a colon into quotes.",
    "found character '%' that cannot start any token": "Put the text into quotes.",
    "found character '@' that cannot start any token": "Put the text into quotes.",
}
"""What to write instead, by what the parser says."""


class _Refused(Exception):
    """Reading must stop; the fault is already recorded."""


def parse(data: bytes, file: str, *, allow_tags: bool = False) -> Tree:
    """Read a document's bytes, UTF-8. Never raises: the faults are in the returned tree.

    ``allow_tags`` reads the values of other programs' files as if they had no tags.
    """
    tree = Tree(file)
    with contextlib.suppress(_Refused):
        _Walk(_decoded(data, tree), tree, allow_tags=allow_tags).document()
        tree.complete = True
    return tree


def _decoded(data: bytes, tree: Tree) -> str:
    """Decode the text, if it is small enough and all of it is printable UTF-8."""
    if len(data) > MOST_BYTES:
        tree.faults.append(
            Fault(tree.file, 0, 0, "", f"larger than {MOST_BYTES} bytes: a file may not be larger.")
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
        message = f"a character that is not allowed in text (U+{ord(strange.group()):04X}): remove it."
        tree.add_fault(_end_of(text[: strange.start()]), (), message)
        raise _Refused
    return text


def _end_of(text: str) -> Spot:
    return Spot(text.count("\n") + 1, len(text) - (text.rfind("\n") + 1) + 1)


@dataclass
class _Open:
    """A mapping or list that the reader has not reached the end of."""

    value: dict[str, Any] | list[Any]
    path: DocumentPath
    kept: bool = True  # a value under a refused key is read and discarded
    key: str | None = None
    has_key: bool = False


class _Walk:
    """Takes the parser's events one by one, without recursion, and checks each bound before it needs memory."""

    def __init__(self, text: str, tree: Tree, *, allow_tags: bool) -> None:
        self.tree = tree
        self.lines = text.split("\n")
        self.allow_tags = allow_tags
        self.loader: Any = yaml.SafeLoader(text)  # pure Python: libyaml crashes on deep nesting
        self.nodes = 0
        self.open: list[_Open] = []

    def document(self) -> None:
        """Read to the end of the first document; refuse a second one."""
        documents = 0
        while not isinstance(event := self._next_event(), yaml.StreamEndEvent):
            if isinstance(event, yaml.DocumentStartEvent):
                documents += 1
                if event.version or event.tags:
                    self._fault(event, (), "a directive (%) is not allowed: remove it.")
                if documents > 1:
                    self._fault(event, (), "a second document is not allowed: a file holds one document.")
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
            if error.problem == _NO_COLON:  # the parser notices it in a later line
                mark = error.context_mark or mark
            context = f" {error.context}" if error.context else ""
            self._fault_at(mark, (), f"not valid YAML{context}: {error.problem}.{self._hint(error, mark)}")
        except (ValueError, OverflowError):  # an invalid escape, or a version number that is not a number
            self._fault_at(
                self.loader.get_mark(), (), "not valid YAML: invalid escape sequence or version number."
            )
        raise _Refused

    def _hint(self, error: yaml.MarkedYAMLError, mark: Any) -> str:
        """Return what to write instead of what people often write; empty for other errors."""
        line = self.lines[mark.line] if mark.line < len(self.lines) else ""
        if _NO_BREAK in line:
            return " The line has a no-break space (U+00A0), which looks like a space: replace it."
        if "'\\t'" in str(error.problem):
            return f" {'Write' if line[: mark.column].strip() else 'Indent with'} spaces, not tabs."
        hint = _HINTS.get(str(error.problem))
        return f" {hint}" if hint else ""

    def _node(self, event: Any) -> None:
        self.nodes += 1
        if self.nodes > MOST_NODES:
            self._fault(event, (), f"more than {MOST_NODES} values: a file may not have more.")
            raise _Refused
        self._refuse_references_and_tags(event)
        parent = self.open[-1] if self.open else None
        if parent is not None and isinstance(parent.value, dict) and not parent.has_key:
            self._key(event, parent)
        else:
            self._value(event, parent)

    def _refuse_references_and_tags(self, event: Any) -> None:
        where = self.open[-1].path if self.open else ()
        if isinstance(event, yaml.AliasEvent):
            self._fault(event, where, f"an alias (*{event.anchor}) is not allowed: write the value in full.")
        elif event.anchor is not None:
            self._fault(
                event,
                where,
                f"an anchor (&{event.anchor}) is not allowed: write each value in full.",
            )
        if getattr(event, "tag", None) is not None and not self.allow_tags:
            self._fault(event, where, f"a tag ({event.tag}) is not allowed: write the value without a tag.")

    def _key(self, event: Any, parent: _Open) -> None:
        parent.has_key, parent.key = True, None  # None: the value is discarded
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
            self._fault(event, path, f"duplicate key; the first one is in line {first.line}.")
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
        """Return the event's value; a mapping or list is opened, and the following events fill it."""
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
            self._fault(event, path, "a control character is not allowed: remove it.")
            return ""
        return text

    def _fault(self, event: Any, path: DocumentPath, message: str) -> None:
        self._fault_at(event.start_mark, path, message)

    def _fault_at(self, mark: Any, path: DocumentPath, message: str) -> None:
        self.tree.add_fault(_spot(mark), path, message)


def _spot(mark: Any) -> Spot:
    return Spot(mark.line + 1, mark.column + 1)
