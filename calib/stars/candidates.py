"""Possible stars, to about a pixel, with places on the target: by the tag, a part of it, or the pose; untested.

If the tag cannot be read whole, stars are found on a relative grid: its origin is any star, and it is turned by any
number of quarter turns. The visible part of the tag labels them, or an expected pose. The module refuses to label stars
if more than one labelling agrees with the print.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np

from calib.arrays import Array, Array32, Bools, Bytes, Ints, selected
from calib.errors import StarsUnnamed, TargetNotFound
from calib.model.homography import apply_homography, fit_homography, linear_at
from calib.stars.beam import find_beam
from calib.stars.grid_map import predict_locally
from calib.stars.growth import GrowthStart, StarGrid, find_lattice, grow_star_grid, start_at_tag
from calib.stars.tag import TagDetection, find_tag
from calib.stars.template import values_at
from calib.target import StarTarget

#: Largest share of the visible modules of a tag that may be wrong: less than half of the 11 of 64 in which tags of the
#: family 36h11 differ.
MAX_WRONG_MODULES = 0.08
#: Least share of the modules inside the tag's border that must be visible: fewer agree with several labellings.
MIN_INNER_SHARE = 1 / 3
#: Least difference between the best labelling and any other, in the share of right modules. A larger one refuses more
#: poses; a smaller one risks a wrong name, which is worse.
MIN_MARGIN = 0.15
#: Largest distance of the stars from whole nodes, and their largest scatter, by an expected pose, pitches: at a half,
#: two labellings fit equally well.
MAX_OFF_NODE, MAX_SCATTER = 0.3, 0.35
_QUARTER_TURNS = [np.linalg.matrix_power(np.array([[0, -1], [1, 0]]), quarter) for quarter in range(4)]
#: Least number of stars of a view: three times as many as a homography needs.
MIN_STARS = 12
#: Largest share of the stars found without the tag that may lie where none is printed: a right labelling has hardly
#: any.
MAX_STRAY = 0.02
#: Share of an image without light, or of the light without stars, from which on it is told: in the poses that a
#: sequence needs, it is up to a quarter.
HALF = 0.5
#: Least distance of a corner of the tag from the image, px, by a homography, for the tag to be cut. The homography
#: leaves out distortion, which is a few pixels.
CUT_PX = 10.0

NamedBy = Literal["tag", "part of the tag", "expected pose"]


class StarLabels(NamedTuple):
    """Labels of stars as a map of nodes: node of the target = turn @ relative node + shift."""

    turn: Ints  # (2, 2) int64, rotation by quarter turns
    shift: Ints  # (2,) int64, columns and rows

    def apply(self, nodes: Ints) -> Ints:
        """Return the (N, 2) nodes of the target, columns and rows, of nodes of the relative grid."""
        return np.asarray(nodes @ self.turn.T + self.shift, np.int64)


def label_by_pose(grown: StarGrid, expected: Array) -> StarLabels:
    """Label stars, found on a relative grid, by the positions at which a pose lets them be expected.

    Own rule: the quarter turn with the least scatter about a common shift, and the whole nodes next to the median
    shift. ``expected`` is from [column row 1] of the target's grid to [u v 1] px, right to a third of a pitch.
    Raises StarsUnnamed: If the stars do not lie on the expected grid, or lie half-way between two labellings.
    """
    nodes = grown.nodes()
    there = apply_homography(np.asarray(np.linalg.inv(expected), np.float64), grown.places())
    fits = []
    for turn in _QUARTER_TURNS:
        off = there - nodes @ turn.T
        middle = np.median(off, axis=0)
        fits.append((float(np.sqrt(np.mean(np.sum((off - middle) ** 2, axis=1)))), middle, turn))
    scatter, middle, turn = min(fits, key=lambda f: f[0])
    shift = np.round(middle)
    if scatter > MAX_SCATTER or np.abs(middle - shift).max() > MAX_OFF_NODE:
        raise StarsUnnamed(
            f"The image shows {len(nodes)} stars but no tag, and the expected pose does not identify the stars: they "
            f"lie {np.abs(middle - shift).max():.2f} squares from its nodes and scatter by {scatter:.2f} squares.",
            remedy="Turn the camera so that the tag is in view, or give the pose to a third of a square.",
        )
    return StarLabels(turn, shift.astype(np.int64))


def label_by_tag(image: Array32, grown: StarGrid, sign: float, target: StarTarget) -> StarLabels:
    """Label stars, found on a relative grid, by the part of the tag that is in view.

    Every gap in the grid of stars that may hold the tag is compared with the print, module by module, in all four
    orientations. Own rule: the labelling with the largest share of right modules, if it exceeds all others by
    `MIN_MARGIN`. The image is smoothed; the sign is +1 if white is bright, -1 if it is dark.
    Raises StarsUnnamed: If too little of the tag is visible, it is another tag, or two labellings agree with it.
    """
    nodes = grown.nodes()
    h = fit_homography(nodes.astype(float), grown.places())
    white, black = _white_and_black(image, grown, h, sign)
    centre = np.array(target.tag_centre_mm) / target.pitch_mm
    matches: list[tuple[float, StarLabels]] = []
    mirrored = 0.0
    for middle in _gaps(nodes, target):
        modules = _modules(image, grown, h, middle, target)
        if modules is None:
            continue
        white_here = np.where(np.isfinite(modules), sign * modules > (white + black) / 2.0, False)
        for quarter, turn in enumerate(_QUARTER_TURNS):
            share = _right_share(white_here, modules, quarter, target)
            in_mirror = _right_share(white_here[::-1], modules[::-1], quarter, target)
            # A mirrored star is one of the other polarity, so the sign may be wrong.
            mirrored = max(mirrored, in_mirror, 1.0 - in_mirror)
            shift = np.round(centre - turn @ middle).astype(np.int64)
            matches.append((share, StarLabels(turn, shift)))
    matches.sort(key=lambda f: -f[0])
    if not matches or matches[0][0] < 1.0 - MAX_WRONG_MODULES:
        if mirrored >= 1.0 - MAX_WRONG_MODULES:
            raise StarsUnnamed(
                f"The image shows {len(nodes)} stars, and the tag as in a mirror.",
                remedy="Turn the target over, or switch off the mirrored picture in the camera's software.",
            )
        what = "no readable part of the tag."
    elif len(matches) > 1 and matches[1][0] > matches[0][0] - MIN_MARGIN:
        what = "the visible part of the tag agrees with more than one labelling."
    else:
        return matches[0][1]
    raise StarsUnnamed(
        f"The image shows {len(nodes)} stars, but {what}{_seen_besides(image, nodes, h)}",
        remedy="Turn the camera so that more of the tag is in view.",
    )


def _seen_besides(image: Array32, nodes: Ints, h: Array) -> str:
    """Return sentences about a large part of an image, (H, W), that shows no light, or light without stars."""
    lit = find_beam(image).share
    covered = len(nodes) * float(np.median(np.abs(np.linalg.det(linear_at(h, nodes.astype(float))))))
    bare = 1.0 - covered / max(lit * image.size, covered)
    said = ""
    if 0.0 < lit < HALF:
        dark = f"{100 * (1 - lit):.0f} % of the image is dark"
        said += f" {dark}: the camera looks past the beam, or something stands in it."
    if bare > HALF:
        said += f" {100 * bare:.0f} % of the light shows no stars: other light lies over them, such as a reflection."
    return said


def _right_share(white_here: Bools, modules: Array, quarter: int, target: StarTarget) -> float:
    """Return the share of the modules in view that are as the print has them, after quarter turns."""
    right = np.rot90(white_here, -quarter) == (target.tag_print > 0)
    return float(right[np.rot90(np.isfinite(modules), -quarter)].mean())


def _gaps(nodes: Ints, target: StarTarget) -> Array:
    """Return the (M, 2) centres of gaps that are as large as the tag, in pitches."""
    side = target.tag_squares + 1
    low, high = nodes.min(axis=0) - side, nodes.max(axis=0) + side
    taken = np.zeros(high - low + 1, np.bool_)
    taken[tuple((nodes - low).T)] = True
    filled = np.lib.stride_tricks.sliding_window_view(taken, (side, side)).any(axis=(2, 3))
    return np.argwhere(~filled) + low + (side - 1) / 2.0


def _white_and_black(image: Array32, grown: StarGrid, h: Array, sign: float) -> tuple[float, float]:
    """Return white's and black's brightness times the sign: quantiles 0.8 and 0.2 on circles around the stars (own)."""
    around = np.array([[np.cos(a), np.sin(a)] for a in np.arange(64) * np.pi / 32]) * 0.4
    at = apply_homography(h, (grown.nodes()[:, None, :] + around[None]).reshape(-1, 2))
    values = sign * values_at(image, *at.T)
    values = values[np.isfinite(values)]
    return float(np.quantile(values, 0.8)), float(np.quantile(values, 0.2))


def _modules(image: Array32, grown: StarGrid, h: Array, middle: Array, target: StarTarget) -> Array | None:
    """Return the brightness of the modules of a tag with its centre at a place, (M, M), nan outside of the image.

    None if a smaller share than `MIN_INNER_SHARE` of those inside the border lies in the image.
    """
    across = target.tag_modules
    steps = ((np.arange(across) + 0.5) / across - 0.5) * target.tag_squares
    on_grid = middle + np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    inner = np.zeros((across, across), bool)
    inner[1:-1, 1:-1] = True
    roughly = np.isfinite(values_at(image, *apply_homography(h, on_grid[inner.ravel()]).T))
    if np.count_nonzero(roughly) < MIN_INNER_SHARE * roughly.size:
        return None
    at = predict_locally(h, grown.nodes().astype(float), grown.places(), on_grid)
    return values_at(image, *at.T).reshape(inner.shape).astype(float)


class Candidates(NamedTuple):
    """Possible stars."""

    nodes: Ints  # (N, 2) int64, columns and rows of the target
    points: Array  # (N, 2) float64, px


def find_candidates(
    picture: Bytes, smoothed: Array32, target: StarTarget, expected: Array | None
) -> tuple[Candidates, float, NamedBy]:
    """Find possible stars, starting at the tag if it can be read; the sign is +1 if white is bright, -1 if it is dark.

    The picture is the image by `calib.events.grey_image.to_uint8`. ``expected`` is the (3, 3)
    homography from the target's grid to px, by the pose; None if it is not known.
    Raises StarsUnnamed: If neither the tag nor an expected pose identifies the stars.
    Raises TargetNotFound: If the image shows no stars, a wrong tag, or the tag more than once.
    """
    tag = find_tag(picture, target, reduced_only=True)
    if tag is None:
        # The pictures of full size take long, and never show a tag that the border of the image cuts.
        unlabelled = find_without_tag(smoothed, target, expected)
        if not _is_tag_cut(smoothed, unlabelled, target):
            tag = find_tag(picture, target)
    if tag is None:
        return _label_without_tag(unlabelled, target, expected)
    grown = grow_from_tag(smoothed, tag, target)
    return Candidates(grown.nodes(), grown.places()), tag.sign, "tag"


def grow_from_tag(image: Array32, tag: TagDetection, target: StarTarget) -> StarGrid:
    """Find possible stars, starting with the ring around the tag."""
    return grow_star_grid(image, start_at_tag(tag, target), target.segments, lambda n: printed(target, n))


def printed(target: StarTarget, nodes: Ints) -> Bools:
    """Return whether a star is printed at each of (N, 2) nodes, (N,)."""
    return np.asarray(target.id_at(nodes[:, 0], nodes[:, 1]) >= 0)


class Unlabelled(NamedTuple):
    """Stars on a relative grid, +1 if white is bright, else -1, and their labels by a part of the tag."""

    grown: StarGrid
    sign: float
    labels: StarLabels | StarsUnnamed | None  # None without stars


def find_without_tag(image: Array32, target: StarTarget, expected: Array | None) -> Unlabelled:
    """Find possible stars starting at any of them, and label them by the visible part of the tag if possible."""
    start = find_lattice(image, target.segments)
    starts = [start] if start is not None else _starts_as_expected(image, expected)
    size = max(target.columns, target.rows)
    grown, sign = StarGrid(), 1.0
    for tried in starts:
        star_grid = grow_star_grid(
            image, tried, target.segments, lambda nodes: np.asarray((np.abs(nodes) < size).all(axis=1))
        )
        if len(star_grid.points) > len(grown.points):
            grown, sign = star_grid, tried.sign
    if len(grown.points) < MIN_STARS:
        return Unlabelled(grown, sign, None)
    try:
        return Unlabelled(grown, sign, label_by_tag(image, grown, sign, target))
    except StarsUnnamed as unnamed:
        return Unlabelled(grown, sign, unnamed)


def _is_tag_cut(image: Array32, unlabelled: Unlabelled, target: StarTarget) -> bool:
    """Return whether the stars tell that a corner of the tag lies clearly outside of the image."""
    if not isinstance(unlabelled.labels, StarLabels):
        return False
    nodes = unlabelled.labels.apply(unlabelled.grown.nodes()).astype(float)
    homography = fit_homography(nodes, unlabelled.grown.places())
    corners = apply_homography(homography, target.tag_corners_mm / target.pitch_mm)
    last = np.array(image.shape[::-1]) - 1.0
    return bool(((corners < -CUT_PX) | (corners > last + CUT_PX)).any())


def _label_without_tag(
    unlabelled: Unlabelled, target: StarTarget, expected: Array | None
) -> tuple[Candidates, float, NamedBy]:
    """Return stars with their nodes, labelled by the visible part of the tag or by the pose."""
    grown, sign, labels = unlabelled
    if labels is None:
        raise TargetNotFound(
            f"Tag {target.tag_id} of family {target.tag_family} is not in the image as a whole, and no pattern of "
            "stars was found.",
            remedy="Turn the camera so that the tag is in view; check focus and light; look for dust, fog or a "
            "reflection, and for what covers parts of the picture; check the target's description.",
        )
    named_by: NamedBy = "part of the tag"
    if isinstance(labels, StarsUnnamed):
        if expected is None:
            raise labels
        labels, named_by = label_by_pose(grown, expected), "expected pose"
    nodes = labels.apply(grown.nodes())
    seen = printed(target, nodes)
    if np.count_nonzero(~seen) > MAX_STRAY * len(nodes):
        raise TargetNotFound(
            f"{np.count_nonzero(~seen)} of {len(nodes)} stars would lie where the target has none.",
            remedy="Check the target's description and the expected pose.",
        )
    return selected(Candidates(nodes, grown.places()), seen), sign, named_by


def _starts_as_expected(image: Array32, expected: Array | None) -> list[GrowthStart]:
    """Return where growth may start by the expected pose, for either contrast: nodes in the middle of the image.

    An image out of focus may show stars, but none that is found without knowing where it is.
    """
    if expected is None:
        return []
    height, width = image.shape
    inverse = np.asarray(np.linalg.inv(expected), np.float64)
    middle = apply_homography(inverse, np.array([[width / 2.0, height / 2.0]]))
    steps = np.arange(-2, 3)
    nodes = (np.round(middle) + np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)).astype(np.int64)
    return [GrowthStart(expected, sign, nodes) for sign in (1.0, -1.0)]
