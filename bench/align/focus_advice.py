"""What the operator should do with the focus ring: the turn as data, and the sentence about it."""

from __future__ import annotations

from typing import Final, Literal, NamedTuple

from bench.align.focus import FocusFigures
from bench.align.live_image import LiveSetting
from bench.align.seen import SHARP_PX, Seen

_FAR_PX: Final = 3.5
"""Edge width from which it is only a rough one, and the coarse detail shows the way, px."""
_WORSE: Final = 1.2
"""Ratio to the best edge width seen from which the best is told."""
_FLAT_CONTRAST, _FLAT_DETAIL = 0.3, 0.22
"""Contrast and sharpness below which bright light hides the pattern of a lens far out of focus."""
_UNSEEN_S: Final = 3.0
"""Time after which a turn of the ring must have been seen, s: a search for stars takes 2 s on a slow computer."""


class RingTurn(NamedTuple):
    """A turn of the focus ring that is asked for."""

    # ``on`` and ``back`` are told from the last turn; ``other`` is away from the ring's stop; ``either`` is the first
    # turn; ``wait`` while the ring turns.
    way: Literal["on", "back", "other", "either", "wait"]
    times: float | None = None  # How far, in units of the last turn; None if that is not known


class FocusAdvice(NamedTuple):
    """What to do about the focus."""

    text: str
    ring: RingTurn | None  # None if something else comes first, such as more light


WAIT: Final = FocusAdvice("The focus changes. Advice comes when the ring rests.", RingTurn("wait"))


def flat_advice(seen: Seen, setting: LiveSetting) -> FocusAdvice | None:
    """Return what to do if bright light hides the pattern of a lens far out of focus; else None."""
    if seen.count or seen.tag_seen or seen.contrast is None:
        return None
    if seen.contrast > _FLAT_CONTRAST or (seen.focus.sharpness or 0.0) > _FLAT_DETAIL:
        return None
    reason = (
        f"{seen.square_text}, but no stars were found: the lens is probably out of focus."
        if seen.turn.square_borders is not None
        else "No stars were found, and almost no details. Either the lens is far out of focus, or the camera looks "
        "beside the target."
    )
    return _far_out(seen, setting, reason)


def focus_advice(seen: Seen, setting: LiveSetting) -> FocusAdvice | None:
    """Return what to do with the focus ring; None if the picture is sharp, or shows no reason to turn it."""
    width, best = seen.focus.edge_width_px, seen.focus.best_edge_width_px
    if width is None:
        return None if seen.count else _far_out(seen, setting, "No stars can be recognised.")
    if width > _FAR_PX and seen.is_dim(setting):
        return _far_out(seen, setting, f"Edges are about {width:.0f} px wide.")
    limit = min(setting.gates.limits.get("max_edge_width_px", SHARP_PX), SHARP_PX)
    if width <= limit:
        if seen.focus.better_before_px is None or (seen.focus.turn_on or 0.0) >= 0.0:
            return None
        return _asked(
            seen.focus,
            f"Turn the focus ring back to the best: edges are {width:.2f} px wide, and they were "
            f"{seen.focus.better_before_px:.2f} px wide before. A run accepts {limit:g} px.",
        )
    digits = 2 if width < limit + 0.05 else 1  # 1.04 px is more than the 1 px that is needed
    known = f", the best seen is {best:.{digits}f} px" if best is not None and width > _WORSE * best else ""
    goal = "" if known and best is not None and best <= limit else f"; {limit:g} px or less is needed"
    return _asked(seen.focus, f"Turn the focus ring: edges are {width:.{digits}f} px wide{known}{goal}.")


def _far_out(seen: Seen, setting: LiveSetting, reason: str) -> FocusAdvice:
    """Return what to do with lens and light far out of focus."""
    if seen.is_dim(setting):
        return FocusAdvice(
            f"{reason} Set the light's level to 100 %: far out of focus, a bright light shows best which way to turn "
            "the focus ring.",
            None,
        )
    return _asked(seen.focus, f"{reason} Turn the focus ring{_detail_text(seen)}.")


def _detail_text(seen: Seen) -> str:
    """Return which figure must grow while nothing can be recognised: the coarse detail has a slope farthest out."""
    now, best = seen.focus.coarse_detail, seen.focus.best_coarse_detail
    if now is None:
        return ""
    better = f" (the best seen is {best:.3f})" if best is not None and best > 1.05 * now else ""
    return f": the coarse detail, now {now:.3f}{better}, must grow"


def _asked(focus: FocusFigures, text: str) -> FocusAdvice:
    """Add to a sentence which way to turn the ring, and how far; while it turns, only wait."""
    if focus.turning:
        return WAIT
    turn, way = _way(focus)
    unseen = focus.unchanged_s is not None and focus.unchanged_s >= _UNSEEN_S and not focus.at_stop
    hint = (
        " If you have turned it since, the turn was too small to be seen: turn on, twice as far. At the stop of the"
        " ring, press Stop reached."
    )
    return FocusAdvice(f"{text}{way}{hint if unseen else ''}", turn)


def _way(focus: FocusFigures) -> tuple[RingTurn, str]:
    """Return the next turn of the ring, and a sentence on it; empty before the first turn."""
    turn_on = focus.turn_on
    if focus.at_stop:
        if turn_on is None:
            return RingTurn("other"), " The ring is at its stop: turn it the other way."
        return RingTurn("other", abs(turn_on)), (
            f" The ring is at its stop: turn back by about {abs(turn_on):.1f} times the last turn."
        )
    if not focus.trend or turn_on is None:
        return RingTurn("either"), ""
    by = f"by about {abs(turn_on):.1f} times the last turn"
    if turn_on > 0.0:
        return RingTurn("on", turn_on), f" This is the right way: turn on {by}."
    is_past = focus.trend == "better" or turn_on > -1.0
    reason = "You have passed the best place" if is_past else "This is the wrong way"
    return RingTurn("back", -turn_on), f" {reason}: turn back {by}."
