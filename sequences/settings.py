"""A document with some of its values replaced: what a job, or the command line, sets otherwise than the file says.

Knows YAML text and paths such as ``defaults.record.window_ms``; not what a document means. Whether the result makes
sense is found out as for any document, when it is checked.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import yaml

from sequences.errors import DocumentFaults, Fault
from sequences.yaml_text import parse


class _Plain(yaml.SafeDumper):
    """Writes what the reader gives: texts, and nothing at all for no value."""


_Plain.add_representer(type(None), lambda dumper, _: dumper.represent_scalar("tag:yaml.org,2002:null", ""))


def with_settings(data: bytes, file: str, settings: Mapping[str, str]) -> bytes:
    """Replace values in a YAML document.

    Parameters
    ----------
    data
        The document, as ``reader.check_document`` takes it.
    file
        Its name, for faults.
    settings
        YAML texts by path; the keys of a path are separated by dots, elements of a list are counted from 0. Mappings
        that are missing on the way are made.

    Returns
    -------
    bytes
        A document of its own; comments do not survive. The same as ``data`` where nothing is set.

    Raises
    ------
    DocumentFaults
        When the document, or a value, is not plain YAML, or a path leads through something that has no such part.

    Examples
    --------
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
    found = parse(f"value: {text}\n".encode(), f"setting {path}")
    if found.faults or not isinstance(found.value, dict) or list(found.value) != ["value"]:
        raise DocumentFaults([Fault(f"setting {path}", 0, 0, "", f"{text!r} is not one plain YAML value.")])
    return found.value["value"]


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
        fault = Fault(file, 0, 0, path, "there is no such place to set.")
        raise DocumentFaults([fault]) from None


def _part(here: Any, key: str) -> Any:
    """Go into a list or a mapping; a mapping that is not there is made."""
    if isinstance(here, list):
        return here[int(key)]
    if _mapping(here).get(key) is None:
        here[key] = {}
    return here[key]


def _mapping(here: Any) -> dict[str, Any]:
    if not isinstance(here, dict):
        raise TypeError
    return here
