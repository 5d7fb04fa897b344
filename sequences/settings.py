"""Replace values in a YAML document: settings of a job or of the command line take the place of the file's values.

Paths such as ``defaults.record.window_ms`` say which values. The reader checks the result like any document.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import yaml

from sequences.errors import DocumentFaults
from sequences.tree import Fault
from sequences.yaml_text import parse


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

    Examples
    --------
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
        fault = Fault(file, 0, 0, path, "the document has no such place to set: check the path.")
        raise DocumentFaults([fault]) from None


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
