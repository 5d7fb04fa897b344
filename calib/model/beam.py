"""The visible disc: the part of the target that the beam of a view lights.

The centre of the disc shows the camera's position in the pupil of the collimator, because the aperture cuts the beam.
The discs of one bench are alike, so those of all views are fitted together (`calib.model.rim_fit`): to the rims that
the images show, or between stars seen and not seen: there the rim passes between a star and a node of the grid without
one. Nodes that no view shows, amid the stars of all views, are not printed (the tag of a reticle) and say nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.arrays import Array, Bools, Ints
from calib.model.homography import apply_homography, view_homography
from calib.model.rim_fit import Disc, Discs, fit_rims
from calib.view import RimPoints, View

#: Least number of rim points for a fit.
_FEWEST_POINTS = 3
#: Stars farther than this from the grid's nodes, in pitches, are not on a grid.
_OFF_GRID = 0.1
#: A star closer than this to the frame's border, in pitches, may be missing for that reason: it needs its whole cell.
_BORDER_PITCHES = 1.0
#: The rim lies anywhere between two nodes: 1-sigma, in pitches.
_SIGMA = 12.0**-0.5
#: Nodes beyond the outermost stars that are looked at.
_MARGIN = 6
#: A node that differs from so many of its four neighbours is an error of finding stars, not a rim.
_ERROR = 3
#: Side of a square block of nodes.
_BLOCK = 3
#: In this share of the views, missed stars may pass for darkness beyond the rim.
_BY_CHANCE = 0.01
_NEIGHBOURS = np.array([(1, 0), (-1, 0), (0, 1), (0, -1)])
#: Nodes are amid the stars if, along each of these directions, some star lies farther out.
_DIRECTIONS = np.column_stack([np.cos(np.linspace(0.0, 6.2, 72)), np.sin(np.linspace(0.0, 6.2, 72))])
_OUT_OF_FRAME, _NOT_PRINTED, _ABSENT, _PRESENT = range(4)


def visible_discs(views: Sequence[View]) -> list[Disc]:
    """Return the disc of each view, as `discs_of`; none if the rim is nowhere in view."""
    discs = discs_of(views)
    return discs.of_views if discs else []


def discs_of(views: Sequence[View]) -> Discs | None:
    """Fit the discs of views to their rims if all were searched, else to stars; None if no rim is in view."""
    rims = [view.rim for view in views if view.rim is not None]
    if len(rims) < len(views) or all(len(rim.points_mm) < _FEWEST_POINTS for rim in rims):
        rims = rims_of_stars(views)
    if sum(len(rim.points_mm) for rim in rims) < _FEWEST_POINTS:
        return None
    looks = np.array([_look_mm(view) for view in views])
    discs = fit_rims(rims, looks, np.concatenate([view.target_mm for view in views]))
    return discs if any(disc.rim_visible for disc in discs.of_views) else None


def _look_mm(view: View) -> Array:
    """Return the (2,) point of the target, mm, that lies in the middle of the image."""
    middle = (np.array(view.image_size) - 1.0) / 2.0
    back = np.asarray(np.linalg.inv(view_homography(view)), np.float64)
    return np.asarray(apply_homography(back, middle[None, :])[0])


def inside_guard_band(view: View, disc: Disc, share: float) -> Bools:
    """Tell which stars, (N,), lie within a share of the disc's radius from its centre; all from a share of 1 on."""
    distance_mm = np.linalg.norm(view.target_mm - disc.centre_mm, axis=1)
    return np.asarray((distance_mm <= share * disc.radius_mm) | (share >= 1.0))


@dataclass(frozen=True)
class _Grid:
    """The nodes of a grid, one margin larger than the stars of all views."""

    first_mm: Array  # (2,)
    pitch_mm: float
    size: tuple[int, int]

    @property
    def nodes_mm(self) -> Array:
        """(M, 2) all nodes."""
        return self.first_mm + self.pitch_mm * np.indices(self.size).reshape(2, -1).T

    def marked(self, stars_mm: Array) -> Bools:
        """Return an array of the grid's size: which nodes have one of the (N, 2) stars."""
        is_marked = np.zeros(self.size, np.bool_)
        is_marked[tuple(np.round((stars_mm - self.first_mm) / self.pitch_mm).astype(np.int64).T)] = True
        return is_marked


def rims_of_stars(views: Sequence[View]) -> list[RimPoints]:
    """Return for each view the points of its rim; none if the stars are not on a grid."""
    stars = np.concatenate([view.target_mm for view in views])
    grid = _grid(stars)
    if grid is None:
        return [RimPoints(np.zeros((0, 2)), np.zeros(0), np.zeros((0, 2)), 0.0) for _ in views]
    amid = (grid.nodes_mm @ _DIRECTIONS.T <= (stars @ _DIRECTIONS.T).max(axis=0)).all(axis=1)
    not_printed = amid.reshape(grid.size) & ~grid.marked(stars)
    return [_rim(view, grid, not_printed) for view in views]


def _grid(stars: Array) -> _Grid | None:
    """Return the grid of (N, 2) stars, or None if they are not on one."""
    steps = np.concatenate([np.diff(np.unique(np.round(along, 6))) for along in stars.T])
    pitch = float(np.min(steps[steps > 1e-3 * np.ptp(stars, axis=0).max()]))
    first, last = stars.min(axis=0), stars.max(axis=0)
    nodes = (stars - first) / pitch
    if np.abs(nodes - np.round(nodes)).max() > _OFF_GRID:
        return None
    columns, rows = np.round((last - first) / pitch).astype(int) + 2 * _MARGIN + 1
    return _Grid(first - _MARGIN * pitch, pitch, (int(columns), int(rows)))


def _rim(view: View, grid: _Grid, not_printed: Bools) -> RimPoints:
    """Return the points of the rim of one view, and its outermost stars at the border of the frame."""
    state = np.where(_framed(view, grid), _ABSENT, _OUT_OF_FRAME)
    state[not_printed] = _NOT_PRINTED
    state[grid.marked(view.target_mm)] = _PRESENT
    opposite = np.where(state == _PRESENT, _ABSENT, _PRESENT)
    errors = (_around(state) == opposite).sum(axis=0) >= _ERROR
    state[(errors & (state >= _ABSENT)) | ((state == _ABSENT) & ~_dark(state))] = _NOT_PRINTED
    around, present = _around(state), state == _PRESENT
    nodes = grid.nodes_mm.reshape(*grid.size, 2)
    points = [
        nodes[present & (neighbour == _ABSENT)] + 0.5 * grid.pitch_mm * step
        for step, neighbour in zip(_NEIGHBOURS, around, strict=True)
    ]
    rim = np.concatenate(points)
    lit = present & (around == _OUT_OF_FRAME).any(axis=0) & ~(around == _ABSENT).any(axis=0)
    return RimPoints(rim, np.full(len(rim), _SIGMA * grid.pitch_mm), nodes[lit], 0.0)


def _dark(state: Ints) -> Bools:
    """Tell which nodes may lie beyond the rim: they are in a block without a star that is too large for missed stars.

    Dark nodes between four stars show which share m of the stars is missed. If there are none, all nodes may lie beyond
    the rim. Own rule: k nodes together are beyond the rim if m^k times the number of nodes is below `_BY_CHANCE`.
    """
    amid = (_around(state) == _PRESENT).all(axis=0) & (state >= _ABSENT)
    missed = float((state[amid] == _ABSENT).sum()) / (amid.sum() + 1.0)
    if missed == 0.0:
        return np.ones(state.shape, np.bool_)
    needed = np.log(_BY_CHANCE / (state >= _ABSENT).sum()) / np.log(missed)
    wide = np.pad(state, _BLOCK - 1, constant_values=_OUT_OF_FRAME)
    blocks = np.lib.stride_tricks.sliding_window_view(wide, (_BLOCK, _BLOCK))
    starless = np.isin(blocks, (_OUT_OF_FRAME, _ABSENT)).all(axis=(2, 3))
    starless &= (blocks == _ABSENT).sum(axis=(2, 3)) >= min(needed, _BLOCK**2)
    return np.asarray(np.lib.stride_tricks.sliding_window_view(starless, (_BLOCK, _BLOCK)).any(axis=(2, 3)))


def _around(state: Ints) -> Ints:
    """Return (4, ...) the states of the four neighbours of each node; the border's outer ones are out of the frame."""
    wide = np.pad(state, 1, constant_values=_OUT_OF_FRAME)
    return np.stack([np.roll(wide, tuple(-step), (0, 1))[1:-1, 1:-1] for step in _NEIGHBOURS])


def _framed(view: View, grid: _Grid) -> Bools:
    """Return an array of the grid's size: which nodes are in the frame, and not at its border."""
    h, nodes = view_homography(view), grid.nodes_mm
    in_front = nodes @ h[2, :2] + h[2, 2] > 0
    pixels = apply_homography(h, nodes)
    neighbours = apply_homography(h, nodes + np.array([grid.pitch_mm, 0.0]))
    border = _BORDER_PITCHES * np.linalg.norm(neighbours - pixels, axis=1)[:, None]
    inside = ((pixels > border) & (pixels < np.array(view.image_size) - 1 - border)).all(axis=1)
    return np.asarray((inside & in_front).reshape(grid.size))
