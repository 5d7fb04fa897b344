"""Errors of the Newport ESP301: numbers and texts.

Reference: Newport ESP301 user's manual, appendix "Error messages".
"""

from __future__ import annotations

from typing import Final

_ERROR_TEXTS: Final = {
    0: "NO ERROR DETECTED",
    4: "EMERGENCY STOP ACTIVATED",
    6: "COMMAND DOES NOT EXIST",
    7: "PARAMETER OUT OF RANGE",
    9: "AXIS NUMBER OUT OF RANGE",
    37: "AXIS NUMBER MISSING",
    38: "COMMAND PARAMETER MISSING",
}
_AXIS_ERROR_TEXTS: Final = {
    1: "PARAMETER OUT OF RANGE",
    3: "FOLLOWING ERROR THRESHOLD EXCEEDED",
    4: "POSITIVE HARDWARE LIMIT DETECTED",
    5: "NEGATIVE HARDWARE LIMIT DETECTED",
    6: "POSITIVE SOFTWARE LIMIT DETECTED",
    7: "NEGATIVE SOFTWARE LIMIT DETECTED",
    10: "MAXIMUM VELOCITY EXCEEDED",
    11: "MAXIMUM ACCELERATION EXCEEDED",
    13: "MOTOR NOT ENABLED",
    20: "HOMING ABORTED",
    30: "COMMAND NOT ALLOWED DURING HOMING",
}


class EspError(Exception):
    """A refused command.

    number: Number of a controller error or of an axis error, depending on where it is raised.
    """

    def __init__(self, number: int) -> None:
        self.number = number
        super().__init__(str(number))


def error_text(number: int) -> str:
    """Return the text of an error, as ``TB?`` answers it.

    number: Number of a controller error, or axis * 100 + number of an axis error.
    """
    return _AXIS_ERROR_TEXTS[number % 100] if number >= 100 else _ERROR_TEXTS[number]
