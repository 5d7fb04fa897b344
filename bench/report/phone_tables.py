"""Tables that fit a phone: each cell carries the head of its column, which a narrow screen shows beside it."""

from __future__ import annotations

import re
from collections.abc import Iterator

_TABLE = re.compile(r"<table\b.*?</table>", re.DOTALL)
_ROW = re.compile(r"<tr\b.*?</tr>", re.DOTALL)
_CELL = re.compile(r"<(t[dh])\b([^>]*)>(.*?)</\1>", re.DOTALL)
_TAG = re.compile(r"<[^>]*>")
_SPAN = re.compile(r'colspan="(\d+)"')


def label_cells(page: str) -> str:
    """Return a page in which the cells of each table with a head have the attribute ``data-label``."""
    return _TABLE.sub(lambda table: _labelled(table[0]), page)


def _labelled(table: str) -> str:
    head, end, body = table.partition("</thead>")
    if not end:
        return table
    names = list(_names(head))
    return head + end + _ROW.sub(lambda row: _labelled_row(row[0], names), body)


def _names(head: str) -> Iterator[str]:
    """Yield the head of each column as text; one that spans columns names the first of them."""
    for _, attributes, content in _CELL.findall(head):
        text = _TAG.sub("", content).strip().replace('"', "&quot;")
        yield from [text] + [""] * (_columns(attributes) - 1)


def _labelled_row(row: str, names: list[str]) -> str:
    at = 0

    def labelled(cell: re.Match[str]) -> str:
        nonlocal at
        name = names[at] if at < len(names) else ""
        label = f' data-label="{name}"' if name and at else ""  # the first cell is the title of its row
        at += _columns(cell[2])
        return f"<{cell[1]}{cell[2]}{label}>{cell[3]}</{cell[1]}>"

    return _CELL.sub(labelled, row)


def _columns(attributes: str) -> int:
    span = _SPAN.search(attributes)
    return int(span[1]) if span else 1
