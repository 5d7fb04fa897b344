"""The parts of the expanded uncertainties that further poses do not lower, from the uncertainty budget.

Plans and decisions of an ``until`` use them. The module loads nothing that measures images, so that a plan is quick.
"""

from __future__ import annotations

from collections.abc import Sequence

from calib.model.budget_row import WORST_CORNER, BudgetRow
from calib.model.type_b_terms import UNITS
from calib.studies.planning import REDUCED_BY_POSES
from calib.uncertainty.budget_parts import GIMBAL_SCALE, PARALLAX_BOUND

REDUCED_SLOWLY = frozenset({PARALLAX_BOUND, GIMBAL_SCALE})
"""Sources that further poses lower only if the stars determine the focal length without the gimbal's readings."""
_QUANTITIES = {"expanded_fx_px": "fx", "worst_corner_px": WORST_CORNER}
"""Column of the budget for each goal."""
SMALLEST_COVERAGE_FACTOR = 2.0
"""The k of the expanded uncertainty if many poses determine it."""


def fixed_parts(rows: Sequence[BudgetRow], more: float = 1.0) -> dict[str, dict[str, float]]:
    """Return the parts of the expanded uncertainties that further poses do not lower, by source.

    They are expanded by k = 2, the smallest coverage factor, because further poses also lower k. Parallax and scale of
    the gimbal count as far as they would remain after all poses: with q, the ratio of the variances of this source and
    of the stars, the information of `more` times as many poses leaves (1 + q) / (`more` + q) of it (own derivation for
    one parameter: a prior of information b contributes sqrt(b) / (a + b) if the stars have the information a).

    more: How many times as many poses can be recorded in all, at least 1.
    Returns: Expanded uncertainty, px, by the name of the goal and by source; only sources that contribute.
    """
    found: dict[str, dict[str, float]] = {}
    for goal, quantity in _QUANTITIES.items():
        parts = {row.name: row.contribution.get(quantity, 0.0) for row in rows}
        free = {row.name for row in rows if _is_reduced(row)}
        stars = sum(parts[name] ** 2 for name in free)
        found[goal] = {
            name: SMALLEST_COVERAGE_FACTOR
            * (_remaining(part, stars, more) if name in REDUCED_SLOWLY else part)
            for name, part in parts.items()
            if name not in free and part > 0
        }
    return found


def _is_reduced(row: BudgetRow) -> bool:
    """Return whether further poses lower a source; a wavefront differs over the target, so they may."""
    return row.name in REDUCED_BY_POSES or row.unit == UNITS["wavefront"]


def _remaining(part: float, stars: float, more: float) -> float:
    """Return what remains of a part whose variance is compared with that of the stars."""
    if stars <= 0:
        return part
    ratio = part**2 / stars
    return part * (1.0 + ratio) / (more + ratio)
