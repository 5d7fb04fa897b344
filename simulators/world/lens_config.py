"""Reader of the configuration's section ``lens``: focus, aperture and pixels."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields
from typing import Any, Final

from simulators.errors import ConfigError
from simulators.world.lens_truth import BEYOND_M, CLOSEST_M, F_NUMBERS, LARGEST_FOCAL_MM, LensTruth, in_reach
from simulators.world.truth import CameraTruth

_DELIVERED: Final = "pattern"


def lens_from_config(given: object, camera: CameraTruth) -> LensTruth:
    """Read the section of the lens.

    given: Mapping with the keys ``focus_distance_m`` (a number, ``infinity``, or ``pattern``), ``f_number``
      and ``pixel_um``. All are optional.
    Raises ConfigError: If a key is unknown or its value is not valid; the error names the key.

    Examples
    --------
    >>> lens_from_config({"focus_distance_m": 2.7, "f_number": 4}, CameraTruth())
    LensTruth(focus_distance_m=2.7, f_number=4.0, pixel_um=4.86)
    """
    if not isinstance(given, Mapping):
        raise ConfigError(f"A mapping is expected, not {given!r}.", where="lens")
    values: dict[str, Any] = {}
    for key, value in given.items():
        if key == "focus_distance_m":
            values[key] = None if value == _DELIVERED else focus_distance_m(value, f"lens.{key}")
        elif key == "f_number":
            values[key] = f_number(value, f"lens.{key}")
        elif key == "pixel_um":
            values[key] = _positive(value, f"lens.{key}")
        else:
            known = ", ".join(one.name for one in fields(LensTruth))
            raise ConfigError("Unknown key.", where=f"lens.{key}", remedy=f"Known are: {known}.")
    lens = LensTruth(**values)
    focal_mm = lens.pixel_um * 1e-3 * 0.5 * (camera.fx + camera.fy)
    if values and focal_mm > LARGEST_FOCAL_MM:
        raise ConfigError(
            f"A lens of {focal_mm:.0f} mm (fx of the camera times pixel_um) is too long for this focus ring.",
            where="lens.pixel_um",
            remedy=f"Give the side of a pixel in um, so that the focal length is at most {LARGEST_FOCAL_MM:.0f} mm.",
        )
    return lens


def focus_distance_m(value: object, where: str) -> float:
    """Check a focus distance.

    value: A number, or the word ``infinity``.
    Returns: Distance; infinite for parallel light, negative beyond infinity.
    Raises ConfigError: If it is no distance, or the focus ring does not reach it.
    """
    word = isinstance(value, str) and value.strip().lower() in {"infinity", "inf", ".inf"}
    number = math.inf if word else value
    if isinstance(number, bool) or not isinstance(number, (int, float)):
        raise ConfigError(
            f"A distance is expected, not {value!r}.",
            where=where,
            remedy="Give metres, or the word infinity.",
        )
    if number == -math.inf:
        number = math.inf  # the same focus
    if not in_reach(float(number)):
        raise ConfigError(
            f"The focus ring does not reach {value!r} m.",
            where=where,
            remedy=f"Give at least {CLOSEST_M}, or infinity. Beyond infinity the ring goes to {BEYOND_M}.",
        )
    return float(number)


def f_number(value: object, where: str) -> float:
    """Check an f-number.

    Raises ConfigError: If it is not a number in the lens's range.
    """
    number = _positive(value, where)
    low, high = F_NUMBERS
    if not low <= number <= high:
        raise ConfigError(
            f"The aperture does not go to f/{number:g}.",
            where=where,
            remedy=f"Give an f-number from {low:g} to {high:g}.",
        )
    return number


def _positive(value: object, where: str) -> float:
    """Check that it is a finite positive number."""
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise ConfigError(f"A finite number is expected, not {value!r}.", where=where)
    if value <= 0:
        raise ConfigError(f"{value!r} is not positive.", where=where, remedy="Give a positive number.")
    return float(value)
