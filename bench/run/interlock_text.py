"""Names and causes of interlocks as text, for status lines and messages."""

from __future__ import annotations

from drivers.errors import DriverError


def loss_text(error: DriverError) -> str:
    """Return how a device was lost, for a run that holds: it continues by itself, so nobody has to resume it.

    Returns: Place, what is wrong, and remedy, without the last full stop: whoever quotes it ends the
      sentence.

    Examples
    --------
    >>> loss_text(DriverError("It is gone.", where="camera 7", remedy="Check the cable, then resume the run."))
    'camera 7: It is gone. Check its cable and power'
    """
    place = f"{error.where}: " if error.where else ""
    remedy = "Check its cable and power." if "resume" in error.remedy.lower() else error.remedy
    return f"{place}{error.what} {remedy}".strip().removesuffix(".")


def interlock_text(name: str) -> str:
    """Return the name of an interlock as text.

    Examples
    --------
    >>> interlock_text("camera_temperature")
    'camera temperature'
    """
    return name.replace("_", " ")
