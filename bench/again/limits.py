"""How far numbers may differ from those made again: by a tenth of U, as a statistic, or not at all."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from bench.record.coverage import coverage_factor

# A value may differ by this part of its expanded uncertainty: ten times less than what anybody may rely on.
MOST_OF_U = 0.1
# An uncertainty or a statistic may differ by this share of itself: U is stated with two digits. On other processors
# (OpenBLAS and numba for Nehalem, Haswell and SkylakeX, 1 and 2 threads), shares in the budget of three poses differ
# by 3.5 %, uncertainties by 1 %, values by .007 U.
MOST_SHARE = 0.05
# Share by which times of triggers may differ (they do by 2e-10 on other processors); and of the largest number of a
# list, its small ones: what cancels leaves the rounding.
ROUNDING = 1e-6
CANCELLED = 1e-9  # Numbers of this size are 0
# Places of results.json that are calculated; all else is copied from journal and documents.
_OF_STARS = r"(calibration|projection|halves|gimbal|parallax|mount_faces|check|comparison|conformity)\b"
_IN_RESULTS = re.compile(_OF_STARS + r"|previous\.change|poses\[\d+\]\.(rms|mean)_px|gates\[\d+\]\.value")
_WITH_U = re.compile(_OF_STARS + r"|gates|gimbal_readings|previous$")
# Of the journal: all else is counted, or the time of a trigger.
_OF_PIXELS = re.compile(r".*(measured\.(grid|motion_px|edge_width_px)|gates\[\d+\]\.value)")
_DEGREE = math.radians(1)
# Values by what stands beside them: an uncertainty, with U in that; or 0, of what is stated in the unit of an unknown.
_BESIDE = {
    ("sigma", 2.0): ("value", "values", "error"),
    ("scale_sigma", 2.0): ("scale",),
    ("expected_sigma", 2.0): ("expected",),
    ("expanded", 1.0): ("value",),
    ("expanded_px", 1.0): ("offset_px",),
    ("expanded_deg", 1.0): ("angle_deg", "vector_deg"),
    ("expanded_deg", _DEGREE): ("normal_in_camera", "camera_from_flange"),
    ("sight_expanded_deg", 1.0): ("right_down_deg",),
    ("sight_expanded_deg", _DEGREE): ("sight",),
    ("expected_sigma", 0.0): ("stated", "sigma"),
    ("log_sigma", 0.0): ("expected",),
    ("divisor", 0.0): ("value", "divisor"),
    ("parallax_sigma", 0.0): ("parallax", "parallax_sigma"),
    ("pose", 0.0): ("value",),  # of a gate in the journal
}
_COPIED = ("lower", "upper", "truth", "stated_mm", "defocus")
_BY_NAME = dict.fromkeys(_COPIED, 0.0) | dict.fromkeys(("innovation", "error_sigmas"), 2 * MOST_OF_U)
_LENGTHS = {"fx": "fx", "cx": "fx", "cy": "fy", "r": "r", "x": "r", "y": "r"}


@dataclass(frozen=True)
class Rules:
    """How far numbers may differ: a limit by name or by the U beside it, `MOST_SHARE` if calculated, or ``rest``."""

    calculated: re.Pattern[str] = re.compile(r"(?!)")
    rest: float = 0.0  # Share
    own: Mapping[str, Any] = field(default_factory=dict)  # Limits by name: a number, or the form of the value
    converted: float = 0.0  # Share of what is stated in the unit of an unknown
    least: float = CANCELLED  # By as much, what is calculated may always differ

    def inside(self, where: str, name: str, held: Mapping[str, Any], limit: Any) -> Any:
        """Return the limit of what a mapping holds under a name, None for the usual one; ``limit`` is the mapping's."""
        if limit is not None or not _WITH_U.match(where):
            return limit.get(name) if isinstance(limit, Mapping) else limit
        if name in self.own:
            return self.own[name]
        for (beside, k), names in _BESIDE.items():
            if name in names and (u := held.get(beside)) is not None:
                return _times(MOST_OF_U * k, u) if k else self.converted * abs(held[name] or 0.0)
        return None

    def same(self, stored: Any, derived: Any, where: str, limit: Any, scale: float) -> bool:
        """Return whether two values agree; ``scale`` is the largest number of the list in which they stand."""
        if not (isinstance(stored, float) and isinstance(derived, float) and math.isfinite(stored)):
            return bool(stored == derived) and isinstance(stored, bool) == isinstance(derived, bool)
        size = max(abs(stored), abs(derived))
        share = max(MOST_SHARE * size, ROUNDING * scale, self.least)
        usual = share if self.calculated.match(where) else self.rest * size
        return abs(stored - derived) <= max(usual if limit is None else limit, CANCELLED)


EXACT = Rules()
# On other processors, a motion differs by 1e-4 px, which may be more than a twentieth of it.
OF_RECORDING = Rules(_OF_PIXELS, ROUNDING, least=0.001)


def rules_of_results(results: Mapping[str, Any]) -> Rules:
    """Return how far the numbers of results.json may differ from those of results made again."""
    calibration = results["calibration"]
    placed, sigmas = {**calibration["camera"], **(calibration["collimator"] or {})}, calibration["sigma"]
    most = {name: MOST_OF_U * coverage_factor(calibration, name) * sigmas[name] for name in sigmas}
    over = {name: most.get(name, 0.0) / abs(placed.get(of) or math.inf) for name, of in _LENGTHS.items()}
    # Of a length, and of what is stated in its unit: a parallax differs by 3e-6 of itself on other processors.
    share = max(over["fx"], over["r"])
    # Of a direction, rad: as the principal point and the middle of the pattern may lie beside.
    turn = math.hypot(*(over[name] for name in ("cx", "cy", "x", "y")))
    far = max((math.hypot(*view.get("centre_mm", ())) for view in calibration["views"]), default=0.0)
    values = {name: most.get(name, share * abs(at)) for name, at in placed.items() if isinstance(at, float)}
    centre = [values[name] for name in "xyr"] if calibration["collimator"] else (turn + share) * far
    own = {"camera": values, "collimator": values, "rotation": max(turn, ROUNDING), "centre_mm": centre}
    if projection := results.get("projection"):  # A change since the last run may be far smaller than U
        corner = MOST_OF_U * projection["worst_corner"]["expanded_px"]
        change = dict.fromkeys(("rms_px", "largest_px", "px_there"), corner) | {"largest_ratio": MOST_OF_U}
        own["change"] = change | {"at_px": math.inf}  # Several places can be alike
    return Rules(_IN_RESULTS, 0.0, {**_BY_NAME, **own}, share)


def _times(factor: float, u: Any) -> Any:
    if isinstance(u, Mapping):
        return {name: factor * part for name, part in u.items()}
    return factor * (max(u) if isinstance(u, list) else u)
