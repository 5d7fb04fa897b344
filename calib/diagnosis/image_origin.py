"""The origin of image points: the centre of the first pixel, or its corner, half a pixel away.

Views alone cannot show the origin: a common shift of all points moves the principal point, and nothing else changes. A
known camera shows it (`origin_offset`), and so do the other views of a set, if only some of them are shifted
(`find_other_origins`). A rotation of the camera imitates a shift to first order, so only good views decide.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.adjustment.bundle import Bundle
from calib.adjustment.levenberg_marquardt import Loss, refine
from calib.adjustment.observations import Observations
from calib.adjustment.parameters import AdjustmentParameters
from calib.diagnosis.linearised import ShiftEquations, image_shifts, plain_bundle
from calib.diagnosis.star_noise import typical_noise_px
from calib.model.camera import CameraModel
from calib.model.collimator import Collimator
from calib.model.homography import view_homography
from calib.model.median import median
from calib.model.planar import poses_from_homographies
from calib.model.spherical import rotations_from_centre
from calib.view import View

Array = NDArray[np.float64]

HALF_PX = 0.5
#: An offset is decided if it is known to this 1-sigma, px: half a pixel is 4 sigma. Agreement and contradiction are
#: judged in sigmas.
MAX_SIGMA_PX = 0.125
_AGREES = 3.0
_CONTRADICTS = 5.0
#: A view joins those with another origin if that lowers the weighted squares by this much.
_JOINS = 6.0
#: Residuals above this multiple of the noise of neighbouring stars are mostly systematic. They vary slowly over a view,
#: so a view counts as this number of independent stars.
_SYSTEMATIC = 1.3
_INDEPENDENT = 10
#: Limit of the robust loss in robust standard deviations per axis, and the number of times it is estimated.
_LIMIT_SIGMAS = 2.5
_ROUNDS = 2
_RAYLEIGH_MEDIAN = 1.1774100225154747
_STARS = 400


@dataclass(frozen=True)
class OriginOffset:
    """A common offset of all image points against a known camera."""

    # Offset along x (right) and y (down), px: points minus what the camera sees.
    offset_px: tuple[float, float]
    sigma_px: tuple[float, float]  # 1-sigma of both, px, that of the known camera included

    @property
    def decided(self) -> bool:
        """Whether the offset is known well enough to see half a pixel."""
        return max(self.sigma_px) <= MAX_SIGMA_PX

    @property
    def agrees(self) -> bool:
        """Whether the points lie where the camera sees them."""
        return self.decided and _distance(self.offset_px, (0.0, 0.0), self.sigma_px) <= _AGREES

    @property
    def half_pixel(self) -> bool:
        """Whether the offset is half a pixel along both axes, in the same direction."""
        return self.decided and bool(_half_pixel(self.offset_px, self.sigma_px))

    @property
    def sentence(self) -> str:
        """Says where the points lie, and what to check."""
        expanded = f"± {2.0 * max(self.sigma_px):.2g} px, k = 2"
        if not self.decided:
            return (
                "These views cannot decide whether their points have the origin of this camera: a common offset is "
                f"known only to ± {2.0 * max(self.sigma_px):.2g} px (k = 2), and the two origins differ by "
                "half a pixel."
            )
        if self.agrees:
            return f"The points lie where this camera sees them, to {_words(self.offset_px)} ({expanded})."
        place = f"All points lie {_words(self.offset_px)} of where this camera sees them ({expanded})"
        if self.half_pixel:
            return f"{place}: check --origin."
        return f"{place}. The principal point has moved, or the points come from another part of the image."


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


def origin_offset(
    views: Sequence[View],
    camera: CameraModel,
    collimator: Collimator | None = None,
    *,
    camera_sigma_px: tuple[float, float] = (0.0, 0.0),
) -> OriginOffset:
    """Estimate a common offset of all image points against a known camera.

    The camera is held except for its principal point, whose movement is the offset. The rotations are free, and so is
    the centre of the collimator if it is not given. A Huber loss is used (Huber, 1964), with a limit of 2.5 robust
    standard deviations. If residuals are mostly systematic, a view counts as 10 independent stars in sigma. Own
    procedure.

    views: Views of the camera, without gross errors.
    collimator: Centre of the collimator from a passport or another calibration, without aberrations; None if
      it is not known.
    camera_sigma_px: 1-sigma of the known cx and cy, px.
    Returns: Offset with its uncertainty; undecided if half a pixel cannot be seen.
    """
    h = np.array([view_homography(view) for view in views])
    names = ["cx", "cy"]
    centre = collimator
    if centre is None:
        x, y, z = np.median(poses_from_homographies(h, camera.matrix)[1], axis=0)
        centre = Collimator(float(x), float(y), float(-z))
        names += ["x", "y", "r"]
    centre = Collimator(centre.x, centre.y, centre.r)
    rotations = rotations_from_centre(h, camera.matrix, centre.centre)
    start = AdjustmentParameters(camera, centre, rotations, np.zeros((len(views), 3)))
    bundle = Bundle(Observations.from_views(views), tuple(names))
    end, loss = start, Loss("l2")
    for _ in range(_ROUNDS):
        end = refine(bundle, end, loss).parameters
        loss = Loss("huber", _LIMIT_SIGMAS * max(_spread(bundle, end), 1e-12))
    end = refine(bundle, end, loss).parameters
    influence = bundle.weighted_residuals(end)
    information = bundle.normal_equations(end, influence).reduced()
    scale = 1.0 / np.sqrt(np.diag(information))
    covariance = np.linalg.pinv(information * np.outer(scale, scale), hermitian=True) * np.outer(scale, scale)
    variances = np.diag(covariance)[:2] * _variance_factor(views, bundle, end)
    sigmas = np.sqrt(variances + np.square(camera_sigma_px))
    offset = (end.camera.cx - camera.cx, end.camera.cy - camera.cy)
    return OriginOffset(offset, (float(sigmas[0]), float(sigmas[1])))


def find_other_origins(
    views: Sequence[View], bundle: Bundle, parameters: AdjustmentParameters
) -> OtherOrigin | None:
    """Look for views whose points lie half a pixel away from those of the other views, along both axes.

    Views join the shifted ones, one by one, as long as each lowers the squares of the linearised adjustment. The result
    counts if the common offset of the joined views is half a pixel within 3 sigma along both axes, and zero is 5 sigma
    away. One view alone is seldom enough, because its own rotation imitates a shift. Own procedure.

    views: Three or more views without gross errors, in the order of the bundle.
    bundle: Bundle of these views, of a model in which they share one centre.
    Returns: None if all views agree, or if the views cannot decide.
    """
    if len(views) < 3 or not np.isfinite(typical_noise_px(views)):
        return None
    plain = plain_bundle(bundle, parameters, _STARS)
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
    if not (np.abs(offset - sign * HALF_PX) <= _AGREES * sigmas).all() or sigmas.max() > 2.0 * MAX_SIGMA_PX:
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
    return median(lengths) / _RAYLEIGH_MEDIAN


def _variance_factor(views: Sequence[View], bundle: Bundle, parameters: AdjustmentParameters) -> float:
    """Return the variance of a weighted residual component, enlarged if the residuals are mostly systematic."""
    variance = _spread(bundle, parameters) ** 2
    noise = np.nan_to_num(typical_noise_px(views)) * bundle.observations.sigmas_per_px
    if not variance > (_SYSTEMATIC * noise) ** 2:
        return max(variance, noise**2)
    stars = len(bundle.observations.view) / len(bundle.observations.slices)
    return noise**2 + (variance - noise**2) * max(1.0, stars / _INDEPENDENT)


def _half_pixel(offset: Sequence[float], sigmas: Sequence[float]) -> int:
    """Return 1 for half a pixel right and down, -1 for left and up, 0 for anything else or if it may be zero."""
    if _distance(offset, (0.0, 0.0), sigmas) < _CONTRADICTS:
        return 0
    for sign in (1, -1):
        if _distance(offset, (sign * HALF_PX, sign * HALF_PX), sigmas) <= _AGREES:
            return sign
    return 0


def _distance(offset: Sequence[float], other: Sequence[float], sigmas: Sequence[float]) -> float:
    """Return the distance of two offsets, in sigmas."""
    return float(np.hypot(*((np.array(offset) - other) / np.maximum(sigmas, 1e-12))))


def _words(offset: Sequence[float]) -> str:
    """Write an offset, as "0.50 px right and 0.50 px down"."""
    along = f"{abs(offset[0]):.2f} px {'right' if offset[0] >= 0 else 'left'}"
    return f"{along} and {abs(offset[1]):.2f} px {'down' if offset[1] >= 0 else 'up'}"
