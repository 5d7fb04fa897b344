"""From a file to a checked document: strict text, then a pydantic model, every fault at its line and column.

Knows how a file is opened and checked. Knows no particular model: sequences and stations both come here.
"""

from __future__ import annotations

import typing
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

from pydantic import BaseModel, ValidationError

from sequences.errors import DocumentFaults, Fault
from sequences.settings import with_settings
from sequences.wording import did_you_mean, faults_of
from sequences.yaml_text import MOST_BYTES, DocumentPath, Spot, Tree, parse, path_text

Model = TypeVar("Model", bound=BaseModel)


@dataclass(frozen=True)
class Located(Generic[Model]):
    """A checked document that remembers where everything stood.

    Attributes
    ----------
    value
        The document as its model.
    text
        The file's bytes, as they were.
    file
        The file, as it was named.
    """

    value: Model
    text: bytes
    file: str
    tree: Tree

    def position(self, path: DocumentPath) -> Spot:
        """Where the value at a path begins; for what is not written there, the nearest thing around it."""
        return self.tree.spot(path)

    def where(self, path: DocumentPath) -> str:
        """Say where a path is, as ``file:line:column``."""
        spot = self.position(path)
        return f"{self.file}:{spot.line}:{spot.column}"

    def fault(self, path: DocumentPath, message: str) -> Fault:
        """Make a fault of the value at a path."""
        spot = self.position(path)
        return Fault(self.file, spot.line, spot.column, path_text(path), message)


def read_document(
    path: Path | str, model: type[Model], settings: Mapping[str, str] | None = None
) -> Located[Model]:
    """Read and check a YAML file.

    Parameters
    ----------
    path
        The file.
    model
        The pydantic model it must fit.
    settings
        What is set otherwise than the file says (`sequences.settings`); the text given back has it in it.

    Raises
    ------
    DocumentFaults
        With every fault found: a file that cannot be opened, text that is not plain YAML, values that do
        not fit.
    """
    data = with_settings(_bytes_of(Path(path)), str(path), settings or {})
    return check_document(data, f"{path} with settings" if settings else str(path), model)


def check_document(data: bytes, file: str, model: type[Model]) -> Located[Model]:
    """Check a YAML document's bytes; as ``read_document``, for text that is in no file of that name.

    The model's validators find the whole mapping, as text, under ``document`` in their context.

    Raises
    ------
    DocumentFaults
        With every fault found.
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
    """Find a file: the one at a path, or by its bare name (no folder, no ending) the one shipped in a folder.

    Raises
    ------
    DocumentFaults
        When neither is there; names those that are shipped.
    """
    path = Path(name_or_path)
    if path.name != name_or_path or path.suffix or path.exists():
        return path
    known = {file.stem: file for file in sorted(shipped.glob("*.yaml"))}
    if name_or_path not in known:
        hint = did_you_mean(name_or_path, known)
        raise DocumentFaults(
            [Fault(name_or_path, 0, 0, "", f"there is no such file, and none is shipped by this name.{hint}")]
        )
    return known[name_or_path]


def _of_this_format(tree: Tree, model: type[BaseModel]) -> dict[str, Any]:
    """Give the document if it says it is of this kind: else one fault, not one at every line."""
    if not isinstance(tree.value, dict):
        found = "empty" if tree.value is None else "something else"
        message = f"the document must be a mapping (key: value), and is {found}."
        raise DocumentFaults([*tree.faults, Fault(tree.file, *tree.spot(()), "", message)])
    wanted = (
        typing.get_args(model.model_fields["format"].annotation)[0]
        if "format" in model.model_fields
        else None
    )
    said = tree.value.get("format", wanted)
    if said != wanted:
        message = f"this is not a document of the kind wanted here: {wanted!r} (got {said!r})."
        raise DocumentFaults([*tree.faults, Fault(tree.file, *tree.spot(("format",)), "format", message)])
    return tree.value


def _bytes_of(path: Path) -> bytes:
    """Read the file: one byte more at most than a document may have."""
    try:
        if path.exists() and not path.is_file():
            message = "this is not a file" + (" but a folder." if path.is_dir() else ".")
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
