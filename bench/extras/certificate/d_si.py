r"""Units of the Digital System of Units (D-SI), as its XML writes them: ``\milli\metre``, ``\metre\per\second``."""

from __future__ import annotations

import re

PREFIXES = {
    "quecto": -30, "ronto": -27, "yocto": -24, "zepto": -21, "atto": -18, "femto": -15, "pico": -12, "nano": -9,
    "micro": -6, "milli": -3, "centi": -2, "deci": -1, "deca": 1, "hecto": 2, "kilo": 3, "mega": 6, "giga": 9,
    "tera": 12, "peta": 15, "exa": 18, "zetta": 21, "yotta": 24, "ronna": 27, "quetta": 30,
}  # fmt: skip
"""Prefixes, each with its power of ten."""
_WITH_PREFIX = (
    "ampere candela kelvin metre mole second becquerel coulomb farad gray henry hertz joule katal lumen lux newton ohm"
    " pascal radian siemens sievert steradian tesla volt watt weber angstrom arcminute arcsecond astronomicalunit bar"
    " barn bel bit byte dalton degree electronvolt gram knot litre nauticalmile neper tonne"
)
_ALONE = "day decibel degreecelsius hectare hour kilogram minute mmHg"
_POWER = r"\\tothe\{-?\d{1,2}(?:[._]\d{1,2})?\}"

OUR_UNITS = {
    "": r"\one",
    "1": r"\one",
    "px": r"\one",
    "%": r"\percent",
    "ppm": r"\ppm",
    "m": r"\metre",
    "mm": r"\milli\metre",
    "µm": r"\micro\metre",
    "nm": r"\nano\metre",
    "rad": r"\radian",
    "mrad": r"\milli\radian",
    "µrad": r"\micro\radian",
    "deg": r"\degree",
    "°": r"\degree",
    "arcmin": r"\arcminute",
    "arcsec": r"\arcsecond",
    "s": r"\second",
    "ms": r"\milli\second",
    "min": r"\minute",
    "h": r"\hour",
    "Hz": r"\hertz",
    "kHz": r"\kilo\hertz",
    "MHz": r"\mega\hertz",
    "K": r"\kelvin",
    "°C": r"\degreecelsius",
    "%RH": r"\percent",
    "% RH": r"\percent",
    "hPa": r"\hecto\pascal",
    "kPa": r"\kilo\pascal",
    "Pa": r"\pascal",
    "mbar": r"\milli\bar",
    "lx": r"\lux",
    "V": r"\volt",
    "A": r"\ampere",
    "mA": r"\milli\ampere",
    "Mev/s": r"\micro\second\tothe{-1}",
    "event": r"\one",
    "events": r"\one",
}
"""Units as Starbench prints them, and as D-SI writes them."""

_QUOTIENT = re.compile(r"\s*([^/()]+?)\s*(?:/\s*(?:\((.+)\)|(.+)))?\s*")


def _one_of(names: str) -> str:
    return rf"\\(?:{'|'.join(names.split())})"


_BINARY = rf"{_one_of('kibi mebi gibi tebi pebi exbi zebi yobi')}{_one_of('bit byte')}"
_DECIMAL = rf"(?!\\kilo\\gram(?:\\|$))(?:{_one_of(' '.join(PREFIXES))})?{_one_of(_WITH_PREFIX)}"
_PRODUCT = (
    rf"(?:(?:{_one_of('one percent ppm')}|(?:{_BINARY}|{_one_of(_ALONE)}|{_DECIMAL})(?:{_POWER})?)(?=\\|$))+"
)
_UNIT = re.compile(rf"{_PRODUCT}(?:\\per{_PRODUCT})?")


def d_si_unit(unit: str) -> str | None:
    r"""Return the D-SI form of a unit that Starbench prints; None if it has none.

    That is one of `OUR_UNITS`, a quotient of these such as ``px / (mm/K)``, or a unit in D-SI's notation.

    >>> d_si_unit("arcsec"), d_si_unit("mm/K"), d_si_unit("px / (mm/K)"), d_si_unit("furlong")
    ('\\arcsecond', '\\milli\\metre\\kelvin\\tothe{-1}', '\\milli\\metre\\tothe{-1}\\kelvin', None)
    """
    if unit in OUR_UNITS:
        return OUR_UNITS[unit]
    if is_unit(unit):
        return unit
    powers = _powers(unit)
    written = "" if powers is None else _written(powers)
    return written if is_unit(written) else None


def product(first: str, second: str) -> str:
    r"""Return the unit of two units' covariance: D-SI units among the values of `OUR_UNITS` that have no power.

    >>> product(r"\one", r"\milli\metre"), product(r"\milli\metre", r"\milli\metre"), product(r"\one", r"\one")
    ('\\milli\\metre', '\\milli\\metre\\tothe{2}', '\\one')
    """
    powers = {first: 1}
    powers[second] = powers.get(second, 0) + 1
    return _written(powers)


def _powers(unit: str) -> dict[str, int] | None:
    """Return the units of D-SI in a unit that Starbench prints, each with its power."""
    quotient = _QUOTIENT.fullmatch(unit)
    if quotient is None or quotient[1] not in OUR_UNITS:
        return None
    powers = {OUR_UNITS[quotient[1]]: 1}
    divisor = quotient[2] or quotient[3]
    if divisor is None:
        return powers
    below = {OUR_UNITS[divisor]: 1} if divisor in OUR_UNITS else _powers(divisor)
    if below is None or any("tothe" in unit_name or "per\\" in unit_name for unit_name in (*powers, *below)):
        return None
    for unit_name, power in below.items():
        powers[unit_name] = powers.get(unit_name, 0) - power
    return powers


def _written(powers: dict[str, int]) -> str:
    """Return a product of units in D-SI's notation."""
    parts = [
        unit_name if power == 1 else rf"{unit_name}\tothe{{{power}}}"
        for unit_name, power in powers.items()
        if unit_name != r"\one" and power != 0
    ]
    return "".join(parts) or r"\one"


def is_unit(text: str) -> bool:
    r"""Return whether a text is a unit of D-SI.

    >>> [is_unit(text) for text in (r"\metre\per\second", r"\pixel", r"\milli\milli\metre", r"\one\tothe{2}")]
    [True, False, False, False]
    """
    return _UNIT.fullmatch(text) is not None
