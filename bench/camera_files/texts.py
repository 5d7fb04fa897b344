"""The bytes of a camera file as names with values: YAML, JSON, XML, numpy's npz, COLMAP's lines, mrcal's dictionary.

Files come from strangers: sizes and nesting are bounded, and no reader of another program runs on them.
"""

from __future__ import annotations

import ast
import re
import tokenize
import zipfile
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from io import BytesIO
from typing import Any, Final
from xml.etree import ElementTree as ET

import numpy as np

from bench.base.bounded_json import parse_json
from drivers.camera.file_kinds import in_place_of_file, known_kind
from sequences.yaml_text import parse

MOST_FILE_BYTES: Final = 20_000_000
"""Far above a camera file, packed or not: mrcal adds its measurements to a camera, about 1 MB."""
_MOST_LEVELS = 40  # Far above camera files; a hostile one ends here
_MOST_ENTRIES = 300_000
"""Values of a file: OpenCV's sample adds its image points to a camera, some 50,000 numbers."""
#: A longer list of numbers, in characters, is no part of a camera, but what it was calibrated from.
_LONGEST_LIST = 100_000
_NPZ = b"PK\x03\x04"
_MRCAL = re.compile(r"['\"]lensmodel['\"]\s*:")
_NUMBERS = re.compile(r"\[([-+.\deE,\s]*)\]")
_SEPARATOR = re.compile(r"^(?:---|\.\.\.)(?:[ \t].*)?$", re.MULTILINE)
_COMMENT = re.compile(r"^[ \t]*//.*$", re.MULTILINE)
_COLMAP = re.compile(
    r"^(?P<number>\d+)[ \t]+(?P<model>[A-Z_]+)[ \t]+(?P<width>\d+)[ \t]+(?P<height>\d+)"
    r"(?P<params>(?:[ \t]+[-+.\deE]+)+)[ \t]*$",
    re.MULTILINE,
)


class OtherForm(ValueError):
    """A file holds something else than what is wanted: why, as a part of a sentence, and what to do."""

    def __init__(self, why: str, remedy: str = "") -> None:
        super().__init__(why)
        self.remedy = remedy


def values_of(data: bytes) -> tuple[str, dict[str, Any]]:
    """Return the syntax of a file, and its names with texts, numbers, lists and mappings; or raise OtherForm."""
    if data.startswith(_NPZ) and not in_place_of_file(data):
        return "npz", _npz(data)
    if known := known_kind(data):
        raise OtherForm(f"it is {known[0]}", known[1])
    try:
        text = data.decode("utf-8-sig").replace("\r\n", "\n").strip()
    except UnicodeDecodeError:
        raise OtherForm("it is no text in UTF-8") from None
    if not text or "\0" in text:
        raise OtherForm("it is a binary file" if text else "it is empty")
    if max(text.count("<"), text.count(",")) > _MOST_ENTRIES:
        raise OtherForm("it is too large for a camera")
    for is_syntax, syntax, read in _SYNTAXES:
        if is_syntax(text):
            return syntax, read(text)
    return "YAML", _yaml(text)


def _npz(data: bytes) -> dict[str, Any]:
    """Read the arrays of `np.savez`. Python objects, such as poses of several lengths, are never unpacked."""
    try:
        with np.load(BytesIO(data), allow_pickle=False) as arrays:
            if sum(member.file_size for member in arrays.zip.infolist()) > MOST_FILE_BYTES:
                raise OtherForm("it is too large for a camera")
            return _once((name, _array(arrays, name)) for name in arrays.files)
    except (zipfile.BadZipFile, zlib.error, EOFError, OSError, RuntimeError, tokenize.TokenError) as error:
        raise OtherForm("it is no complete file of np.savez") from error


def _array(arrays: Mapping[str, Any], name: str) -> Any:
    try:
        array = arrays[name]
    except (ValueError, MemoryError):  # it holds objects, is torn, or claims too many numbers
        return None
    return array.tolist() if isinstance(array, np.ndarray) and array.size <= _MOST_ENTRIES else None


def _json(text: str) -> dict[str, Any]:
    """Read JSON, and the lines of comments that OpenCV writes into it."""
    try:
        return _mapping(parse_json(_COMMENT.sub("", text)))
    except ValueError as error:
        raise OtherForm(f"it is no complete JSON: {error}") from None


def _mrcal(text: str) -> dict[str, Any]:
    """Read mrcal's dictionary of Python."""
    try:
        read: Any = ast.parse(text, mode="eval").body  # of a dictionary
        names, values = ([ast.literal_eval(part) for part in parts] for parts in (read.keys, read.values))
    except (AttributeError, ValueError, SyntaxError, TypeError, MemoryError, RecursionError):
        raise OtherForm("it is no complete dictionary of Python") from None
    return _once(zip(names, values, strict=True))


def _mapping(document: Any) -> dict[str, Any]:
    if not isinstance(document, dict):
        raise OtherForm("it is no YAML, JSON or XML of names with values")
    return _once(document.items())


def _once(named: Iterable[tuple[Any, Any]]) -> dict[str, Any]:
    """Return names with their values; or raise OtherForm, since of two values readers take one or the other."""
    pairs = [(str(name), value) for name, value in named]
    if len(dict(pairs)) < len(pairs):
        raise OtherForm("it states a name twice")
    return dict(pairs)


def _yaml(text: str) -> dict[str, Any]:
    """Read YAML, and what OpenCV and ROS write beside it: tags, a first line that YAML has not, an end of a message."""
    body = _NUMBERS.sub(_as_text, re.sub(r"\A%YAML.*", "", text))
    documents = [part for part in _SEPARATOR.split(body) if part.strip()]
    if len(documents) > 1:
        raise OtherForm(
            f"{len(documents)} documents follow one another", "Copy one of them to a file of its own."
        )
    document = "".join(documents)
    tree = parse(document.encode(), "", allow_tags=True)
    if tree.faults:
        fault, above = tree.faults[0], body.partition(document)[0].count("\n")
        why = fault.message.rstrip(".") if tree.complete else "this is no YAML"
        raise OtherForm(f"line {above + fault.line}: {why}")
    return _mapping(tree.value)


def _as_text(listed: re.Match[str]) -> str:
    """Return a list of numbers as one text, so that thousands of image points are read at once."""
    return f'"{listed[1]}"' if len(listed[1]) < _LONGEST_LIST else '""'


def _xml(text: str) -> dict[str, Any]:
    """Read OpenCV's XML: the names of elements are keys, and elements `_` are a list."""
    if "<!DOCTYPE" in text:
        raise OtherForm("it declares entities: a small file can hold gigabytes of them")
    try:
        root = ET.fromstring(text)  # noqa: S314 - it fetches nothing, and has no entities
    except ET.ParseError as error:
        raise OtherForm(f"it is no complete XML: line {error.position[0]}") from None
    if root.tag != "opencv_storage":
        raise OtherForm(f"it is XML of another program ({root.tag[:40]})")
    return _mapping(_element(root, _MOST_LEVELS))


def _element(element: ET.Element, levels: int) -> Any:
    if not levels:
        raise OtherForm(f"it is nested deeper than {_MOST_LEVELS} levels")
    children = [(child.tag, _element(child, levels - 1)) for child in element]
    if element.find("_") is not None:
        return [value for _, value in children]
    return _once(children) if children else (element.text or "").strip()


def _colmap(text: str) -> dict[str, Any]:
    """Read COLMAP's cameras.txt: CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[] a line."""
    for line in text.split("\n"):
        if line.strip() and not line.startswith("#") and not _COLMAP.match(line):
            raise OtherForm(f"this line is no camera of COLMAP: {line[:40]!r}")
    return _once((camera["number"], camera.groupdict()) for camera in _COLMAP.finditer(text))


_SYNTAXES: Sequence[tuple[Callable[[str], Any], str, Callable[[str], dict[str, Any]]]] = (
    (lambda text: text.startswith("<"), "XML", _xml),
    (_MRCAL.search, "Python", _mrcal),
    (lambda text: text.startswith("{"), "JSON", _json),
    (_COLMAP.search, "COLMAP", _colmap),
)
"""How a text is recognised, its name, and its reader; any other text is YAML."""
