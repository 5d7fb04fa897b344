"""The unit of the target positions: millimetres, or metres, micrometres or inches by mistake.

A wrong unit scales the collimator's radius, and nothing else: the camera is the same, and no residual changes. So views
alone decide only when the numbers are implausible. A known radius decides.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.model.closed_forms import linear_solution
from calib.model.homography import neighbours_of, view_homography
from calib.view import View

#: Millimetres in units that are taken for millimetres by mistake.
_UNITS = {"metres": 1000.0, "centimetres": 10.0, "inches": 25.4, "micrometres": 0.001}
#: Pitches and radii outside of these ranges are implausible, mm.
PLAUSIBLE_PITCH_MM = (0.05, 500.0)
PLAUSIBLE_R_MM = (5.0, 50_000.0)
#: A ratio of radii names a unit if it is within this factor of it. A closed-form radius is known to some 20 per cent.
_TOLERANCE = 1.5


@dataclass(frozen=True)
class TargetUnits:
    """A doubt about the unit of the target positions."""

    unit: str  # The unit that the positions probably have; empty if none fits
    why: str  # What is implausible, a sentence

    @property
    def sentence(self) -> str:
        """Says what is implausible, and which unit would explain it."""
        if not self.unit:
            return f"{self.why} Check that the target positions are in mm."
        return f"{self.why} The target positions look like {self.unit}; give them in mm."


def check_target_units(views: Sequence[View], *, known_r_mm: float | None = None) -> TargetUnits | None:
    """Look for a wrong unit of the target positions; None if nothing is implausible, which is no proof of the unit.

    ``known_r_mm`` is from a passport, a certificate or a data sheet, and is compared with a closed form; without it,
    only implausible numbers count.
    """
    r_mm = None if known_r_mm is None else closed_form_radius(views)
    if r_mm is not None and known_r_mm is not None:
        unit = _unit(known_r_mm / r_mm)
        if unit:
            why = f"The views give a collimator radius of {r_mm:.3g} mm, and {known_r_mm:.3g} mm is known."
            return TargetUnits(unit, why)
    pitch = min(neighbours_of(view).spacing for view in views)
    if not PLAUSIBLE_PITCH_MM[0] <= pitch <= PLAUSIBLE_PITCH_MM[1]:
        why = f"Neighbouring stars of the target are {pitch:.3g} mm apart, which is implausible."
        return TargetUnits("metres" if pitch < 1.0 else "micrometres", why)
    if r_mm is not None and not PLAUSIBLE_R_MM[0] <= r_mm <= PLAUSIBLE_R_MM[1]:
        why = f"The views give a collimator radius of {r_mm:.3g} mm, which is implausible."
        return TargetUnits("metres" if r_mm < 1.0 else "micrometres" if r_mm > 1e5 else "", why)
    return None


def closed_form_radius(views: Sequence[View]) -> float | None:
    """Return the collimator's radius, mm (arXiv:2512.16092, eq. 5); None if it is not real, as of one view."""
    h = np.array([view_homography(view) for view in views])
    for free in (True, False):
        solution = linear_solution(h, views[0].image_size, free_principal_point=free)
        if solution is not None:
            return solution.collimator.r
    return None


def _unit(ratio: float) -> str:
    """Return the unit whose length in mm is within a factor of a ratio; empty if none is."""
    near = {name: abs(np.log(ratio / length)) for name, length in _UNITS.items()}
    name = min(near, key=lambda unit: near[unit])
    return name if near[name] < np.log(_TOLERANCE) else ""
