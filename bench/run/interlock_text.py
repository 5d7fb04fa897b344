"""Names of interlocks in words, for status lines and messages."""

from __future__ import annotations


def interlock_text(name: str) -> str:
    """Return the name of an interlock in words.

    Parameters
    ----------
    name
        As in the station file.

    Returns
    -------
    str
        With spaces.

    Examples
    --------
    >>> interlock_text("camera_temperature")
    'camera temperature'
    """
    return name.replace("_", " ")
