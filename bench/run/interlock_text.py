"""Names of interlocks as text, for status lines and messages."""

from __future__ import annotations


def interlock_text(name: str) -> str:
    """Return the name of an interlock as text.

    Parameters
    ----------
    name
        Name in the station file.

    Returns
    -------
    str
        The name with spaces.

    Examples
    --------
    >>> interlock_text("camera_temperature")
    'camera temperature'
    """
    return name.replace("_", " ")
