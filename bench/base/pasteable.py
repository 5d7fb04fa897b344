"""A command of this program as text that a person pastes into a terminal."""

from __future__ import annotations

import shlex

from bench.base.encoding import printable_line


def pasteable(*words: object) -> str:
    r"""Return a command with its words, each quoted where a shell would take it apart.

    >>> pasteable("verify", "runs/cam 7")
    "starbench verify 'runs/cam 7'"
    >>> print(pasteable("verify", "runs/a\nb"))
    starbench verify $'runs/a\nb'
    """
    return " ".join(["starbench", *(_quoted(str(word)) for word in words)])


def _quoted(word: str) -> str:
    if printable_line(word) == word:
        return shlex.quote(word)
    escaped = word.replace("\\", r"\\").replace("'", r"\'")
    return f"$'{printable_line(escaped)}'"
