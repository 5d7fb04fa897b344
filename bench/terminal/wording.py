"""Numbers with their nouns, for messages and status lines."""

from __future__ import annotations

_TIMES = {1: "once", 2: "twice"}


def counted(number: int, noun: str) -> str:
    """Return a number with its noun, in the plural unless the number is 1.

    noun: The noun in the singular; its plural ends in "s".

    Examples
    --------
    >>> counted(1, "recording"), counted(3, "pose"), counted(0, "run")
    ('1 recording', '3 poses', '0 runs')
    """
    return f"{number} {noun}{'' if number == 1 else 's'}"


def times(number: int) -> str:
    """Return how often something was done.

    Returns: ``once``, ``twice``, or the number with "times".

    Examples
    --------
    >>> times(1), times(2), times(5)
    ('once', 'twice', '5 times')
    """
    return _TIMES.get(number, f"{number} times")
