"""Scales of plots: how values are spread along an axis, its ticks and their labels, and how wide a text is. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from bench.wording.numbers import exact, fixed
from calib.arrays import Array

_STEPS = (1.0, 2.0, 5.0, 10.0)  # Times a power of ten: round numbers
_LABELLED = ((1, 2, 5), (1,))
"""Digits of logarithmic ticks: the first that are few enough."""
_NARROW, _WIDE_LETTERS = frozenset(" .,:;|!'()[]fijlrtI\N{PRIME}"), frozenset("mwMW@%\N{HORIZONTAL ELLIPSIS}")


@dataclass(frozen=True)
class Scale:
    """The range of an axis, and how its values are spread."""

    low: float  # Value at the left or lower end; it may be larger than ``high``
    high: float  # Value at the right or upper end
    kind: Literal["linear", "log"] = "linear"
    # Positions of the ticks and their labels; None for round numbers.
    ticks: Sequence[tuple[float, str]] | None = None

    def share(self, values: ArrayLike) -> Array:
        """Return where values stand: 0 at ``low``, 1 at ``high``."""
        low, high = (float(self._spread(np.asarray(end, float))) for end in (self.low, self.high))
        return np.asarray((self._spread(np.asarray(values, float)) - low) / (high - low))

    def chosen_ticks(self, most: int) -> list[tuple[float, str]]:
        """Return the ticks within the range, with their labels."""
        if self.ticks is not None:
            return list(self.ticks)
        low, high = sorted((self.low, self.high))
        if self.kind == "log":
            return [(value, exact(value)) for value in log_ticks(low, high, most)]
        tick_values = ticks(low, high, most)
        return list(zip(tick_values, tick_labels(tick_values), strict=True))

    def _spread(self, values: Array) -> Array:
        return np.log10(values) if self.kind == "log" else values


def ticks(low: float, high: float, most: int = 5) -> list[float]:
    """Return round numbers in a range, in rising order; ``low`` alone if the range is empty.

    >>> ticks(0.0, 9.7)
    [0.0, 2.0, 4.0, 6.0, 8.0]
    """
    if not high > low:
        return [low]
    rough = (high - low) / most
    power = 10.0 ** math.floor(math.log10(rough))
    wide = next(i for i, s in enumerate(_STEPS) if s * power >= rough * (1 - 1e-9))
    return _multiples(low, high, _STEPS[wide] * power) or _multiples(low, high, _STEPS[wide - 1] * power)


def _multiples(low: float, high: float, step: float) -> list[float]:
    """Return the multiples of a step in a range. A range of more than half a step may hold none."""
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [number * step for number in range(first, last + 1)]


def log_ticks(low: float, high: float, most: int = 5) -> list[float]:
    """Return round numbers of a logarithmic axis.

    1, 2 and 5 times powers of ten, or powers of ten if those are too many; round numbers of a linear axis if the range
    has less than two of them.

    >>> log_ticks(0.3, 7.0)
    [0.5, 1.0, 2.0, 5.0]
    """
    tick_values: list[float] = []
    for digits in _LABELLED:
        tick_values = decades(low, high, digits)
        if len(tick_values) <= most + 1:
            break
    return tick_values if len(tick_values) > 1 else [value for value in ticks(low, high, most) if value > 0]


def decades(low: float, high: float, digits: Sequence[int]) -> list[float]:
    """Return the numbers with one of these digits and else zeros from ``low``, above 0, to ``high``, in rising order.

    >>> decades(0.3, 7.0, (1, 2, 5))
    [0.5, 1.0, 2.0, 5.0]
    """
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    return [v for power in powers for digit in digits if low <= (v := float(f"{digit}e{power}")) <= high]


def tick_label(value: float, span: float) -> str:
    """Return the label of a tick, with a true minus sign.

    >>> tick_label(3345.0, 4.0), tick_label(-0.05, 0.2)
    ('3345.0', '−0.05')
    """
    return fixed(value, max(0, 1 - math.floor(math.log10(span))) if span > 0 else 3)


def tick_labels(values: Sequence[float]) -> list[str]:
    """Return the labels of evenly spaced ticks in rising order, with the decimals that their distance needs.

    >>> tick_labels([-0.5, 0.0, 0.5]), tick_labels([0.0, 200.0])
    (['−0.5', '0.0', '0.5'], ['0', '200'])
    """
    if len(values) < 2:
        return [exact(float(f"{value:.6g}")) for value in values]
    decimals = max(0, -math.floor(math.log10(values[1] - values[0]) + 1e-9))
    return [fixed(value, decimals) for value in values]


def text_width(text: str, size: float) -> float:
    """Estimate how wide a text is in DejaVu Sans, in the unit of ``size``; most typefaces are narrower."""
    return size * sum(_letter_width(letter) for letter in text)


def _letter_width(letter: str) -> float:
    if letter in _NARROW:
        return 0.37
    if letter in _WIDE_LETTERS or ord(letter) > 0x2E80:  # ideographs are as wide as high
        return 0.96
    return 0.7 if letter.isupper() else 0.63
