"""Settings of a GRBL controller, by number: their factory values and their printed form.

Numbers and formats are those of GRBL 1.1 (wiki page "Configuration").
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Final

from simulators.stages.gcode import GcodeError
from simulators.stages.grbl_planner import ACCELERATION, MAX_RATE, MAX_TRAVEL, STEPS, GrblAxisModel

_NUMBER: Final = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)")
#: Settings with decimals, apart from those of the axes.
_WITH_DECIMALS: Final = {11, 12, 24, 25, 27}


def factory_settings(models: Mapping[str, GrblAxisModel], pull_off_deg: float) -> dict[int, float]:
    """Return the factory settings of a board with these axes.

    models: Axes by letter: X, Y and Z in this order.
    pull_off_deg: Distance from the switch at which homing ends, degrees.
    Returns: Values by number, in rising order.
    """
    settings = {
        0: 10.0,
        1: 255.0,
        2: 0.0,
        3: 0.0,
        4: 0.0,
        5: 0.0,
        6: 0.0,
        10: 1.0,
        11: 0.01,
        12: 0.002,
        13: 0.0,
    }
    settings |= {20: 1.0, 21: 1.0, 22: 1.0, 23: 0.0, 24: 120.0, 25: 1200.0, 26: 250.0, 27: pull_off_deg}
    settings |= {30: 1000.0, 31: 0.0, 32: 0.0}
    for number, model in enumerate(models.values()):
        settings |= {
            STEPS + number: model.mechanics.counts_per_deg,
            MAX_RATE + number: model.max_rate_deg_s * 60.0,
            ACCELERATION + number: model.acceleration_deg_s2,
            MAX_TRAVEL + number: model.travel_deg,
        }
    return dict(sorted(settings.items()))


def format_setting(number: int, value: float) -> str:
    """Format a setting as GRBL prints it: whole-number settings without decimals, all others with three."""
    return f"{value:.3f}" if number in _WITH_DECIMALS or number >= STEPS else f"{value:.0f}"


def parse_setting(command: str) -> tuple[int, float]:
    """Parse the change of a setting.

    command: The line after its ``$``, without blanks.
    Raises GcodeError: 2 bad number, 3 not a setting.

    Examples
    --------
    >>> parse_setting("110=2400.5")
    (110, 2400.5)
    """
    number = _NUMBER.match(command)
    if number is None:
        raise GcodeError(2)
    if command[number.end() : number.end() + 1] != "=":
        raise GcodeError(3)
    value = _NUMBER.match(command, number.end() + 1)
    if value is None:
        raise GcodeError(2)
    if value.end() < len(command) or float(number[0]) > 255:
        raise GcodeError(3)
    return int(float(number[0])), float(value[0])
