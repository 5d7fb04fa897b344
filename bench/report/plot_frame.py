"""The frame of a plot: its place in the picture, title, legend, axes, ticks and labels. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from bench.report.svg_plot import FONT, INK, LINE, MUTED, TITLE, Axes, Picture, Scale, painted, text_width

_LINE_HEIGHT, _TICK, _SIGN_LENGTH = 12.0, 3.0, 14.0
_BETWEEN_LABELS, _BETWEEN_ROWS = 16.0, 24.0
_RIGHT = 7.0

Place = tuple[float, float, float, float]


class Key(NamedTuple):
    """An entry of a legend: its text, its colour, and its sign (``line``, ``dashed``, ``box`` or ``dot``)."""

    text: str
    colour: str
    sign: str = "line"


@dataclass(frozen=True)
class Words:
    """The words around a plot."""

    title: Sequence[str] = ()
    x: str = ""
    y: str = ""
    keys: Sequence[Key] = ()


def axes_in(
    picture: Picture,
    x: Scale,
    y: Scale,
    words: Words,
    *,
    place: Place | None = None,
    equal: str = "",
    whole: bool = False,
    grid: str = "",
    clip: bool = True,
) -> Axes:
    """Draw the frame of a plot, and return its axes.

    ``place`` is left, top, width and height with all words; None for the whole picture. ``equal`` scales: ``shrink``
    makes the plot smaller, ``extend`` the scales longer. ``grid`` is ``x``, ``y`` or ``xy``.
    """
    left, top, width, height = place or (0.0, 0.0, picture.width, picture.height)
    above = _heading(picture, words, left, top, width)
    below = (_LINE_HEIGHT if words.x else 0.0) + FONT + _TICK + 4.0
    room = height - above - below
    beside = _room_beside(y, room, words)
    if equal == "extend":  # longer numbers may need more room, which a second step gives
        beside = max(
            beside, _room_beside(_same_unit(x, y, width - beside, room, extend=True)[1], room, words)
        )
    across = width - beside - _RIGHT
    if equal:
        x, y, across, room = _same_unit(x, y, across, room, extend=equal == "extend")
    axes = Axes(
        picture, x, y, round(left + beside, 2), round(top + above, 2), round(across, 2), round(room, 2)
    )
    _draw_frame(axes, words, whole=whole, grid=grid)
    if clip:
        axes.clipped()
    return axes


def height_for(image_size: Sequence[int], width: float, words: Words) -> float:
    """Return how high a picture of a sensor is; one higher than wide is drawn narrower than the picture."""
    words_high = _LINE_HEIGHT * len(words.title) + 4.0 + 2 * _LINE_HEIGHT + FONT
    words_wide = 3.0 + _TICK + _LINE_HEIGHT + _widest([str(image_size[1])]) + _RIGHT
    across = width - words_wide
    return round(words_high + min(across * image_size[1] / image_size[0], 0.9 * across), 1)


def _heading(picture: Picture, words: Words, left: float, top: float, width: float) -> float:
    """Write title and legend; return their height."""
    at = top
    for number, line in enumerate(words.title):
        at += _LINE_HEIGHT
        colour, size = (INK, TITLE) if number == 0 else (MUTED, FONT)
        weight = 'font-weight="600"' if number == 0 else ""
        picture.text(left, at - 3.0, line, colour=colour, size=size, more=weight)
    return write_legend(picture, words.keys, left, at, width) - top + 4.0


def write_legend(picture: Picture, keys: Sequence[Key], left: float, top: float, width: float) -> float:
    """Write a legend in rows of some width, as many as it needs, and return where it ends."""
    x, foot = left, top + (_LINE_HEIGHT if keys else 0.0)
    for key in keys:
        length = _SIGN_LENGTH + 4.0 + text_width(key.text, FONT)
        if x > left and x + length > left + width:
            x, foot = left, foot + _LINE_HEIGHT
        _sign(picture, key, x, foot - 6.0)
        picture.text(x + _SIGN_LENGTH + 4.0, foot - 3.0, key.text)
        x += length + 12.0
    return foot


def _sign(picture: Picture, key: Key, x: float, y: float) -> None:
    """Draw the sign of an entry of the legend."""
    if key.sign == "box":
        picture.add(
            f'<rect x="{x:g}" y="{y - 4:g}" width="{_SIGN_LENGTH:g}" height="8" {painted("fill", key.colour)}/>'
        )
    elif key.sign == "dot":
        middle = x + _SIGN_LENGTH / 2
        picture.add(f'<circle cx="{middle:g}" cy="{y:g}" r="2.4" {painted("fill", key.colour)}/>')
    else:
        dash = ' stroke-dasharray="4 2.5"' if key.sign == "dashed" else ""
        picture.add(
            f'<path d="M{x:g} {y:g}h{_SIGN_LENGTH:g}" {painted("stroke", key.colour)} stroke-width="2"{dash}/>'
        )


def _room_beside(y: Scale, height: float, words: Words) -> float:
    """Return the room that the labels of the y axis need."""
    labels = [label for _, label in y.chosen_ticks(_most_rows(height))]
    return 4.0 + _TICK + (_LINE_HEIGHT if words.y else 0.0) + _widest(labels)


def _most_rows(height: float) -> int:
    return max(2, int(height / _BETWEEN_ROWS))


def _widest(labels: Sequence[str]) -> float:
    return max((text_width(label, FONT) for label in labels), default=0.0)


def _most_columns(x: Scale, width: float) -> int:
    """Return how many labels fit below the x axis."""
    most = max(2, int(width / 30.0))
    while most > 2:
        labels = [label for _, label in x.chosen_ticks(most)]
        if len(labels) < 2 or (_widest(labels) + _BETWEEN_LABELS) * (len(labels) - 1) <= width:
            break
        most -= 1
    return most


def _same_unit(
    x: Scale, y: Scale, width: float, height: float, *, extend: bool
) -> tuple[Scale, Scale, float, float]:
    """Give both axes the same unit, by a smaller plot or by longer scales."""
    wide, high = abs(x.high - x.low), abs(y.high - y.low)
    if not extend:
        unit = min(width / wide, height / high)
        return x, y, unit * wide, unit * high
    unit = max(wide / width, high / height)
    return _longer(x, unit * width), _longer(y, unit * height), width, height


def _longer(scale: Scale, length: float) -> Scale:
    middle, half = (scale.low + scale.high) / 2, (length if scale.high > scale.low else -length) / 2
    return replace(scale, low=middle - half, high=middle + half)


def _draw_frame(axes: Axes, words: Words, *, whole: bool, grid: str) -> None:
    """Draw the sides, the ticks and the labels."""
    picture, foot, right = axes.picture, axes.top + axes.height, axes.left + axes.width
    columns = axes.x.chosen_ticks(_most_columns(axes.x, axes.width))
    rows = axes.y.chosen_ticks(_most_rows(axes.height))
    across = [axes.left + axes.width * float(axes.x.share(value)) for value, _ in columns]
    up = [axes.top + axes.height * (1 - float(axes.y.share(value))) for value, _ in rows]
    lines = "".join(f"M{x:.2f} {axes.top:g}V{foot:g}" for x in across if "x" in grid)
    lines += "".join(f"M{axes.left:g} {y:.2f}H{right:g}" for y in up if "y" in grid)
    if lines:
        picture.add(f'<path d="{lines}" fill="none" {painted("stroke", LINE)} stroke-width="0.5"/>')
    sides = f"M{axes.left:g} {axes.top:g}V{foot:g}H{right:g}" + (f"V{axes.top:g}Z" if whole else "")
    marks = "".join(f"M{x:.2f} {foot:g}v{_TICK:g}" for x in across)
    marks += "".join(f"M{axes.left:g} {y:.2f}h-{_TICK:g}" for y in up)
    picture.add(f'<path d="{sides}{marks}" fill="none" {painted("stroke", LINE)} stroke-width="0.8"/>')
    for x, (_, label) in zip(across, columns, strict=True):
        picture.text(x, foot + _TICK + FONT, label, anchor="middle")
    for y, (_, label) in zip(up, rows, strict=True):
        picture.text(axes.left - _TICK - 2.0, y + 3.2, label, anchor="end")
    if words.x:
        picture.text(axes.left + axes.width / 2, foot + _TICK + FONT + _LINE_HEIGHT, words.x, anchor="middle")
    if words.y:
        x, y = axes.left - _TICK - 7.0 - _widest([label for _, label in rows]), axes.top + axes.height / 2
        picture.text(x, y, words.y, anchor="middle", more=f'transform="rotate(-90 {x:g} {y:g})"')
