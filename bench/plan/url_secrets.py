"""No credential in a URL of a sequence, a station or a queue: these files are copied into sealed folders.

Comments are looked at, too, because a copy holds every byte of its file.
"""

from __future__ import annotations

import re
from typing import Any

from bench.base.bounded_json import leaves
from sequences.reader import Located
from sequences.tree import DocumentPath, Fault, path_text

_ENV_KEYS = {"source": "source_env", "password": "password_env"}
"""Key of a value, and the key that names an environment variable in its place."""

_OF_URL = r"[^\s\"'<>\\]"
_NAMES = (
    "token|secret|key|auth|authorization|password|passwd|passwort|pwd|pass|sig|signature|"
    "credentials?|session|sessionid"
)
_KINDS = {
    "a URL with a password": r"://[^\s/?#@:\"'<>\\]{0,200}?(?::|%3a)[^\s/?#@\"'<>\\]{1,500}@",
    "a URL with a token before the @": r"://[^\s/?#@:\"'<>\\]{16,500}@",
    "a URL with a token or password": rf"://{_OF_URL}{{1,2000}}?[?&;#](?:[a-z]{{1,20}}[_-]?){{0,4}}(?:{_NAMES})=[^\s&;#]",
    "a secret address of Slack": r"hooks\.slack\.com/(?:services|workflows|triggers)/[a-z0-9/]",
    "a secret address of Discord": r"/api/webhooks/\d+/[a-z0-9_-]{20}",
    "a secret address of Teams": r"/webhookb2/[a-z0-9@-]{30}",
    "a token of Telegram": r"api\.telegram\.org/bot\d+:[a-z0-9_-]{20}",
}
"""What a URL with a credential looks like; an escaped colon is a colon, too."""


def find_url_secrets(document: Located[Any]) -> list[Fault]:
    """Find credentials: a fault for each value or line with one, at its place, without the credential itself."""
    faults: dict[int, Fault] = {}
    tree = document.tree
    for path, text in leaves(tree.value):
        if isinstance(text, str) and (kind := _kind_of(text)):
            spot = tree.spot(path)
            fault = Fault(document.file, *spot, path_text(path), f"this is {kind}. {_remedy(path)}")
            faults.setdefault(spot.line, fault)
    lines = {fault.line for fault in faults.values()}
    for number, line in enumerate(document.text.decode(errors="replace").splitlines(), start=1):
        if number not in lines and (kind := _kind_of(line)):
            what = f"this line contains {kind}, and the file is copied into the run folder. Remove it."
            faults[number] = Fault(document.file, number, 1 + line.index("/"), "", what)
    return list(faults.values())


def _kind_of(text: str) -> str:
    """Return what a text with a credential is; empty if it has none."""
    return next((kind for kind, form in _KINDS.items() if re.search(form, text, re.IGNORECASE)), "")


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
