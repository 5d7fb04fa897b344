"""An ``until`` in words: its goals, what it has reached, and how it ended."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

_MEANINGS = {"expanded_fx_px": "U(fx)", "worst_corner_px": "U at the corners"}


def meaning_of_goal(name: str) -> str:
    """Return a goal as people read it.

    name: Name of the goal: ``expanded_fx_px`` or ``worst_corner_px``.
    """
    return _MEANINGS.get(name, name)


def goals_text(wanted: Mapping[str, float]) -> str:
    """Return goals as text.

    wanted: Largest expanded uncertainties allowed, px, by name.
    Returns: For example ``U(fx) is at most 2 px``.

    Examples
    --------
    >>> goals_text({"expanded_fx_px": 2.0, "worst_corner_px": 0.3})
    'U(fx) is at most 2 px and U at the corners at most 0.3 px'
    """
    parts = [f"{meaning_of_goal(name)} at most {goal:.3g} px" for name, goal in wanted.items()]
    return " and ".join(parts).replace(" at most", " is at most", 1)


def reached_text(decided: Mapping[str, Any]) -> str:
    """Return what an ``until`` has reached.

    decided: Payload of the journal line ``until_decided``.
    Returns: For example ``4 poses (k = 2.2): U(fx) 3.1 px (wanted 2)``.
    """
    now = decided["now"]
    poses = f"{decided['poses']} pose{'' if decided['poses'] == 1 else 's'}"
    if now and decided.get("coverage_factor"):
        poses += f" (k = {decided['coverage_factor']:.3g})"
    if not now:
        return f"{poses}: no calibration yet. {decided.get('problem', '')}".strip()
    parts = [
        f"{meaning_of_goal(name)} {now[name]:.3g} px (wanted {goal:.3g})"
        for name, goal in decided["wanted"].items()
    ]
    return f"{poses}: {', '.join(parts)}"


def decision_text(decided: Mapping[str, Any]) -> str:
    """Return a decision of an ``until`` as one line.

    decided: Payload of the journal line ``until_decided``.
    """
    reached = reached_text(decided)
    chosen = decided.get("chosen")
    if chosen is None:
        return f"{reached}. {decided.get('why', '')}".strip()
    angles = ", ".join(f"{axis} {angle:g}" for axis, angle in chosen["angles_deg"].items())
    return f"{reached}; next: pose {chosen['pose']} at {angles} deg"
