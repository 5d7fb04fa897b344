"""Numbers as instruments print them: with SI prefixes, units, spaces or a decimal comma, and their own resolution."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Final, NamedTuple

_NUMBER = re.compile(
    r"([+-]?) ?(\d{1,3}(?: \d{3})+|\d*)(?:[.,](\d*))?(?: ?E([+-]?\d{1,3}))? ?([A-Z%]*)",
    re.IGNORECASE | re.ASCII,
)
_PREFIXES: Final[Mapping[str, float]] = {
    "": 1.0,
    "N": 1e-9,
    "U": 1e-6,
    "M": 1e-3,
    "K": 1e3,
    "MA": 1e6,
    "G": 1e9,
}
"""Factors of SI prefixes in capitals, as SCPI has them."""
_UNITS: Final[Mapping[str, tuple[str, ...]]] = {
    "Hz": ("HZ",),
    "V": ("VPP", "VDC", "V"),
    "%": ("%", "PCT"),
    "s": ("S",),
}
"""Spellings of each unit."""
_COARSEST_REL: Final = 1e-3
"""Most of a difference that the digits of an answer may hide: printers leave out zeros, so ``60`` may be 60.00."""


class Quantity(NamedTuple):
    """A number as a device prints it."""

    value: float  # The number, in the unit that was asked for
    half_digit: float = 0.0  # Half of its last digit, in the same unit

    def agrees_with(self, wanted: float, tolerance: float = 0.0) -> bool:
        """Return whether a wanted value prints like this, or differs by no more than the tolerance."""
        shown = min(self.half_digit * 1.001, _COARSEST_REL * abs(self.value))
        return abs(self.value - wanted) <= max(shown, tolerance)


def read_quantity(text: str, unit: str = "", bare_factor: float = 1.0) -> Quantity | None:
    """Read a finite number with an optional unit ("Hz", "V", "%", "s"); None if the text is no such number.

    ``bare_factor`` is the unit of a number without a unit.

    >>> read_quantity("+1.5 kHz", "Hz"), read_quantity("2500mV", "V")
    (Quantity(value=1500.0, half_digit=50.0), Quantity(value=2.5, half_digit=0.0005))
    >>> read_quantity("6,0E1"), read_quantity("60 KZ", "Hz")
    (Quantity(value=60.0, half_digit=0.5), None)
    """
    match = _NUMBER.fullmatch(text.strip())
    if match is None:
        return None
    sign, whole, decimals, exponent, suffix = (part or "" for part in match.groups())
    factor = bare_factor if not suffix else _factor(suffix, unit)
    if factor is None or not whole + decimals:
        return None
    try:
        value = float(f"{sign}{whole.replace(' ', '')}.{decimals}E{exponent or 0}") * factor
        half_digit = 0.5 * 10.0 ** (int(exponent or 0) - len(decimals)) * factor
    except OverflowError:
        return None
    return Quantity(value, half_digit) if math.isfinite(value) else None


def _factor(suffix: str, unit: str) -> float | None:
    """Return the factor of a suffix such as ``kHz``, or of a prefix alone; None if it is another unit."""
    for spelling in _UNITS.get(unit, ()):
        if suffix.upper().endswith(spelling):
            suffix = suffix[: -len(spelling)]
            break
    # MHz is a million hertz, although MV is a thousandth of a volt.
    prefix = "MA" if suffix == "M" and unit == "Hz" else suffix.upper()
    return _PREFIXES.get(prefix)
