"""The origin of image points: the centre of the first pixel, or its corner, half a pixel away.

Views alone cannot show the origin: a common shift of all points moves the principal point, and nothing else changes.
If only some views of a set are shifted, the others show it (`find_other_origins`). A rotation of the camera imitates a
shift to first order, so only good views decide.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.adjustment.bundle import Bundle
from calib.adjustment.parameters import AdjustmentParameters
from calib.diagnosis.gross_stars import typical_noise_px
from calib.diagnosis.linearised import ShiftEquations, image_shifts, plain_bundle
from calib.model.median import RAYLEIGH_MEDIAN, median
from calib.view import View

HALF_PX = 0.5
#: The offset of the views that have another origin must be known to this 1-sigma, px. Agreement and contradiction are
#: judged in sigmas.
_MAX_SIGMA_PX = 0.25
_AGREES = 3.0
_CONTRADICTS = 5.0
#: A view joins those with another origin if that lowers the weighted squares by this much.
_JOINS = 6.0
#: Residuals above this multiple of the noise of neighbouring stars are mostly systematic. They vary slowly over a view,
#: so a view counts as this number of independent stars.
_SYSTEMATIC = 1.3
_INDEPENDENT = 10
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

    Views join the shifted ones, one by one, as long as each lowers the squares of the linearised adjustment. The result
    counts if the common offset of the joined views is half a pixel within 3 sigma along both axes, and zero is 5 sigma
    away. One view alone is seldom enough, because its own rotation imitates a shift. Own procedure. It takes three or
    more views without gross errors, and a model with one centre. None if all agree, or if the views cannot decide.
    """
    if len(views) < 3 or not np.isfinite(typical_noise_px(views)):
        return None
    plain = plain_bundle(bundle, _STARS)
    equations = image_shifts(plain, parameters)
    factor = _variance_factor(views, plain, parameters)
    found = max((_joined(equations, sign, factor) for sign in (1, -1)), key=lambda one: one[0])
    gain, members, sign = found
    if not gain > _CONTRADICTS**2:
        return None
    # Offsets of the joined views along each axis, from the equations restricted to these views.
    pattern = np.zeros((2, len(views), 2))
    pattern[0, members, 0] = pattern[1, members, 1] = 1.0
    normal = np.einsum("anx,nxmy,bmy->ab", pattern, equations.information, pattern)
    offset = np.linalg.solve(normal, np.einsum("anx,nx->a", pattern, equations.gradient))
    sigmas = np.sqrt(np.diag(np.linalg.inv(normal)) * factor)
    if not (np.abs(offset - sign * HALF_PX) <= _AGREES * sigmas).all() or sigmas.max() > _MAX_SIGMA_PX:
        return None
    names = tuple(views[i].name for i in members)
    return OtherOrigin(names, (float(offset[0]), float(offset[1])), float(sigmas.max()))


def _joined(equations: ShiftEquations, sign: int, factor: float) -> tuple[float, list[int], int]:
    """Return the gain of a half-pixel offset of the best group of views, the group, and the sign of the offset.

    The gain is the fall of the weighted squares over their variance. At most half of the views join.
    """
    n = len(equations.gradient)
    score = sign * HALF_PX * equations.gradient.sum(axis=1)
    information = HALF_PX**2 * equations.information.sum(axis=(1, 3))
    members: list[int] = []
    gain = 0.0
    while len(members) < n // 2:
        gains = {
            i: (2.0 * score[at].sum() - information[np.ix_(at, at)].sum()) / factor
            for i in range(n)
            if i not in members
            for at in [[*members, i]]
        }
        best = max(gains, key=lambda i: gains[i])
        if gains[best] - gain < _JOINS:
            break
        members, gain = sorted([*members, best]), float(gains[best])
    return gain, members, sign


def _spread(bundle: Bundle, parameters: AdjustmentParameters) -> float:
    """Return the robust standard deviation per axis of the weighted residuals."""
    lengths = np.linalg.norm(bundle.weighted_residuals(parameters), axis=1)
    return median(lengths) / RAYLEIGH_MEDIAN


def _variance_factor(views: Sequence[View], bundle: Bundle, parameters: AdjustmentParameters) -> float:
    """Return the variance of a weighted residual component, enlarged if the residuals are mostly systematic."""
    variance = _spread(bundle, parameters) ** 2
    noise = np.nan_to_num(typical_noise_px(views)) * bundle.observations.sigmas_per_px
    if not variance > (_SYSTEMATIC * noise) ** 2:
        return max(variance, noise**2)
    stars = len(bundle.observations.view) / len(bundle.observations.slices)
    return noise**2 + (variance - noise**2) * max(1.0, stars / _INDEPENDENT)


def _words(offset: Sequence[float]) -> str:
    """Write an offset, as "0.50 px right and 0.50 px down"."""
    along = f"{abs(offset[0]):.2f} px {'right' if offset[0] >= 0 else 'left'}"
    return f"{along} and {abs(offset[1]):.2f} px {'down' if offset[1] >= 0 else 'up'}"
