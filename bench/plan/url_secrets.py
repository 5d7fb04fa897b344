"""No credential in a URL of a sequence, a station or a queue: these files are copied into sealed folders.

Comments are looked at, too, because a copy holds every byte of its file.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from bench.base.secret_patterns import find_secrets
from sequences.reader import Located
from sequences.tree import DocumentPath, Fault, path_text

_ENV_KEYS = {"source": "source_env", "url": "url_env", "password": "password_env"}
"""Key of a value, and the key that names an environment variable in its place."""


def find_url_secrets(document: Located[Any]) -> list[Fault]:
    """Find credentials in a document.

    Returns: One for each value or line with a credential, at its place; no message contains the credential.
    """
    found: dict[int, Fault] = {}
    tree = document.tree
    for path, text in _texts(tree.value, ()):
        for secret in find_secrets(text.encode()):
            spot = tree.spot(path)
            found.setdefault(
                spot.line,
                Fault(document.file, *spot, path_text(path), f"this is {secret.kind}. {_remedy(path)}"),
            )
    lines = {fault.line for fault in found.values()}
    for secret in find_secrets(document.text):
        if secret.line not in lines:
            what = f"this line contains {secret.kind}, and the file is copied into the run folder. Remove it."
            found.setdefault(secret.line, Fault(document.file, secret.line, secret.column, "", what))
    return list(found.values())


def _remedy(path: DocumentPath) -> str:
    """Return what to write instead."""
    key = str(path[-1]) if path else ""
    if key in _ENV_KEYS:
        name = _ENV_KEYS[key]
        return (
            f"The file is copied into the run folder. Put the value into an environment variable, and name that: "
            f"{name}: NAME in place of {key}."
        )
    return "The file is copied into the run folder. Remove it."


def _texts(value: Any, path: DocumentPath) -> Iterator[tuple[DocumentPath, str]]:
    if isinstance(value, str):
        yield path, value
    elif isinstance(value, dict | list):
        for key, inner in value.items() if isinstance(value, dict) else enumerate(value):
            yield from _texts(inner, (*path, key))
