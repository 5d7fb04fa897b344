"""Detection of the target's stars in an image of one pose: which star is where, with its covariance.

The module defines the order of the steps: tag, growth, symmetry, rejection, likelihood, covariances. The image may come
from events or from a frame camera, with any number type and either contrast. A star that is cut, too faint or off the
smooth map of the others is left out, because no star is better than a wrong one.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property, partial

import numpy as np

from calib.arrays import AnyArray, Array, Array32, Bytes, selected
from calib.errors import TooFewStars, placed
from calib.events.grey_image import require_grey_plane, to_uint8
from calib.stars.candidates import MIN_STARS, Candidates, NamedBy, find_candidates
from calib.stars.centring import (
    SYMMETRY_REACH,
    SymmetryFit,
    refine_by_symmetry,
    smooth,
    symmetry_samples,
    variance_factor,
)
from calib.stars.edge_pixels import quantise
from calib.stars.grid_map import LocalMap, expanded, fit_grid_map, without_outliers
from calib.stars.likelihood import edge_width_px, refine_by_likelihood
from calib.stars.printed_star import cell_reach, open_sides
from calib.stars.template import SHARP_CORRELATION, StarTemplate, star_contrasts
from calib.target import StarTarget
from calib.view import View

#: Blur of the image before the refinement by symmetry, px: less leaves the noise of single pixels, more flattens edges.
BLUR_PX = 1.0
#: Width of the strip that symmetry leaves out where a star has no neighbour, px: three times the blur of the smoothed
#: image.
OPEN_STRIP_PX = 4.5
#: Least correlation of a refined star with its pattern: more than growth asks for, because the centre is exact now.
MIN_CORRELATION = 0.5
#: Least contrast of a star's faintest octant, as a share of its median one. Below it, the rim cuts the star.
MIN_OCTANT = 0.35
#: Least contrast of a star, as a share of the median star's: fainter ones lie where the light ends.
MIN_CONTRAST = 0.2
#: A star is an outlier if it is further from the smooth map of the view than this many standard deviations, which
#: chance alone never reaches, ...
OUTLIER_SIGMAS = 7.0
#: ... and further than this, px: a view of hardly any noise loses no star by the small errors of its map.
OUTLIER_PX = 0.05
#: Distance of the samples in the first and in the second refinement, px: the first brings near in 0.4 of the time;
#: closer samples than pixels tell nothing more.
COARSE_STEP_PX, FINE_STEP_PX = 1.6, 1.0
#: Largest move of a centre in a refinement, pitches: growth locates stars to half a pixel, to two if out of focus.
MAX_MOVE_PITCHES = 0.06
#: Least number of stars from which the statistics of pixels near edges are learnt.
MIN_FOR_LIKELIHOOD = 40
#: Typical factor of the symmetry's covariances, because the residuals of neighbouring pixels are not independent.
TYPICAL_SYMMETRY_FACTOR = 6.0
#: Standard uncertainty of a centre, px, per unit of the light's slope (1/pitch by symmetry, px/pitch by likelihood).
#: Stars at the rim of drawn discs, sine: z-score 1.10 without it, 1.06 with it, 0.92 with 0.1; elsewhere z changes by
#: 0.03 at most.
UNEVEN_LIGHT_PX = 0.035
#: Largest distance between the centres by symmetry and by likelihood, standard deviations: chance alone exceeds it once
#: in 60 million stars.
MAX_APART_SIGMAS = 6.0


@dataclass(frozen=True)
class Detection:
    """Stars detected in an image."""

    view: View
    named_by: NamedBy  # What identified the stars: the whole tag, a part of it, or only the expected pose
    _measure_width: Callable[[], float] = field(repr=False)

    @cached_property
    def edge_width_px(self) -> float:
        """Standard deviation, px, of the blur of the stars' edges by lens and pixel, measured when asked for."""
        return self._measure_width()


def detect_view(
    image: AnyArray, target: StarTarget, *, name: str | None = None, expected: Array | None = None
) -> View:
    """Detect the target's stars as a view.

    Parameters
    ----------
    image
        (H, W) of any integer or floating type; white may be bright or dark.
    target
        Printed target.
    name
        Name of the pose, for the view and for messages; None for one that the image's numbers decide.
    expected
        (3, 3) float64, homography from [column row 1] of the target's grid to [u v 1] px, right to a third of a
        pitch, by the pose. It is needed only if the tag is not in view.

    Returns
    -------
    View
        Stars that lie completely in the image, in ascending order of their ids, with covariances.

    Raises
    ------
    TargetNotFound, TooFewStars, InputMismatch
        As `detect_stars`.
    """
    return detect_stars(image, target, name=name, expected=expected).view


def detect_stars(
    image: AnyArray,
    target: StarTarget,
    *,
    name: str | None = None,
    expected: Array | None = None,
    picture: Bytes | None = None,
) -> Detection:
    """Detect the target's stars, and report what identified them; see `detect_view`.

    ``picture`` is the image by `calib.events.grey_image.to_uint8`, if the caller has it already.

    Raises StarsUnnamed: If neither the tag nor an expected pose identifies the stars.
    Raises TargetNotFound: If the image shows no stars, a wrong tag, or the tag more than once.
    Raises TooFewStars: If fewer than `MIN_STARS` stars pass all tests.
    Raises InputMismatch: If the image does not have two axes, or is empty.
    """
    name = name or f"view-{zlib.crc32(np.ascontiguousarray(image).tobytes()):08x}"
    with placed(f"view {name}"):
        require_grey_plane(image)
        values = np.asarray(image, np.float32)
        smoothed = smooth(values if np.isfinite(values.sum()) else np.nan_to_num(values), BLUR_PX)
        grey = to_uint8(image) if picture is None else picture
        candidates, sign, named_by = find_candidates(grey, smoothed, target, expected)
        blurred = False
        for step_px in (COARSE_STEP_PX, FINE_STEP_PX):
            _require_enough(len(candidates.nodes), blurred=blurred)
            refined = refine_candidates(smoothed, candidates, target, sign, step_px)
            candidates, fit, local_map, blurred = refined
        _require_enough(len(candidates.nodes), blurred=blurred)
        points, covariances, measure_width = _best_centres(image, candidates, fit, local_map, target)
        ids = target.id_at(*candidates.nodes.T)
        order = np.argsort(ids)
        kept = order[np.isfinite(points[order]).all(axis=1)]
        least = MIN_FOR_LIKELIHOOD if blurred else MIN_STARS
        _require_enough(len(kept), least, blurred=blurred, measure_width=measure_width)
        size, stars = (image.shape[1], image.shape[0]), ids[kept]
        view = View(name, size, stars, points[kept], target.positions_mm(stars), covariances[kept])
        return Detection(view, named_by, measure_width)


def _best_centres(
    image: AnyArray, candidates: Candidates, fit: SymmetryFit, local_map: LocalMap, target: StarTarget
) -> tuple[Array, Array, Callable[[], float]]:
    """Locate the stars by likelihood too, and return what scatters less: (N, 2) px and (N, 2, 2) px^2.

    The third result measures the width of the edges, px.
    Symmetry is best if the image has many shades of grey and little noise, likelihood if it is nearly black and white.
    Stars on which the two contradict each other are nan. Own rule: centres agree if d^T (V + W)^-1 d <= 6^2, with their
    difference d and their covariances V and W.
    """
    nodes, points = candidates
    nominal = fit.mean_square[:, None, None] * np.linalg.inv(fit.information)
    by_symmetry = nominal * variance_factor(nodes, points, nominal, typical=TYPICAL_SYMMETRY_FACTOR)
    by_symmetry += _uneven_light(fit.light_slope)
    levels = quantise(image)
    measure_width = partial(edge_width_px, levels, points, local_map, target)
    if len(nodes) < MIN_FOR_LIKELIHOOD:
        return points, by_symmetry, measure_width
    likely = refine_by_likelihood(levels, points, local_map, target, open_sides(target, nodes))
    measure_width = partial(measure_width, start_px=likely.blur_px)
    factor = variance_factor(nodes, likely.centres, likely.covariances, typical=1.0)
    by_likelihood = likely.covariances * factor
    by_likelihood += _uneven_light(likely.light_slope)
    apart = likely.centres - points
    squares = np.einsum("ni,nij,nj->n", apart, np.linalg.inv(by_symmetry + by_likelihood), apart)
    agree = (squares <= MAX_APART_SIGMAS**2)[:, None]
    if _typical_variance(by_likelihood) < _typical_variance(by_symmetry):
        return np.where(agree, likely.centres, np.nan), by_likelihood, measure_width
    return np.where(agree, points, np.nan), by_symmetry, measure_width


def _uneven_light(light_slope: Array) -> Array:
    """Return the (N, 2, 2) px^2 covariances by light that falls off across a star: `UNEVEN_LIGHT_PX` times slope."""
    return np.asarray((UNEVEN_LIGHT_PX * light_slope[:, None, None]) ** 2 * np.eye(2))


def _typical_variance(covariances: Array) -> float:
    """Return the median variance of the stars of a view, px^2."""
    return float(np.median(np.trace(covariances, axis1=1, axis2=2))) / 2.0


def refine_candidates(
    image: Array32, candidates: Candidates, target: StarTarget, sign: float, step_px: float
) -> tuple[Candidates, SymmetryFit, LocalMap, bool]:
    """Refine at least `MIN_STARS` centres by symmetry with the view's smooth map, and leave out stars that fail a test.

    The sign is +1 if white is bright; samples are ``step_px`` apart; the last result: whether it is out of focus.
    """
    grid = candidates.nodes.astype(float)
    local_map = expanded(fit_grid_map(grid, candidates.points)[0].apply, grid)
    pitch = local_map.pitch_px
    samples = symmetry_samples(pitch / step_px)
    used_to = cell_reach(open_sides(target, candidates.nodes), SYMMETRY_REACH, OPEN_STRIP_PX / pitch)
    fit = refine_by_symmetry(image, candidates.points, local_map, samples, used_to, MAX_MOVE_PITCHES * pitch)
    score, contrast, blurred = _scores(image, fit, local_map.linear, target, sign)
    middle = np.median(contrast, axis=1)
    good = fit.converged & (score >= MIN_CORRELATION) & (contrast.min(axis=1) >= MIN_OCTANT * middle)
    if good.any():
        good &= middle >= MIN_CONTRAST * np.median(middle[good])
    if np.count_nonzero(good) >= MIN_STARS:
        good = without_outliers(grid, fit.centres, good, sigmas=OUTLIER_SIGMAS, least_px=OUTLIER_PX)
    refined = selected(Candidates(candidates.nodes, fit.centres), good)
    return refined, selected(fit, good), selected(local_map, good), blurred


def _scores(
    image: Array32, fit: SymmetryFit, linear: Array, target: StarTarget, sign: float
) -> tuple[Array, Array, bool]:
    """Return the correlation of each star, (N,), its contrast by octants, (N, `OCTANTS`), and whether it is blurred.

    If the stars correlate badly with the sharp pattern, they are compared with the pattern learnt from them.
    """
    sharp = StarTemplate.of(target.segments)
    score, contrast = star_contrasts(image, fit.centres, linear, sharp, sign)
    seen = fit.converged & np.isfinite(score)
    if not seen.any() or np.median(score[seen]) >= SHARP_CORRELATION:
        return score, contrast, False
    learnt = sharp.learnt(image, fit.centres[seen], linear[seen], sign)
    if learnt is None:
        return score, contrast, True
    score, contrast = star_contrasts(image, fit.centres, linear, learnt, sign)
    return score, contrast, True


def _require_enough(
    count: int, least: int = MIN_STARS, *, blurred: bool, measure_width: Callable[[], float] | None = None
) -> None:
    """Refuse a view with too few stars. If few stars of a blurred image remain, their covariances are too small."""
    if count >= least:
        return
    what = f"{count} stars were found; at least {least} are needed."
    if not blurred:
        raise TooFewStars(what, remedy="Check focus, light and that the target is the one described.")
    width_px = measure_width() if measure_width else np.nan
    wide = f": star edges are {width_px:.1f} px wide" if np.isfinite(width_px) else ""
    raise TooFewStars(
        f"{what} The image is out of focus{wide}.",
        remedy="Focus the camera until star edges are narrower than 1.3 px (edge_width_px), or use a sine flicker. "
        "If it is in focus, look for a window or a filter before the lens that doubles the image.",
    )
