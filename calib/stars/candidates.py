"""Possible stars, to about a pixel, with places on the target: by the tag, a part of it, or the pose; untested."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np

from calib.arrays import AnyArray, Array, Array32, Bools, Ints
from calib.errors import StarsUnnamed, TargetNotFound
from calib.events.grey_image import to_uint8
from calib.model.homography import apply_homography, fit_homography
from calib.stars.growth import GrowthStart, StarGrid, grow_star_grid, start_at_tag
from calib.stars.labelling import StarLabels, label_by_pose, label_by_tag
from calib.stars.lattice import find_lattice
from calib.stars.tag import find_tag
from calib.target import StarTarget

#: Least number of stars of a view.
MIN_STARS = 12
#: Largest share of the stars found without the tag that may lie where none is printed.
MAX_STRAY = 0.02
#: Least distance of a corner of the tag from the image, px, by a homography, for the tag to be cut.
CUT_PX = 10.0

NamedBy = Literal["tag", "part of the tag", "expected pose"]


class Candidates(NamedTuple):
    """Possible stars."""

    nodes: Ints  # (N, 2) int64, columns and rows of the target
    points: Array  # (N, 2) float64, px

    def select(self, mask: Bools) -> Candidates:
        """Return some of them by an (N,) mask, in the same order."""
        return Candidates(self.nodes[mask], self.points[mask])


def find_candidates(
    image: AnyArray, smoothed: Array32, target: StarTarget, expected: Array | None, *, name: str
) -> tuple[Candidates, float, NamedBy]:
    """Find possible stars, starting at the tag if it can be read; the sign is +1 if white is bright, -1 if it is dark.

    ``expected`` is the (3, 3) homography from the target's grid to px, by the pose; None if it is not known.
    Raises StarsUnnamed: If neither the tag nor an expected pose identifies the stars.
    Raises TargetNotFound: If the image shows no stars, a wrong tag, or the tag more than once.
    """
    picture = to_uint8(image)
    tag = find_tag(picture, target, name=name, reduced_only=True)
    if tag is None:
        # The pictures of full size take long, and never show a tag that the border of the image cuts.
        found = find_without_tag(smoothed, target, expected, name)
        if not _is_tag_cut(smoothed, found, target):
            tag = find_tag(picture, target, name=name)
    if tag is None:
        return _label_without_tag(found, target, expected, name)
    grown = grow_star_grid(smoothed, start_at_tag(tag, target), target.segments, lambda n: printed(target, n))
    return Candidates(grown.nodes(), grown.places()), tag.sign, "tag"


def printed(target: StarTarget, nodes: Ints) -> Bools:
    """Return whether a star is printed at each of (N, 2) nodes, (N,)."""
    return np.asarray(target.id_at(nodes[:, 0], nodes[:, 1]) >= 0)


class Unlabelled(NamedTuple):
    """Stars on a relative grid, where growth started (None if nowhere), and their labels by a part of the tag."""

    grown: StarGrid
    start: GrowthStart | None
    labels: StarLabels | StarsUnnamed | None


def find_without_tag(image: Array32, target: StarTarget, expected: Array | None, name: str) -> Unlabelled:
    """Find possible stars starting at any of them, and label them by the visible part of the tag if possible."""
    start = find_lattice(image, target.segments)
    starts = [start] if start is not None else _starts_as_expected(image, expected)
    size = max(target.columns, target.rows)
    grown = StarGrid()
    for tried in starts:
        found = grow_star_grid(
            image, tried, target.segments, lambda nodes: np.asarray((np.abs(nodes) < size).all(axis=1))
        )
        if len(found.points) > len(grown.points):
            start, grown = tried, found
    if start is None or len(grown.points) < MIN_STARS:
        return Unlabelled(grown, None, None)
    try:
        return Unlabelled(grown, start, label_by_tag(image, grown, start.sign, target, name=name))
    except StarsUnnamed as unnamed:
        return Unlabelled(grown, start, unnamed)


def _is_tag_cut(image: Array32, found: Unlabelled, target: StarTarget) -> bool:
    """Return whether the stars tell that a corner of the tag lies clearly outside of the image."""
    if not isinstance(found.labels, StarLabels):
        return False
    nodes = found.labels.apply(found.grown.nodes()).astype(float)
    homography = fit_homography(nodes, found.grown.places())
    corners = apply_homography(homography, target.tag_corners_mm / target.pitch_mm)
    last = np.array(image.shape[::-1]) - 1.0
    return bool(((corners < -CUT_PX) | (corners > last + CUT_PX)).any())


def _label_without_tag(
    found: Unlabelled, target: StarTarget, expected: Array | None, name: str
) -> tuple[Candidates, float, NamedBy]:
    """Return stars with their nodes, labelled by the visible part of the tag or by the pose."""
    grown, start, labels = found
    if start is None or labels is None:
        raise TargetNotFound(
            f"Tag {target.tag_id} of family {target.tag_family} is not in the image, and no stars are either.",
            where=f"view {name}",
            remedy="Turn the camera so that the tag is in view; check focus, light and the target's description.",
        )
    named_by: NamedBy = "part of the tag"
    if isinstance(labels, StarsUnnamed):
        if expected is None:
            raise labels
        labels, named_by = label_by_pose(grown, expected, name=name), "expected pose"
    nodes = labels.apply(grown.nodes())
    seen = printed(target, nodes)
    if np.count_nonzero(~seen) > MAX_STRAY * len(nodes):
        raise TargetNotFound(
            f"{np.count_nonzero(~seen)} of {len(nodes)} stars would lie where the target has none.",
            where=f"view {name}",
            remedy="Check the target's description and the expected pose.",
        )
    return Candidates(nodes, grown.places()).select(seen), start.sign, named_by


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
    nothing = np.zeros((0, 2))
    return [GrowthStart(expected, sign, nodes, nothing, nothing) for sign in (1.0, -1.0)]
