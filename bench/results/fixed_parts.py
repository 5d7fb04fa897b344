"""The parts of the expanded uncertainties that further poses do not lower, from the uncertainty budget.

Plans and decisions of an ``until`` use them. The module loads nothing that measures images, so that a plan is quick.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from calib.model.budget_row import (
    COMMON_FIELD,
    GIMBAL_SCALE,
    PARALLAX,
    READINGS,
    UNBOUNDED_PARALLAX,
    WORST_CORNER,
    BudgetRow,
)
from calib.studies.planning import REDUCED_BY_POSES

REDUCED_SLOWLY = frozenset({PARALLAX, UNBOUNDED_PARALLAX, GIMBAL_SCALE, COMMON_FIELD})
"""Sources that the stars of further poses lower too, by what they say of the same quantity."""

_QUANTITIES = {"expanded_fx_px": "fx", "worst_corner_px": WORST_CORNER}
"""Column of the budget for each goal."""
SMALLEST_COVERAGE_FACTOR = 2.0
"""The k of the expanded uncertainty if many poses determine it."""


def fixed_parts(rows: Sequence[BudgetRow], more: float = 1.0) -> dict[str, dict[str, float]]:
    """Return the parts of the expanded uncertainties that further poses do not lower, by source.

    They are expanded by k = 2. What competes with the stars or the readings for the focal length counts as far as it
    would remain after all poses: with q, the ratio of the variances of these rows and of those that poses lower, the
    information of `more` times as many poses leaves (1 + q) / (`more` + q) of it (own derivation for one parameter: a
    prior of information b contributes sqrt(b) / (a + b) if the poses have the information a). A passport competes with
    readings only.

    more: How many times as many poses can be recorded in all, at least 1.
    Returns: Expanded uncertainty, px, by the name of the goal and by source; only sources that contribute.
    """
    found: dict[str, dict[str, float]] = {}
    for goal, quantity in _QUANTITIES.items():
        parts = {row.name: row.contribution.get(quantity, 0.0) for row in rows}
        kept = {name: part for name, part in parts.items() if name not in REDUCED_BY_POSES and part > 0}
        slow = kept if parts.get(READINGS, 0.0) > 0 else kept.keys() & REDUCED_SLOWLY
        left = _remaining(sum(kept[name] ** 2 for name in slow), _of_poses(parts), more)
        found[goal] = {
            name: SMALLEST_COVERAGE_FACTOR * (left if name in slow else 1.0) * part
            for name, part in kept.items()
        }
    return found


def _of_poses(parts: Mapping[str, float]) -> float:
    """Return the variance of the rows that further poses lower."""
    return sum(part**2 for name, part in parts.items() if name in REDUCED_BY_POSES)


def _remaining(beforehand: float, poses: float, more: float) -> float:
    """Return the share that remains of a variance that is known beforehand, beside that of the poses."""
    return 1.0 if poses <= 0 else (1.0 + beforehand / poses) / (more + beforehand / poses)
