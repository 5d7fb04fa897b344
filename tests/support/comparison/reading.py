"""Reads what a side left in its folder into places and values, so that any two sides can be compared in one way.

A JSON file gives one value for each of its leaves (`results.json/calibration/camera/fx`), a journal the same for each
of its lines, HDF5 one for each dataset and attribute, and a text one list of lines.
"""

import hashlib
import io
import json
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path

import h5py
import numpy as np

from comparison.rules import PASSING_EVENTS, normal_number, normal_text
from comparison.wire import exchanges, without_repeats

Folders = Iterable[tuple[str, str]]
#: What a place holds: a number, a text, an array, or the lines of a text.
Value = object
_CACHES = re.compile(
    r"(^|/)(kept-views|kept-answers|locks|\.cache|tmp|__pycache__|\.config|numba)(/|$)|\.sqlite3|\.lock$|bench_key$"
)


def read_folder(folder: Path, folders: Folders) -> dict[str, Value]:
    """Every place in the files of a folder."""
    folders = list(folders)
    values: dict[str, Value] = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.is_file() and not _CACHES.search(name):
            values |= {f"{normal_text(name)}{place}": value for place, value in _read(path, folders)}
    return values


def _read(path: Path, folders: Folders) -> Iterator[tuple[str, Value]]:
    readers: Mapping[str, Callable[[Path, Folders], Iterator[tuple[str, Value]]]] = {
        ".json": _json, ".jsonl": _journal, ".h5": _hdf5, ".raw": _raw, ".pdf": _kind_only, ".sig": _kind_only,
        ".tif": _bytes, ".npz": _kind_only, ".hdf5": _hdf5,
    }  # fmt: skip
    reader = readers.get(path.suffix, _text)
    if path.name.startswith("wire"):
        reader = _wire
    elif path.name == ".reserve":  # random bytes that keep disk space free
        reader = _size_only
    try:
        yield from reader(path, folders)
    except (ValueError, OSError) as error:
        yield "", f"cannot be read: {error}; {hashlib.sha256(path.read_bytes()).hexdigest()}"


def leaves(value: object, folders: Folders, place: str = "") -> Iterator[tuple[str, Value]]:
    """Each leaf of a JSON value with its place; an empty object or list is a leaf too."""
    if isinstance(value, dict | list) and value:
        inside = value.items() if isinstance(value, dict) else enumerate(value)
        for name, inner in inside:
            yield from leaves(inner, folders, f"{place}/{name}")
    else:
        yield place, normal_text(value, folders) if isinstance(value, str) else normal_number(place, value)


def _json(path: Path, folders: Folders) -> Iterator[tuple[str, Value]]:
    yield from leaves(json.loads(path.read_text(encoding="utf-8")), folders)
    yield " (order of keys)", _keys(json.loads(path.read_text(encoding="utf-8")))


def _keys(value: object) -> str:
    if isinstance(value, dict):
        return "{" + ",".join(f"{name}{_keys(inner)}" for name, inner in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ",".join(dict.fromkeys(map(_keys, value))) + "]"
    return ""


def _journal(path: Path, folders: Folders) -> Iterator[tuple[str, Value]]:
    named = [
        (str(entry.get("event", entry.get("kind", "entry"))), entry)
        for entry in map(json.loads, path.read_text(encoding="utf-8").splitlines())
    ]
    named = [(name, entry) for name, entry in named if name not in PASSING_EVENTS]
    yield " (events)", [name for name, _ in named]
    counts: Counter[str] = Counter()
    for name, entry in named:
        counts[name] += 1
        inner = {key: value for key, value in entry.items() if key != "seq"}
        yield from leaves(inner, folders, f"/{name}-{counts[name]}")


def _wire(path: Path, _folders: Folders) -> Iterator[tuple[str, Value]]:
    for port, all_ in exchanges(path.read_text(encoding="utf-8").splitlines()).items():
        yield f"/{port}", list(without_repeats(all_))


def _hdf5(path: Path, folders: Folders) -> Iterator[tuple[str, Value]]:
    values: list[tuple[str, Value]] = []

    def visit(name: str, node: h5py.Group | h5py.Dataset) -> None:
        place = f"/{name}" if name else ""
        for key, value in node.attrs.items():
            values.append(
                (f"{place}@{key}", normal_text(value, folders) if isinstance(value, str) else value)
            )
        if isinstance(node, h5py.Dataset):
            values.append((place, _data(node)))

    with h5py.File(path) as file:
        visit("", file)
        file.visititems(visit)
    yield from values


def _data(node: h5py.Dataset) -> Value:
    """The values; where they are coded by a filter that is not installed here, the bytes of each chunk."""
    try:
        return node[()]
    except OSError:
        chunks = range(node.id.get_num_chunks())
        stored = [node.id.read_direct_chunk(node.id.get_chunk_info(i).chunk_offset)[1] for i in chunks]
        return [f"{len(data)} bytes, {hashlib.sha256(data).hexdigest()}" for data in stored]


def _raw(path: Path, folders: Folders) -> Iterator[tuple[str, Value]]:
    data = path.read_bytes()
    header, end, body = data.partition(b"% end\n")
    if not end:
        header, body = b"", data
    yield " (header)", normal_text(header.decode("latin-1"), folders).splitlines()
    yield " (events)", f"{len(body)} bytes, {hashlib.sha256(body).hexdigest()}"


def _bytes(path: Path, _folders: Folders) -> Iterator[tuple[str, Value]]:
    data = path.read_bytes()
    yield "", f"{len(data)} bytes, {hashlib.sha256(data).hexdigest()}"


def _size_only(path: Path, _folders: Folders) -> Iterator[tuple[str, Value]]:
    yield "", f"{path.stat().st_size} bytes"


def _kind_only(path: Path, _folders: Folders) -> Iterator[tuple[str, Value]]:
    yield "", f"is there, begins with {path.read_bytes()[:5]!r}"


def _text(path: Path, folders: Folders) -> Iterator[tuple[str, Value]]:
    text = path.read_bytes().decode("utf-8", "replace")
    if path.suffix in {".html", ".svg", ".xml"}:  # generators put whole pictures into a line
        text = text.replace("><", ">\n<")
    yield "", normal_text(text, folders).splitlines()


def equal(value: Value, other: Value) -> bool:
    """Whether two values are the same to the last bit, not-a-number and types included."""
    if isinstance(value, np.ndarray) and isinstance(other, np.ndarray):
        return value.dtype == other.dtype and value.shape == other.shape and _dump(value) == _dump(other)
    if type(value) is not type(other):
        return False
    if isinstance(value, float):
        return repr(value) == repr(other)
    return bool(np.all(value == other))


def _dump(array: np.ndarray) -> bytes:
    buffer = io.BytesIO()
    if array.dtype.hasobject:
        return repr(array.tolist()).encode()
    np.save(buffer, array)
    return buffer.getvalue()
