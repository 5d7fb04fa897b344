"""The diagram of the states that a run went through.

Transitions to the right are drawn above the boxes, transitions back below them. A number beside an arrow is the number
of times that the transition happened.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from datetime import datetime
from html import escape
from itertools import pairwise

from markupsafe import Markup

from bench.record.events import StateEntered
from bench.wording.numbers import duration

_STEP, _WIDE, _TALL = 92.0, 76.0, 26.0  # px of the drawing
_MARGIN = 10.0  # px of the drawing
_TIMES = "\N{MULTIPLICATION SIGN}"


def state_diagram(states: Sequence[StateEntered]) -> Markup:
    """Draw the states of a run in the order in which they were entered, and the transitions between them."""
    names = [str(entry["state"]) for entry in states]
    places = {name: _MARGIN + _STEP * i for i, name in enumerate(dict.fromkeys(names))}
    edges = Counter(pairwise(names))
    rise = max((_reach(a, b, places) for a, b in edges if places[b] > places[a]), default=0.0)
    fall = max((_reach(a, b, places) for a, b in edges if places[b] <= places[a]), default=0.0)
    middle = _MARGIN + rise + _TALL / 2 + 12
    width = 2 * _MARGIN + _STEP * len(places) - (_STEP - _WIDE)
    height = middle + _TALL / 2 + 20 + max(fall + 14, 14) + _MARGIN
    parts = [_arc(a, b, count, places, middle) for (a, b), count in edges.items()]
    parts += [
        _box(name, x, middle, names.count(name), _seconds_in(name, states)) for name, x in places.items()
    ]
    return Markup(  # noqa: S704 - the names were escaped
        f'<svg class="walk" role="img" aria-label="States of the run" viewBox="0 0 {width:g} {height:g}" '
        f'style="max-width:{1.15 * width:.0f}px" xmlns="http://www.w3.org/2000/svg">'
        '<defs><marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="6" markerHeight="6" '
        'orient="auto-start-reverse"><path d="M0 0 8 4 0 8z"/></marker></defs>' + "".join(parts) + "</svg>"
    )


def _seconds_in(name: str, states: Sequence[StateEntered]) -> float | None:
    """Return the time spent in a state, s; None if the run ended in it."""
    moments = [datetime.fromisoformat(str(entry["utc"])) for entry in states]
    spans = [
        (later - earlier).total_seconds()
        for entry, earlier, later in zip(states, moments, moments[1:], strict=False)
        if entry["state"] == name
    ]
    return sum(spans) if spans else None


def _reach(a: str, b: str, places: Mapping[str, float]) -> float:
    """Return the height of an arrow: larger if it passes more boxes, 0 from a box to its right neighbour."""
    boxes = round((places[b] - places[a]) / _STEP)
    return 0.0 if boxes == 1 else 16.0 + 9.0 * abs(boxes)


def _arc(a: str, b: str, count: int, places: Mapping[str, float], middle: float) -> str:
    reach = _reach(a, b, places)
    label = f"{_TIMES}{count}" if count > 1 else ""
    if reach == 0.0:
        x0, x1 = places[a] + _WIDE, places[b]
        text = f'<text class="count" x="{(x0 + x1) / 2:g}" y="{middle - _TALL / 2 - 4:g}">{label}</text>'
        return f'<path class="edge" marker-end="url(#tip)" d="M{x0:g} {middle:g}H{x1:g}"/>{text}'
    forward = places[b] > places[a]
    side = -1.0 if forward else 1.0
    y = middle + side * _TALL / 2 + (0.0 if forward else 20.0)
    x0 = places[a] + _WIDE / 2 + (8 if forward else -8)
    x1 = places[b] + _WIDE / 2 + (-8 if forward else 8)
    top = y + side * reach * 4 / 3
    beyond = y + side * reach + (-4 if forward else 11)
    text = f'<text class="count" x="{(x0 + x1) / 2:g}" y="{beyond:g}">{label}</text>'
    curve = f"M{x0:g} {y:g}C{x0:g} {top:g} {x1:g} {top:g} {x1:g} {y:g}"
    return f'<path class="edge" marker-end="url(#tip)" d="{curve}"/>{text}'


def _box(name: str, x: float, middle: float, entered: int, seconds: float | None) -> str:
    notes = [f"{_TIMES}{entered}"] if entered > 1 else []
    notes += [duration(seconds)] if seconds is not None else []
    centre = x + _WIDE / 2
    return (
        f'<rect class="state" x="{x:g}" y="{middle - _TALL / 2:g}" width="{_WIDE:g}" height="{_TALL:g}" rx="5"/>'
        f'<text class="name" x="{centre:g}" y="{middle + 4:g}">{escape(name)}</text>'
        f'<text class="note" x="{centre:g}" y="{middle + _TALL / 2 + 14:g}">{", ".join(notes)}</text>'
    )
