"""From a file to a checked document: strict text, then a pydantic model, every fault at its line and column.

The caller names the model, so sequences, stations and queues share this reader. Settings of a job or of the command
line take the place of values in the file, by paths such as ``defaults.record.window_ms``.
"""

from __future__ import annotations

import typing
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Generic, TypeVar

import yaml
from pydantic import BaseModel, ValidationError

from sequences.errors import DocumentFaults
from sequences.kinds import kind_of_format
from sequences.tree import DocumentPath, Fault, Tree, path_text
from sequences.wording import did_you_mean, faults_of
from sequences.yaml_text import MOST_BYTES, parse

_TYPOGRAPHIC = "\u201c\u201d\u201e\u201f\u2018\u2019\u201a\u00ab\u00bb"

Model = TypeVar("Model", bound=BaseModel)
Model_co = TypeVar("Model_co", bound=BaseModel, covariant=True)


class OptionSettings(dict[str, str]):
    """Settings given by an option of a command; messages then name the option."""

    def __init__(self, values: Mapping[str, str], option: str) -> None:
        super().__init__(values)
        self.option = option

    def part(self, values: Mapping[str, str]) -> OptionSettings:
        """Return other settings given by the same option."""
        return OptionSettings(values, self.option)


def file_with_settings(file: str, settings: Mapping[str, str]) -> str:
    """Return the name of a file in messages, without a line; it says so if settings replace values of the file.

    >>> file_with_settings("a.yaml", {}), file_with_settings("a.yaml", {"name": "B"})
    ('a.yaml', 'a.yaml (with settings)')
    """
    if not settings:
        return file
    return f"{file} (with {settings.option if isinstance(settings, OptionSettings) else 'settings'})"


class _Plain(yaml.SafeDumper):
    """Writes the values of a `Tree`: text, and an empty value for None."""


_Plain.add_representer(type(None), lambda dumper, _: dumper.represent_scalar("tag:yaml.org,2002:null", ""))


def with_settings(data: bytes, file: str, settings: Mapping[str, str]) -> bytes:
    """Replace values in a YAML document; without settings, ``data`` itself; else without the comments of the old one.

    Settings are YAML texts by path. Dots separate the keys of a path; list elements count from 0. Missing mappings on
    the way are created.
    Raises DocumentFaults: If the document or a value is not plain YAML, or if a path leads through a value that has no
      such part.

    >>> print(with_settings(b"a: {b: 1}", "x.yaml", {"a.b": "[2, 3]", "c.d": "no"}).decode(), end="")
    a:
      b:
      - '2'
      - '3'
    c:
      d: 'no'
    """
    if not settings:
        return data
    tree = parse(data, file)
    if tree.faults:
        raise DocumentFaults(tree.faults, tree)
    for path, text in settings.items():
        _put(tree.value, path, _value(path, text), file)
    written: str = yaml.dump(tree.value, Dumper=_Plain, sort_keys=False, allow_unicode=True)
    return written.encode()


def _value(path: str, text: str) -> Any:
    parsed = parse(f"value: {text}\n".encode(), f"setting {path}")
    if parsed.faults or not isinstance(parsed.value, dict) or list(parsed.value) != ["value"]:
        raise _placeless(f"setting {path}", f"{text!r} is not one plain YAML value.")
    return parsed.value["value"]


def _put(tree: Any, path: str, value: Any, file: str) -> None:
    *way, last = path.split(".")
    here = tree
    try:
        for key in way:
            here = _part(here, key)
        if isinstance(here, list):
            here[int(last)] = value
        else:
            _mapping(here)[last] = value
    except (TypeError, ValueError, IndexError):
        raise _placeless(file, "the document has no such place to set: check the path.", path) from None


def _part(here: Any, key: str) -> Any:
    """Return the part of a list or mapping at a key; create a missing mapping."""
    if isinstance(here, list):
        return here[int(key)]
    if _mapping(here).get(key) is None:
        here[key] = {}
    return here[key]


def _mapping(here: Any) -> dict[str, Any]:
    if not isinstance(here, dict):
        raise TypeError
    return here


@dataclass(frozen=True)
class Located(Generic[Model_co]):
    """A checked document, with the place of each value in its file."""

    value: Model_co
    text: bytes  # The document's bytes, unchanged
    file: str  # The file's name, as the caller gave it
    tree: Tree
    folder: Path | None = None  # Folder of the file; None for a document that is not in a file
    set_paths: tuple[str, ...] = ()  # Dotted paths whose values were given by settings, not by the file

    def file_at(self, path: DocumentPath, name: str) -> Path:
        """Return the file that the value at a path names, relative to the document's folder.

        It is relative to the working directory if a setting gave the value, or if the document is not in a file.
        """
        dotted = ".".join(map(str, path)) + "."
        if self.folder is None or any(dotted.startswith(f"{given}.") for given in self.set_paths):
            return Path(name)
        return self.folder / name

    def where(self, path: DocumentPath) -> str:
        """Return where the value at a path begins, as `position`, as ``file:line:column``."""
        spot = self.tree.spot(path)
        return f"{self.file}:{spot.line}:{spot.column}"

    def fault(self, path: DocumentPath, message: str) -> Fault:
        """Return a fault of the value at a path, as `position` takes it."""
        spot = self.tree.spot(path)
        return Fault(self.file, spot.line, spot.column, path_text(path), message)


def read_document(
    path: Path | str, model: type[Model], settings: Mapping[str, str] | None = None
) -> Located[Model]:
    """Read and check a YAML file; settings (`sequences.reader`) replace values of the returned text.

    Raises DocumentFaults: With every fault: a file that does not open, no plain YAML, values that the model refuses.
    """
    data = with_settings(_bytes_of(Path(path)), str(path), settings or {})
    read = check_document(data, file_with_settings(str(path), settings or {}), model)
    return replace(read, folder=Path(path).parent, set_paths=tuple(settings or {}))


def check_document(data: bytes, file: str, model: type[Model]) -> Located[Model]:
    """Check a YAML document's bytes, UTF-8: `read_document` for text that need not be in a file.

    The model's validators find the whole mapping, as text, under ``document`` in their context.
    """
    tree = parse(data, file)
    faults = [*tree.faults, *_typographic_quotes(tree)]
    value = None
    if tree.complete:
        try:
            document = _of_this_format(tree, model)
            value = model.model_validate(document, context={"document": document})
        except ValidationError as error:
            faults += faults_of(error, tree, model)
    if faults or value is None:
        raise DocumentFaults(faults, tree)
    return Located(value, data, file, tree)


def _typographic_quotes(tree: Tree) -> Iterator[Fault]:
    """Yield a fault for each text in quotes of typesetters, as a word processor writes them: YAML keeps them."""
    for path, spot in tree.values.items():
        value = tree.value
        for part in path:
            value = value[part]
        if isinstance(value, str) and value[:1] in _TYPOGRAPHIC and value[-1:] in _TYPOGRAPHIC and value:
            message = f'typographic quotes ({value[0]}) would be a part of the text: write ".'
            yield Fault(tree.file, *spot, path_text(path), message)


def find_document(name_or_path: str, shipped: Path) -> Path:
    """Find a file by its path, which need not exist, or a shipped ``*.yaml`` by its bare name, if no file has it.

    Raises DocumentFaults: If a bare name is neither a file nor shipped; the message lists the shipped names.
    """
    path = Path(name_or_path)
    if path.name != name_or_path or path.suffix or path.exists():
        return path
    known = {file.stem: file for file in sorted(shipped.glob("*.yaml"))}
    if name_or_path not in known:
        hint = did_you_mean(name_or_path, known)
        raise _placeless(name_or_path, f"there is no such file, and no shipped file has this name.{hint}")
    return known[name_or_path]


def _of_this_format(tree: Tree, model: type[BaseModel]) -> dict[str, Any]:
    """Return the document if its format is the wanted one; else raise one fault instead of one for each line."""
    if not isinstance(tree.value, dict):
        kind = "empty" if tree.value is None else "something else"
        message = f"the document must be a mapping (key: value), but it is {kind}."
        raise DocumentFaults([*tree.faults, Fault(tree.file, *tree.spot(()), "", message)])
    wanted = (
        typing.get_args(model.model_fields["format"].annotation)[0]
        if "format" in model.model_fields
        else None
    )
    known = model.model_fields.keys() & tree.value.keys()
    if wanted is not None and "format" not in tree.value and len(tree.value) > 2 * len(known):
        message = (
            f"this is a file of something else: it has no 'format: {wanted}', and most of its keys are unknown. Give"
            " another file, or begin this one with that line."
        )
        raise DocumentFaults([*tree.faults, Fault(tree.file, *tree.spot(()), "format", message)])
    stated = tree.value.get("format", wanted)
    if stated != wanted:
        message = f"wrong kind of document: {_wrong_kind(wanted, stated)}"
        raise DocumentFaults([*tree.faults, Fault(tree.file, *tree.spot(("format",)), "format", message)])
    return tree.value


def _wrong_kind(wanted: object, stated: object) -> str:
    """Return which kind of document is needed and which it is, with where such a one belongs."""
    needed, given = kind_of_format(wanted), kind_of_format(stated)
    if needed is None or given in {None, needed}:  # another version, or a word that we do not know
        return f"{wanted!r} is needed here (got {stated!r})."
    return f"{needed.words} is needed here, and this is {given.words}. {given.use}".rstrip()


def _placeless(file: str, message: str, path: str = "") -> DocumentFaults:
    """Build the error of a document that has no line and column to name."""
    return DocumentFaults([Fault(file, 0, 0, path, message)])


def _bytes_of(path: Path) -> bytes:
    """Read the file, at most one byte more than a document may have."""
    try:
        if path.exists() and not path.is_file():
            message = "this is a folder, not a file." if path.is_dir() else "this is not a regular file."
            raise _placeless(str(path), message)
        with path.open("rb") as stream:
            return stream.read(MOST_BYTES + 1)
    except FileNotFoundError:
        message = "there is no such file."
    except PermissionError:
        message = "no permission to read this file."
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        message = f"the file cannot be read: {getattr(error, 'strerror', None) or error}."
    raise _placeless(str(path), message)
