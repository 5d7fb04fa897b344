"""Stars of the target in an image of one pose: which, where, and how surely.

Knows the order of the work: tag, growth, symmetry, rejection, likelihood, covariances. An image may come from
events or from a frame camera, of any number type and either contrast. A star that is cut, too faint or out of
line is left out: no star is better than a wrong one.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from calib.errors import InputMismatch, StarsUnnamed, TargetNotFound, TooFewStars
from calib.stars.centring import (
    LocalMap,
    StarTemplate,
    SymmetryFit,
    refine_by_symmetry,
    smooth,
    star_contrasts,
    symmetry_samples,
)
from calib.stars.edge_pixels import quantise
from calib.stars.grid_map import fit_grid_map
from calib.stars.growth import StarGrid, grow_star_grid, start_at_tag
from calib.stars.labelling import label_by_pose, label_by_tag
from calib.stars.lattice import find_lattice
from calib.stars.likelihood import refine_by_likelihood
from calib.stars.noise import variance_factor
from calib.stars.tag import find_tag
from calib.target import StarTarget
from calib.view import View

#: Blur before refinement, px.
BLUR_PX = 1.0
#: Correlation with its print that a star needs in the end.
MIN_CORRELATION = 0.5
#: Contrast of a star's faintest octant, as a share of its median one: less, and it is cut by the rim.
MIN_OCTANT = 0.35
#: Contrast of a star as a share of the median star's.
MIN_CONTRAST = 0.2
#: Stars further from the view's smooth map than this many of its sigmas are out of line ...
OUT_OF_LINE_SIGMAS = 7.0
#: ... unless within this, px.
IN_LINE_PX = 0.05
#: Distance of the samples of the first refinement, px; the second has them a pixel apart.
COARSE_STEP_PX = 1.6
#: How far refinement may walk, in pitches.
WALK = 0.06
#: Share of the stars found without the tag that may stand where none is printed.
MAX_STRAY = 0.02
#: Stars that a view needs at least.
MIN_STARS = 12
#: Stars from which a view can teach how its pixels look near edges.
MIN_FOR_LIKELIHOOD = 40
#: Variance of centres by symmetry, in units of what residuals of independent pixels would promise, as usual.
USUAL_EXCESS = 6.0
#: 1-sigma of the shift, px, of a star across which the light changes by its own strength in a pitch.
UNEVEN_PX = 0.035
#: How far, in sigmas, symmetry and likelihood may put a star apart.
MAX_APART_SIGMAS = 6.0


NamedBy = Literal["tag", "part of the tag", "expected pose"]


class Detection(NamedTuple):
    """What an image showed.

    Attributes
    ----------
    view
        The stars.
    named_by
        What told which star is which: the whole tag, a part of it, or nothing but the pose that was expected.
    """

    view: View
    named_by: NamedBy


class _Stars(NamedTuple):
    """Candidates on their way through refinement and rejection."""

    nodes: NDArray[np.int64]
    points: NDArray[np.float64]

    def kept(self, mask: NDArray[np.bool_]) -> _Stars:
        return _Stars(self.nodes[mask], self.points[mask])


def detect_view(
    image: NDArray[np.generic],
    target: StarTarget,
    *,
    name: str = "view",
    expected: NDArray[np.float64] | None = None,
) -> View:
    """Find the target's stars.

    Parameters
    ----------
    image
        (H, W), any integer or floating type, white bright or white dark.
    target
        The printed target.
    name
        The pose's name, for the view and for messages.
    expected
        (3, 3) homography from [column row 1] of the target's grid to [u v 1] px, to a third of a pitch, as pose,
        collimator and camera let expect it; needed only where the tag is not in view.

    Returns
    -------
    View
        Stars wholly in view, by rising id, with their centres' covariances.

    Raises as `detect_stars` does.
    """
    return detect_stars(image, target, name=name, expected=expected).view


def detect_stars(
    image: NDArray[np.generic],
    target: StarTarget,
    *,
    name: str = "view",
    expected: NDArray[np.float64] | None = None,
) -> Detection:
    """Find the target's stars, and say what told their names; parameters as for `detect_view`.

    Raises
    ------
    StarsUnnamed
        When the target's tag is not in the image, nor enough of it, nor a pose to do without.
    TargetNotFound
        When there are no stars, or the tag is there more than once.
    TooFewStars
        When fewer than `MIN_STARS` stars pass.
    InputMismatch
        When the image is not one plane.
    """
    if image.ndim != 2 or image.size == 0:
        raise InputMismatch(
            f"An image of shape {image.shape}.", where=f"view {name}", remedy="Give one grey plane (H, W)."
        )
    values = smooth(np.nan_to_num(np.asarray(image, np.float32)), BLUR_PX)
    seed = find_tag(image, target, name=name)
    if seed is not None:
        grown = grow_star_grid(values, start_at_tag(seed, target), target.segments, _printed(target))
        stars, sign = _Stars(grown.nodes(), grown.places()), seed.sign
        named_by: NamedBy = "tag"
    else:
        stars, sign, named_by = _without_tag(values, target, expected, name)
    _enough(len(stars.nodes), name)
    stars, _, _ = _refined(values, stars, target, sign, COARSE_STEP_PX)
    _enough(len(stars.nodes), name)
    stars, fine, shape = _refined(values, stars, target, sign, 1.0)
    _enough(len(stars.nodes), name)
    points, covariances = _best_placed(image, stars, fine, shape, target)
    kept = np.isfinite(points).all(axis=1)
    _enough(int(np.count_nonzero(kept)), name)
    ids = target.id_at(stars.nodes[kept, 0], stars.nodes[kept, 1])
    order = np.argsort(ids)
    view = View(
        name=name,
        image_size=(image.shape[1], image.shape[0]),
        ids=ids[order],
        points_px=points[kept][order],
        target_mm=target.positions_mm(ids[order]),
        covariances_px2=covariances[kept][order],
    )
    return Detection(view, named_by)


def _printed(target: StarTarget) -> Callable[[NDArray[np.int64]], NDArray[np.bool_]]:
    """Whether a star is printed at nodes of the target."""
    return lambda nodes: np.asarray(target.id_at(nodes[:, 0], nodes[:, 1]) >= 0)


def _without_tag(
    image: NDArray[np.float32], target: StarTarget, expected: NDArray[np.float64] | None, name: str
) -> tuple[_Stars, float, NamedBy]:
    """Find stars from any of them on, and number them by what is seen of the tag, or else by the expected pose."""
    start = find_lattice(image, target.segments)
    size = max(target.columns, target.rows)
    grown = StarGrid()
    if start is not None:
        grown = grow_star_grid(
            image, start, target.segments, lambda nodes: np.asarray((np.abs(nodes) < size).all(axis=1))
        )
    if start is None or len(grown.points) < MIN_STARS:
        raise TargetNotFound(
            f"Tag {target.tag_id} of family 36h11 is not in the image, nor are stars.",
            where=f"view {name}",
            remedy="Turn the camera so that the tag is in view; check focus, light and the target's description.",
        )
    named_by: NamedBy = "part of the tag"
    try:
        numbering = label_by_tag(image, grown, start.sign, target, name=name)
    except StarsUnnamed:
        if expected is None:
            raise
        numbering, named_by = label_by_pose(grown, expected, name=name), "expected pose"
    nodes = numbering.apply(grown.nodes())
    printed = _printed(target)(nodes)
    if np.count_nonzero(~printed) > MAX_STRAY * len(nodes):
        raise TargetNotFound(
            f"{np.count_nonzero(~printed)} of {len(nodes)} stars would lie where the target has none.",
            where=f"view {name}",
            remedy="Check the target's description and the expected pose.",
        )
    return _Stars(nodes, grown.places()).kept(printed), start.sign, named_by


def _best_placed(
    image: NDArray[np.generic],
    stars: _Stars,
    fine: SymmetryFit,
    shape: LocalMap,
    target: StarTarget,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Place the stars by likelihood as well, and return what scatters less: (N, 2) px, (N, 2, 2) px^2.

    Symmetry is best where shades of grey are many and noise is little, likelihood where the image is nearly black
    and white. Stars on which the two contradict each other are nan.
    """
    promised = fine.residual[:, None, None] * np.linalg.inv(fine.information)
    by_symmetry = promised * variance_factor(stars.nodes, stars.points, promised, usual=USUAL_EXCESS)
    by_symmetry += _uneven(fine.steepness)
    if len(stars.nodes) < MIN_FOR_LIKELIHOOD:
        return stars.points, by_symmetry
    likely = refine_by_likelihood(quantise(image), stars.points, shape, target)
    by_likelihood = likely.covariances * variance_factor(
        stars.nodes, likely.centres, likely.covariances, usual=1.0
    )
    by_likelihood += _uneven(likely.steepness)
    apart = likely.centres - stars.points
    sigmas = np.einsum("ni,nij,nj->n", apart, np.linalg.inv(by_symmetry + by_likelihood), apart)
    agree = (sigmas <= MAX_APART_SIGMAS**2)[:, None]
    if _typical(by_likelihood) < _typical(by_symmetry):
        return np.where(agree, likely.centres, np.nan), by_likelihood
    return np.where(agree, stars.points, np.nan), by_symmetry


def _uneven(steepness: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N, 2, 2) px^2: what light that falls off across a star, as at the disc's rim, may have moved it by."""
    return np.asarray((UNEVEN_PX * steepness[:, None, None]) ** 2 * np.eye(2))


def _typical(covariances: NDArray[np.float64]) -> float:
    """Median variance of a view's stars, px^2."""
    return float(np.median(np.trace(covariances, axis1=1, axis2=2))) / 2.0


def _refined(
    image: NDArray[np.float32], stars: _Stars, target: StarTarget, sign: float, step_px: float
) -> tuple[_Stars, SymmetryFit, LocalMap]:
    """Refine all stars with the map that they tell together, and leave out those that do not stand."""
    grid = stars.nodes.astype(float)
    view_map, _ = fit_grid_map(grid, stars.points)
    shape = view_map.shape(grid)
    pitch = float(np.sqrt(np.median(np.abs(np.linalg.det(shape.linear)))))
    fine = refine_by_symmetry(image, stars.points, shape, symmetry_samples(pitch / step_px), WALK * pitch)
    score, contrast = star_contrasts(
        image, fine.centres, shape.linear, StarTemplate.of(target.segments), sign
    )
    middle = np.median(contrast, axis=1)
    good = fine.converged & (score >= MIN_CORRELATION) & (contrast.min(axis=1) >= MIN_OCTANT * middle)
    if good.any():
        good &= middle >= MIN_CONTRAST * np.median(middle[good])
    good = _in_line(grid, fine.centres, good)
    kept = _Stars(stars.nodes, fine.centres).kept(good)
    return kept, fine.kept(good), LocalMap(shape.linear[good], shape.curved[good])


def _in_line(
    grid: NDArray[np.float64], points: NDArray[np.float64], good: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Leave out stars that lie off the smooth map of the others."""
    if np.count_nonzero(good) < MIN_STARS:
        return good
    fitted, residuals = fit_grid_map(grid[good], points[good])
    out = np.linalg.norm(residuals, axis=1) > max(OUT_OF_LINE_SIGMAS * fitted.sigma_px, IN_LINE_PX)
    good = good.copy()
    good[np.flatnonzero(good)[out]] = False
    return good


def _enough(count: int, name: str) -> None:
    """Refuse a view with too few stars."""
    if count < MIN_STARS:
        raise TooFewStars(
            f"{count} stars were found around the tag; at least {MIN_STARS} are needed.",
            where=f"view {name}",
            remedy="Check focus, light and that the target is the one described.",
        )
