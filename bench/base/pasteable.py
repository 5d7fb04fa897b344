"""A command of this program as text that a person pastes into a terminal."""

from __future__ import annotations

import shlex


def pasteable(*words: object) -> str:
    """Return a command with its words, each quoted where a shell would take it apart.

    >>> pasteable("verify", "runs/cam 7")
    "starbench verify 'runs/cam 7'"
    """
    return shlex.join(["starbench", *map(str, words)])
