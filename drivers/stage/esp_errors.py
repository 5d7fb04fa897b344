"""Parse the entries of the error buffer of a Newport ESP controller, and give their meanings. Sends nothing.

Source: Newport, "ESP300" and "ESP301 User's Manual", ``TB?`` in section 3 (remote mode) and the appendix on error
messages.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

_ERROR = re.compile(r"(\d{1,4}), ?(\d{1,12}), ?([ -~]+)")

AXIS_ERRORS = {
    0: "motor type not defined",
    1: "parameter out of range",
    2: "amplifier fault",
    3: "following error beyond its threshold",
    4: "positive limit switch reached",
    5: "negative limit switch reached",
    6: "positive software limit reached",
    7: "negative software limit reached",
    8: "motor or stage not connected",
    9: "feedback signal lost",
    10: "speed beyond its maximum",
    11: "acceleration beyond its maximum",
    13: "motor off",
    15: "jerk beyond its maximum",
    17: "critical settings are protected",
    18: "stage device error",
    19: "the stage's data are invalid",
    20: "homing aborted",
}
"""Meanings of the last two digits of an error of an axis; the digits before them are the number of the axis."""


@dataclass(frozen=True)
class EspError:
    """One entry of the error buffer."""

    code: int  # Error number; 0 for an empty buffer
    time_cycles: int
    text: str  # The controller's own description

    def __str__(self) -> str:
        axis, number = divmod(self.code, 100)
        words = AXIS_ERRORS.get(number, self.text.lower()) if axis else self.text.lower()
        return f"{words} (error {self.code})"


def parse_error(text: str) -> EspError | None:
    """Parse the answer to ``TB?``.

    Returns: The entry; None for any other text.

    Examples
    --------
    >>> str(parse_error("213, 5321, AXIS 2 MOTOR NOT ENABLED"))
    'motor off (error 213)'
    """
    match = _ERROR.fullmatch(text)
    return EspError(int(match[1]), int(match[2]), match[3]) if match else None
