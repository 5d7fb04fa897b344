"""From a file to a checked document: strict text, then a pydantic model, every fault at its line and column.

The module opens and checks a file. The caller names the model, so sequences, stations and queues share this reader.
"""

from __future__ import annotations

import typing
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Generic, TypeVar

from pydantic import BaseModel, ValidationError

from sequences.errors import DocumentFaults
from sequences.settings import file_with_settings, with_settings
from sequences.tree import DocumentPath, Fault, Spot, Tree, path_text
from sequences.wording import did_you_mean, faults_of
from sequences.yaml_text import MOST_BYTES, parse

Model = TypeVar("Model", bound=BaseModel)


@dataclass(frozen=True)
class Located(Generic[Model]):
    """A checked document, with the place of each value in its file."""

    value: Model
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

    def position(self, path: DocumentPath) -> Spot:
        """Return where the value at a path begins, or the nearest value around it if the document has no such path."""
        return self.tree.spot(path)

    def where(self, path: DocumentPath) -> str:
        """Return where the value at a path begins, as `position`, as ``file:line:column``."""
        spot = self.position(path)
        return f"{self.file}:{spot.line}:{spot.column}"

    def fault(self, path: DocumentPath, message: str) -> Fault:
        """Return a fault of the value at a path, as `position` takes it."""
        spot = self.position(path)
        return Fault(self.file, spot.line, spot.column, path_text(path), message)


def read_document(
    path: Path | str, model: type[Model], settings: Mapping[str, str] | None = None
) -> Located[Model]:
    """Read and check a YAML file; settings (`sequences.settings`) replace values of the returned text.

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
    faults = list(tree.faults)
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
        raise DocumentFaults(
            [
                Fault(
                    name_or_path, 0, 0, "", f"there is no such file, and no shipped file has this name.{hint}"
                )
            ]
        )
    return known[name_or_path]


def _of_this_format(tree: Tree, model: type[BaseModel]) -> dict[str, Any]:
    """Return the document if its format is the wanted one; else raise one fault instead of one for each line."""
    if not isinstance(tree.value, dict):
        found = "empty" if tree.value is None else "something else"
        message = f"the document must be a mapping (key: value), but it is {found}."
        raise DocumentFaults([*tree.faults, Fault(tree.file, *tree.spot(()), "", message)])
    wanted = (
        typing.get_args(model.model_fields["format"].annotation)[0]
        if "format" in model.model_fields
        else None
    )
    said = tree.value.get("format", wanted)
    if said != wanted:
        message = f"wrong kind of document: {wanted!r} is needed here (got {said!r})."
        raise DocumentFaults([*tree.faults, Fault(tree.file, *tree.spot(("format",)), "format", message)])
    return tree.value


def _bytes_of(path: Path) -> bytes:
    """Read the file, at most one byte more than a document may have."""
    try:
        if path.exists() and not path.is_file():
            message = "this is a folder, not a file." if path.is_dir() else "this is not a regular file."
            raise DocumentFaults([Fault(str(path), 0, 0, "", message)])
        with path.open("rb") as stream:
            return stream.read(MOST_BYTES + 1)
    except FileNotFoundError:
        message = "there is no such file."
    except PermissionError:
        message = "no permission to read this file."
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        message = f"the file cannot be read: {getattr(error, 'strerror', None) or error}."
    raise DocumentFaults([Fault(str(path), 0, 0, "", message)])
