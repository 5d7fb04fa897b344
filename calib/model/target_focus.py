"""Which length of a collimator a certificate states, and how the focal length and what a camera sees differ.

A camera sees the length r between the centre and the target: the place on the target over the tangent of its direction.
It is the focal length only if the target is in focus. With the defocus d (`calib.model.gimbal_readings.ParallaxBound`)
and the distance p from the entrance pupil to the front focal plane, r = focal length + d p: the ray through the middle
of the pupil crosses that plane at p times its tangent, and a target out of focus shows a shift there as d times that.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from calib.arrays import product_sigma
from calib.errors import InputMismatch

#: Expected defocus of a target that nobody measured, 1-sigma. It is that of the parallax (`calib.joint.amplitudes`).
_DEFOCUS = 0.06
#: Expected distance from pupil to front focal plane, 1-sigma, as a share of the focal length. The camera stands between
#: the glass and two focal lengths before it, where the beams of a mirror cross; the front focal plane lies one focal
#: length before it. So the distance is equally probable from -1 to 1.
_PUPIL_SHARE = 1.0 / float(np.sqrt(3.0))


class CertifiedLength(StrEnum):
    """Which length a certificate states."""

    UNSAID = ""  # Both meanings are weighed
    FOCAL = "focal_length"  # Of the glass: what a maker's certificate and a data sheet state
    SEEN = "seen"  # Between centre and target, as a camera on this bench measured it


@dataclass(frozen=True)
class TargetFocus:
    """What is known of the target's focus and of the pupil's place; each is a value with its standard uncertainty.

    Defocus, dimensionless, as in `ParallaxBound`; None if nobody measured it. Pupil to focus, mm, is the distance from
    the camera's entrance pupil to the front focal plane of the collimator, negative if the pupil is between that plane
    and the glass, as it usually is; None if unknown.
    """

    defocus: tuple[float, float] | None = None
    pupil_to_focus_mm: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        for name in ("defocus", "pupil_to_focus_mm"):
            value, sigma = getattr(self, name) or (0.0, 0.0)
            if not (np.isfinite(value) and 0.0 <= sigma < np.inf):
                raise InputMismatch(
                    f"{name} is {value} with the standard uncertainty {sigma}.",
                    remedy="Give a finite value, and an uncertainty that is not negative.",
                )

    def seen_less_focal_mm(self, focal_mm: float) -> tuple[float, float]:
        """Return by how much the camera sees more than the focal length, mm, and its 1-sigma."""
        d, p = self.defocus or (0.0, _DEFOCUS), self.pupil_to_focus_mm or (0.0, _PUPIL_SHARE * focal_mm)
        return d[0] * p[0], product_sigma(d, p)
