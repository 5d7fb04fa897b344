"""The picture of a batch: the time of each run."""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import datetime, timedelta, tzinfo
from textwrap import shorten

from bench.record.summaries import ItemData
from bench.report.svg_plot import MUTED, Key, Picture, Words, axes_in
from bench.report.svg_scale import Scale

_WIDTH = 835.0
"""Width of the picture, points."""
_MOST_TICKS = 8  # Their labels do not meet at the width of the plot
# From a minute to a day, as clocks divide.
_STEPS_H = (1 / 60, 1 / 30, 1 / 12, 1 / 6, 0.25, 0.5, 1, 2, 3, 6, 12, 24)
_BEFORE = 0.02
"""Share of the time span by which an axis may begin earlier, to show a round time of day."""
END_COLOURS = {
    "finished": "#0072b2",
    "failed": "#d55e00",
    "died": "#d55e00",
    "hung": "#d55e00",
    "aborted": "#e69f00",
    "cut off": "#e69f00",
}
"""Colour of a run's bar for each outcome."""


def timeline(items: Sequence[ItemData], zone: tzinfo | None) -> str:
    """Draw when each run of summary.json was in progress, one row for each job; zone None is this computer's."""
    bars = [
        (
            item["job"],
            datetime.fromisoformat(attempt["begun_utc"]),
            datetime.fromisoformat(attempt["ended_utc"]),
            attempt["how"],
        )
        for item in items
        for attempt in item["tries"]
    ]
    if not bars:
        return ""
    jobs = list(dict.fromkeys(job for job, *_ in bars))
    shown_jobs = [shorten(job, 34, placeholder="\N{HORIZONTAL ELLIPSIS}") for job in jobs]
    first, last = min(begun for _, begun, _, _ in bars), max(ended for _, _, ended, _ in bars)
    span_h = max(_hours(last, first), 1 / 3600)
    ends = [how for *_, how in bars]
    shown = [how for how in END_COLOURS if how in ends]
    words = Words((), "", "", [Key(how, END_COLOURS[how], "box") for how in shown])
    counts = [f"{ends.count(how)} {how}" for how in shown]
    picture = Picture(
        _WIDTH, 46.0 + 20.0 * len(jobs), "timeline", "Time of each run", ", ".join(counts) + "."
    )
    across = Scale(-_BEFORE * span_h, (1 + _BEFORE) * span_h, ticks=_clock(first.astimezone(zone), span_h))
    rows = Scale(len(jobs) - 0.4, -0.6, ticks=list(enumerate(shown_jobs)))
    axes = axes_in(picture, across, rows, words, grid="x")
    for job, begun, ended, how in bars:
        begin, row = _hours(begun, first), jobs.index(job)
        end = begin + max(_hours(ended, begun), span_h / 500)
        axes.rectangle((begin, end), (row - 0.31, row + 0.31), END_COLOURS.get(how, MUTED))
    return picture.svg()


def _hours(moment: datetime, begin: datetime) -> float:
    return (moment - begin).total_seconds() / 3600.0


def _clock(begin: datetime, last_h: float) -> list[tuple[float, str]]:
    """Return the ticks of an axis of hours after a local time, labelled with times of day."""
    step_h = next((s for s in _STEPS_H if last_h / s <= _MOST_TICKS), 48.0)
    midnight = begin.replace(hour=0, minute=0, second=0, microsecond=0)
    since_h = _hours(begin, midnight)
    number = math.ceil((since_h - _BEFORE * last_h) / step_h)
    hours = []
    while number * step_h - since_h <= last_h + 1e-9:
        hours.append(number * step_h - since_h)
        number += 1
    return [(h, f"{begin + timedelta(hours=h, seconds=30):%H:%M}") for h in hours or [0.0]]
