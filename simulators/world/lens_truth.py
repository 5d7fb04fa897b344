"""True focus and aperture of the camera's lens, and the travel of its focus ring.

This module holds the numbers only; ``optics.lens_focus`` computes with them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

DELIVERED_F_NUMBER: Final = 2.8
"""f-number at which the light on the sensor has its nominal brightness."""

CLOSEST_M: Final = 0.2
"""Focus distance at the ring's near stop."""

BEYOND_M: Final = -3.3
"""Focus distance at the other stop, a little beyond infinity: rays that meet 3.3 m behind the lens are in focus."""

RING_SPAN_DEG: Final = 180.0
"""Turn of the focus ring from infinity (0) to the near stop."""

F_NUMBERS: Final = (1.0, 32.0)
"""Smallest and largest f-number."""

LARGEST_FOCAL_MM: Final = 100.0
"""Longest focal length for which the ring's travel is meant."""

LAW: Final[Mapping[str, str]] = {
    "focal length": "1 / f = 1 / v0 + V, v0 = pixel_um (fx + fy) / 2 of section camera as configured",
    "vergence of the pattern": "V = defocus / r of the collimator; of a screen: 1 / distance",
    "image distance": "1 / v = 1 / f - 1 / focus_distance",
    "fx, fy": "times v / v0: a lens that is focused nearer sees a narrower angle (breathing)",
    "blur_px": "diameter of the disc of light of a point: f / f_number v |1 / focus_distance - V| / pixel_um",
    "light": f"times (v0 / v)^2 ({DELIVERED_F_NUMBER} / f_number)^2",
}
"""Equations of focus and aperture, as ``truth.json`` holds them."""


@dataclass(frozen=True)
class LensTruth:
    """Focus and aperture of the camera's lens."""

    # Distance of the plane in focus from the lens; infinite for parallel light; negative: beyond infinity.
    # None: as the bench is delivered. The lens is then focused on the pattern, and the focal lengths are
    # those of section ``camera``.
    focus_distance_m: float | None = None
    f_number: float = DELIVERED_F_NUMBER
    pixel_um: float = 4.86  # Side of a pixel


def in_reach(focus_distance_m: float) -> bool:
    """Return whether the focus ring reaches a distance.

    focus_distance_m: Distance of the plane in focus; infinite for parallel light, negative beyond infinity.
    Returns: True from `CLOSEST_M` to infinity, and beyond it up to `BEYOND_M`.
    """
    if math.isnan(focus_distance_m):
        return False
    return focus_distance_m >= CLOSEST_M or focus_distance_m <= BEYOND_M
