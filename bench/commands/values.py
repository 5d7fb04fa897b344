"""Numbers and times as words of a command line; a refusal says in plain words what is wrong and what is needed."""

from __future__ import annotations

import math
from typing import Any

import click

_SMALLEST, _LARGEST = 1e-9, 1e12
"""Size of any number that is not 0: no quantity of a bench lies outside."""


class WholeNumber(click.IntRange):
    """Whole number within limits; a refusal calls it that."""

    name = "whole number"


class Moment(click.DateTime):
    """Date, or date and time of day; a refusal shows one."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """See `click.ParamType.convert`."""
        try:
            return super().convert(value, param, ctx)
        except click.BadParameter:
            forms = "2026-03-01 or 2026-03-01T21:00" if "%Y-%m-%d" in self.formats else "2026-03-01T21:00"
            self.fail(f"{value!r} is not a time that can be read. Write it as {forms}.", param, ctx)


class Number(click.ParamType):
    """Finite number between ``least`` and ``most`` if these are given."""

    name = "number"

    def __init__(self, *, least: float | None = None, most: float | None = None) -> None:
        self._least, self._most = least, most

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """See `click.ParamType.convert`."""
        try:
            number = math.nan if "_" in str(value) else float(value)  # Python reads 6_0 as 60
        except ValueError:
            number = math.nan
        if not math.isfinite(number):
            self.fail(f"{value!r} is not a number.", param, ctx)
        if self._least is not None and number < self._least:
            self.fail(f"{value} is not at least {self._least:g}.", param, ctx)
        if self._most is not None and number > self._most:
            self.fail(f"{value} is more than {self._most:g}.", param, ctx)
        if number and not _SMALLEST <= abs(number) <= _LARGEST:
            self.fail(f"{value} is not between {_SMALLEST:g} and {_LARGEST:g}.", param, ctx)
        return number
