"""The parameters of a result for a notebook: a short text, a table of HTML, and one of pandas."""

from __future__ import annotations

import html
import importlib
import math
import textwrap
from collections.abc import Sequence
from typing import Any, NamedTuple

from calib.errors import InputMismatch

#: Rows of parameters, notes, and characters of a note, so that the text has 20 lines at most.
_ROWS, _NOTES, _WIDTH = 14, 3, 110
_UNITS = {**dict.fromkeys(("fx", "fy", "cx", "cy"), "px"), **dict.fromkeys(("x", "y", "r"), "mm")}


class ParameterRow(NamedTuple):
    """A parameter with its uncertainty."""

    name: str
    value: float
    sigma: float
    k: float

    @property
    def expanded(self) -> float:
        """U = k sigma (JCGM 100:2008, 6.2.1)."""
        return self.k * self.sigma

    @property
    def unit(self) -> str:
        """px, mm, or nothing for a coefficient."""
        return _UNITS.get(self.name, "")

    @property
    def written(self) -> tuple[str, str]:
        """The value and U, to two digits of U."""
        u = self.expanded
        decimals = min(max(1 - math.floor(math.log10(u)), 0), 12) if 0 < u < math.inf else 6
        return f"{self.value:.{decimals}f}", f"{u:.{decimals}f}"


def as_text(head: str, rows: Sequence[ParameterRow], notes: Sequence[str]) -> str:
    """Return a summary of at most 20 lines."""
    lines = [head]
    for row in rows[:_ROWS]:
        value, u = row.written
        lines.append(f"  {row.name:>8} {value:>14} ± {u} {row.unit}".rstrip())
    if len(rows) > _ROWS:
        lines.append(f"  and {len(rows) - _ROWS} more: result.values, result.U")
    lines += [f"  note: {textwrap.shorten(note, _WIDTH, placeholder=' ...')}" for note in notes[:_NOTES]]
    if len(notes) > _NOTES:
        lines.append(f"  and {len(notes) - _NOTES} more: result.notes")
    return "\n".join(lines)


def as_html(head: str, rows: Sequence[ParameterRow], notes: Sequence[str]) -> str:
    """Return the summary as HTML."""
    cells = "".join(
        f"<tr><th>{html.escape(row.name)}</th><td>{row.written[0]}</td><td>± {row.written[1]}</td>"
        f"<td>{row.unit}</td><td>{row.k:.2f}</td></tr>"
        for row in rows
    )
    titles = "<tr><th></th><th>value</th><th>U</th><th></th><th>k</th></tr>"
    items = "".join(f"<li>{html.escape(note)}</li>" for note in notes)
    return f"<p>{html.escape(head)}</p><table>{titles}{cells}</table>{f'<ul>{items}</ul>' if items else ''}"


def as_frame(rows: Sequence[ParameterRow]) -> Any:
    """Return a pandas table of values, sigma, k and U, a row for each parameter.

    Raises InputMismatch: If pandas is not installed.
    """
    try:
        pandas = importlib.import_module("pandas")
    except ImportError as error:
        raise InputMismatch(
            "pandas is not installed.", remedy="pip install pandas, or use result.values and result.U."
        ) from error
    columns = {"value": "value", "sigma": "sigma", "k": "k", "U": "expanded", "unit": "unit"}
    table = {title: [getattr(row, name) for row in rows] for title, name in columns.items()}
    return pandas.DataFrame(table, index=[row.name for row in rows])
