"""The origin of image points: the centre of the first pixel, or its corner, half a pixel away.

Views alone cannot show the origin: a common shift of all points moves the principal point, and nothing else changes.
If only some views of a set are shifted, the others show it (`find_other_origins`). A rotation of the camera imitates a
shift to first order, so only good views decide.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.adjustment.bundle import Bundle
from calib.adjustment.parameters import AdjustmentParameters
from calib.arrays import Array
from calib.diagnosis.gross_stars import typical_noise_px
from calib.diagnosis.linearised import (
    ShiftEquations,
    image_shifts,
    independent_components,
    plain_bundle,
    rms_px,
)
from calib.model.likelihood_ratio import DECISIVE, needed
from calib.view import View

HALF_PX = 0.5
_STARS = 400


@dataclass(frozen=True)
class OtherOrigin:
    """Views whose points have another origin than those of the other views."""

    views: tuple[str, ...]
    # Their mean offset against the other views along x (right) and y (down), px.
    offset_px: tuple[float, float]
    sigma_px: float  # Larger 1-sigma of the offset along an axis, px

    @property
    def sentence(self) -> str:
        """Names the views and their offset."""
        which = f"view {self.views[0]} lie" if len(self.views) == 1 else f"views {', '.join(self.views)} lie"
        return (
            f"The points of {which} {_words(self.offset_px)} of those of the other views "
            f"(± {2.0 * self.sigma_px:.2g} px, k = 2): their origin seems to differ. "
            "Check --origin, and give all views the same."
        )


def find_other_origins(
    views: Sequence[View], bundle: Bundle, parameters: AdjustmentParameters
) -> OtherOrigin | None:
    """Look for views whose points lie half a pixel away from those of the other views, along both axes.

    Views join the shifted ones, one by one, and the likelihood ratio decides how many of them lie half a pixel off, at
    most half of them. An offset of another size must not be decisively more likely. One view alone is seldom enough,
    because its own rotation imitates a shift. Own procedure. It takes three or more views without gross errors, and a
    model with one centre. None if all agree, or if the views cannot decide.
    """
    noise = typical_noise_px(views)
    if len(views) < 3 or not np.isfinite(noise):
        return None
    plain = plain_bundle(bundle, _STARS)
    equations = image_shifts(plain, parameters)
    count = independent_components(plain, rms_px(plain, parameters), noise)
    ratio, shift = max((_joined(equations, by, count) for by in (HALF_PX, -HALF_PX)), key=lambda one: one[0])
    if not ratio > 0.0:
        return None
    # Offsets of the joined views along each axis, from the equations restricted to these views.
    pattern = np.stack([shift * axis for axis in np.eye(2)]) / HALF_PX
    normal = np.einsum("anx,nxmy,bmy->ab", pattern, equations.information, pattern)
    right = np.einsum("anx,nx->a", pattern, equations.gradient)
    variance = float(equations.squares_after(shift[None])[0]) / count
    offset = np.linalg.solve(normal, right)
    away = offset - HALF_PX
    if away @ normal @ away > DECISIVE * variance:
        return None
    members, sigmas = np.flatnonzero(shift[:, 0]).tolist(), np.sqrt(np.diag(np.linalg.inv(normal)) * variance)
    x, y = offset * np.sign(shift[members[0], 0])
    return OtherOrigin(tuple(views[i].name for i in members), (float(x), float(y)), float(sigmas.max()))


def _joined(equations: ShiftEquations, by: float, count: float) -> tuple[float, Array]:
    """Return 2 log(likelihood ratio) of the best group of views, beyond what is needed, and the (n, 2) shifts, px."""
    views = len(equations.gradient)
    shift, best = np.zeros((views, 2)), (-np.inf, np.zeros((views, 2)))
    for size in range(1, views // 2 + 1):
        tried = np.array(
            [np.where(np.eye(views)[i][:, None] > 0, by, shift) for i in range(views) if not shift[i, 0]]
        )
        squares = equations.squares_after(tried)
        shift, least = tried[squares.argmin()], max(float(squares.min()), 1e-9 * equations.squares)
        ratio = count * float(np.log(equations.squares / least)) - needed(2 * math.comb(views, size))
        best = max(best, (ratio, shift), key=lambda one: one[0])
    return best


def _words(offset: Sequence[float]) -> str:
    """Write an offset, as "0.50 px right and 0.50 px down"."""
    along = f"{abs(offset[0]):.2f} px {'right' if offset[0] >= 0 else 'left'}"
    return f"{along} and {abs(offset[1]):.2f} px {'down' if offset[1] >= 0 else 'up'}"
