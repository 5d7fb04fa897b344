"""What an `until` wants and has reached, in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from bench.record.events import UntilDecided


_GOALS = {"expanded_fx_px": "U(fx)", "worst_corner_px": "U at the corners"}


def meaning_of_goal(name: str) -> str:
    """Return the goal ``expanded_fx_px`` or ``worst_corner_px`` as people read it."""
    return _GOALS.get(name, name)


def goals_text(wanted: Mapping[str, float]) -> str:
    """Return goals, the largest expanded uncertainties allowed, px, by name, as text.

    >>> goals_text({"expanded_fx_px": 2.0, "worst_corner_px": 0.3})
    'U(fx) is at most 2 px and U at the corners at most 0.3 px'
    """
    parts = [f"{meaning_of_goal(name)} at most {goal:g} px" for name, goal in wanted.items()]
    return " and ".join(parts).replace(" at most", " is at most", 1)


def beside_goal(value: float, goal: float, digits: int = 3) -> str:
    """Return a value with ``digits`` digits, or with more if only these show whether it exceeds its goal.

    >>> beside_goal(3.1416, 1.45), beside_goal(1.4523, 1.45), beside_goal(1.4499, 1.45)
    ('3.14', '1.452', '1.4499')
    """
    return f"{value:.{digits_beside(value, goal, digits)}g}"


def digits_beside(value: float, goal: float, digits: int = 3) -> int:
    """Return how many digits, at least ``digits``, show on which side of its goal a value lies."""
    side = value > goal, value < goal
    enough = range(digits, 18)  # 17 digits are the number itself
    return next(n for n in enough if ((shown := float(f"{value:.{n}g}")) > goal, shown < goal) == side)


def missed_text(now: Mapping[str, float], wanted: Mapping[str, float]) -> str:
    """Return each goal that is not met, px, with what is reached; empty if all are met.

    >>> missed_text({"expanded_fx_px": 1.4523}, {"expanded_fx_px": 1.45, "worst_corner_px": 0.3})
    'U(fx) is 1.452 px; the goal is 1.45 px. U at the corners is not known; the goal is 0.3 px.'
    """
    reached = {name: f"{beside_goal(now[name], goal)} px" for name, goal in wanted.items() if name in now}
    return " ".join(
        f"{meaning_of_goal(name)} is {reached.get(name, 'not known')}; the goal is {goal:g} px."
        for name, goal in wanted.items()
        if name not in now or now[name] > goal
    )


def goals_missed(decisions: Sequence[UntilDecided]) -> list[str]:
    """Return a sentence or more for each ``until`` that ended without its goals."""
    return [
        f"The goal of a step was not met. {decided.get('why', '')}".strip()
        for decided in decisions
        if decided.get("ended", "met") != "met"
    ]


def reached_text(decided: UntilDecided) -> str:
    """Return what an ``until_decided`` has reached, as ``4 poses (k = 2.2): U(fx) 3.1 px (wanted 2).``."""
    now = decided["now"]
    if not now:
        return f"{_poses_of(decided)}: no calibration yet. {decided.get('problem', '')}".strip()
    parts = [
        f"{meaning_of_goal(name)} {beside_goal(now[name], goal)} px (wanted {goal:g})"
        for name, goal in decided["wanted"].items()
    ]
    return f"{_poses_of(decided)}: {', '.join(parts)}."


def decision_text(decided: UntilDecided) -> str:
    """Return a journal line ``until_decided`` as one line of text."""
    if decided.get("ended", "met") != "met":
        return f"{_poses_of(decided)}: {decided.get('why', '')}"
    chosen = decided.get("chosen")
    if chosen is None:
        return f"{reached_text(decided)} {decided.get('why', '')}".strip()
    angles = ", ".join(f"{axis} {angle:g}" for axis, angle in chosen["angles_deg"].items())
    return f"{reached_text(decided)} Next: pose {chosen['pose']} at {angles} deg."


def _poses_of(decided: UntilDecided) -> str:
    """Return the number of poses in a calibration, with its coverage factor if there is one."""
    k = decided.get("coverage_factor")
    factor = f" (k = {k:.3g})" if decided["now"] and k else ""
    return f"{decided['poses']} pose{'' if decided['poses'] == 1 else 's'}{factor}"
