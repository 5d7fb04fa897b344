"""What a live picture shows, row by row, with what a run expects beside it.

The limits are those by which a run judges its recordings.
"""

from __future__ import annotations

import math
from collections import Counter, defaultdict, deque
from collections.abc import Iterator, Sequence
from typing import Final, Literal, NamedTuple

from bench.extras.pages.align.live_figures import LiveFigures
from bench.extras.pages.align.live_image import LiveSetting
from bench.extras.pages.align.where_to_turn import CENTRED_DEG, CENTRED_PX, LEAST_ROLL_DEG
from bench.measure.gates import FREQUENCY_TOLERANCE
from bench.measure.measure_frames import MOST_SATURATED

SHARP_PX: Final = 1.0
"""Edge width below which the lens counts as focused; up to 1.3 px every star is found."""
# A flickering pattern gives as many ON as OFF events; outside, one bias is far off.
_ON_SHARES_PERCENT: Final = (25.0, 75.0)
_LEAST_EVENTS_AN_EDGE: Final = 0.8
"""Events of a lit pixel at an edge of the light, below which stars are located less well. The simulated bench has 0.94
at full level in the dark, 0.77 at a level of 20 %, and 0.76 and 0.67 with light of the room of 0.2 and 0.6."""
_LEAST_LIT_PERCENT: Final = 60.0  # Below it, most of the frame shows no star
_LEAST_CONTRAST_PERCENT: Final = 30.0  # Below it, no pattern is visible

_AGREEING: Final = 15
"""Pictures, some seconds, that must all agree before a verdict changes: where half of them lie beyond a limit, chance
alone changes it less than once in an hour."""

Group = Literal["signal", "focus", "turn"]


class FigureRow(NamedTuple):
    """A figure as the page shows it."""

    name: str
    value: str  # With its digits; empty if it was not measured
    unit: str = ""
    expected: str = ""  # What a run expects; empty if it expects nothing
    good: bool | None = None  # Whether the value is as expected; None if it is not judged
    group: Group = "signal"


class SteadyVerdicts:
    """Verdicts that stand while nobody touches anything, though a figure may lie at its limit.

    The first pictures give most of them; then all of as many pictures must disagree.
    """

    def __init__(self) -> None:
        self._recent: defaultdict[str, deque[bool | None]] = defaultdict(lambda: deque(maxlen=_AGREEING))
        self._shown: dict[str, bool | None] = {}

    def steady(self, rows: Sequence[FigureRow]) -> list[FigureRow]:
        """Return the rows of the next picture with the verdicts to show."""
        return [row._replace(good=self._verdict(row.name, row.good)) for row in rows]

    def _verdict(self, name: str, now: bool | None) -> bool | None:
        recent = self._recent[name]
        recent.append(now)
        if len(recent) < _AGREEING or recent.count(now) == _AGREEING:
            self._shown[name] = Counter(recent).most_common(1)[0][0]
        return self._shown[name]


def figure_rows(figures: LiveFigures, setting: LiveSetting, best_px: float | None = None) -> list[FigureRow]:
    """Return all rows of a picture; ``best_px`` is the best edge width so far."""
    dark = setting.light_on is False
    picture = "; ".join(figures.recording_faults) or (
        "dark" if dark else "turning" if figures.moving else "whole"
    )
    seen = [
        *_signal(figures, setting),
        *(row._replace(group="focus") for row in _focus(figures, setting, best_px)),
        *(row._replace(group="turn") for row in _turn(figures)),
    ]
    # What a picture lacks while it is dark, or while the stage turns, is no fault of its own.
    if figures.moving or dark:
        seen = [row._replace(good=None) for row in seen]
    return [FigureRow("Picture", picture, expected="whole", good=picture == "whole"), *seen]


def _signal(figures: LiveFigures, setting: LiveSetting) -> Iterator[FigureRow]:
    """Yield the stars and what they are seen by."""
    yield _ranged("Stars", len(figures.stars), 0, low=setting.gates.min_stars)
    known = figures.turn.of == "tag"  # read, or known by the stars around it
    tag = figures.other_tag or ("found" if known else "not found")
    yield FigureRow(f"Tag {setting.target.tag_id}", tag, "", "found", known and not figures.other_tag)
    yield _ranged("Contrast", _percent(figures.contrast), 0, "%", low=_LEAST_CONTRAST_PERCENT)
    if setting.camera == "frame":
        yield _ranged("Saturated", _percent(figures.saturation), 1, "%", high=100.0 * MOST_SATURATED)
    else:
        yield from _events(figures, setting)
        yield from _sync(figures, setting)


def _events(figures: LiveFigures, setting: LiveSetting) -> Iterator[FigureRow]:
    """Yield rates and shares of the events."""
    signal, gates = figures.signal, setting.gates
    rate_mev_s = None if signal.events_per_s is None else signal.events_per_s / 1e6
    yield _ranged("Event rate", rate_mev_s, 1, "Mev/s", high=gates.max_event_rate_mev_s)
    yield _ranged("Events an edge", _events_an_edge(figures, setting), 2, low=_LEAST_EVENTS_AN_EDGE)
    dropped = gates.limits.get("max_rate_controller_loss_percent")
    yield _ranged("Dropped events", _percent(figures.saturation), 1, "%", high=dropped)
    low, high = _ON_SHARES_PERCENT
    yield _ranged("ON share", _percent(signal.on_share), 0, "%", low=low, high=high)


def _events_an_edge(figures: LiveFigures, setting: LiveSetting) -> float | None:
    """Return the events of a pixel in the beam at an edge of the light; None without a flicker or without light."""
    lit_pixels = (figures.beam_share or 0.0) * figures.width_px * figures.height_px
    if not lit_pixels or not setting.frequency_hz or figures.signal.events_per_s is None:
        return None
    return figures.signal.events_per_s / (2.0 * setting.frequency_hz * lit_pixels)


def _sync(figures: LiveFigures, setting: LiveSetting) -> Iterator[FigureRow]:
    """Yield the sync edges, and the flicker by them."""
    signal, gates, wanted_hz = figures.signal, setting.gates, setting.frequency_hz
    missed = signal.triggers_expected - signal.triggers
    edges = signal.sync_fault or ("there" if signal.sync_edges else "none")
    if edges == "there" and missed > gates.limits.get("max_triggers_missed", 1):
        edges = f"{missed} of {signal.triggers_expected} are missing"
    needed = "there" if gates.require_triggers else ""
    yield FigureRow("Sync edges", edges, "", needed, edges == "there" or (edges == "none" and not needed))
    measured_hz = signal.trigger_hz
    row = _ranged("Flicker", measured_hz, 2, "Hz")
    if wanted_hz:
        off = None if measured_hz is None else abs(measured_hz / wanted_hz - 1.0)
        good = None if off is None else off <= FREQUENCY_TOLERANCE["triggers"]
        row = row._replace(expected=f"{wanted_hz:.2f}", good=good)
    yield row
    jitter_limit = gates.limits.get("max_trigger_jitter_us")
    yield _ranged("Jitter of the sync", signal.jitter_us, 1, "µs", high=jitter_limit)


def _focus(figures: LiveFigures, setting: LiveSetting, best_px: float | None) -> Iterator[FigureRow]:
    """Yield the edge width, the best one, and how far the present one is from it."""
    width = figures.edge_width_px
    limit = min(setting.gates.limits.get("max_edge_width_px", SHARP_PX), SHARP_PX)
    row = _ranged("Edge width", width, 2, "px", high=limit)
    # Where a tag or stars are missing from a lit picture, the lens may be out of focus.
    yield row._replace(good=False) if width is None else row
    yield _ranged("Best so far", best_px, 2, "px")
    above = None if width is None or best_px is None else max(0.0, width - best_px)
    yield _ranged("Above the best", above, 2, "px")


def _turn(figures: LiveFigures) -> Iterator[FigureRow]:
    """Yield where to turn."""
    turn = figures.turn
    in_px = turn.unit == "px"
    names = ("It must move right by", "It must move up by") if in_px else ("Turn pan by", "Turn tilt by")
    near = f"within {CENTRED_PX:g} px" if in_px else f"within {CENTRED_DEG:g}°"
    for name, by in zip(names, (turn.pan, turn.tilt), strict=True):
        digits = 0 if in_px or turn.of == "beam" else 1
        text = "" if by is None else f"{round(by, digits) + 0.0:+.{digits}f}"  # no -0.0
        yield FigureRow(name, text, turn.unit, near, turn.centred if turn.of else None)
    roll = "" if turn.roll_deg is None else f"{turn.roll_deg:+.1f}"
    enough = None if turn.roll_deg is None else abs(turn.roll_deg) >= LEAST_ROLL_DEG
    yield FigureRow("Roll to the pixels", roll, "°", f"{LEAST_ROLL_DEG:g}° or more either way", enough)
    yield _ranged("Frame in the beam", _percent(figures.beam_share), 0, "%", low=_LEAST_LIT_PERCENT)


def _ranged(
    name: str,
    value: float | None,
    digits: int,
    unit: str = "",
    *,
    low: float | None = None,
    high: float | None = None,
) -> FigureRow:
    """Return the row of a number that is judged by its limits, if it has any."""
    expected = ""
    if low is not None and high is not None:
        expected = f"{low:g} to {high:g}"
    elif low is not None:
        expected = f"at least {low:g}"
    elif high is not None:
        expected = f"at most {high:g}"
    if value is None or not math.isfinite(value):
        return FigureRow(name, "", unit, expected)
    good = bool((low is None or value >= low) and (high is None or value <= high)) if expected else None
    return FigureRow(name, f"{value:.{digits}f}", unit, expected, good)


def _percent(share: float | None) -> float | None:
    return None if share is None else 100.0 * share
