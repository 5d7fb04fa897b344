"""Finds straight edges in the events of a moving camera: in x, y and time, the events of an edge lie on a plane.

An edge that moves evenly sweeps a plane d = a + b s + c t, with s along the edge, d across it and t the time of an event.
The plane is looked for by samples of three events (Fischler and Bolles, 1981), in a band beside the segment that a person
marked. A quadratic in s, since the lens bends edges a little, and a term s t, since an edge also turns, then follow from all
events of one polarity near the plane. At the time of the picture, the edge is returned in pieces: a point for each.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from calib.arrays import Array, Bools
from calib.errors import TargetNotFound

#: Across the marked segment, px: how far the edge may be from it at the time of the picture, and how far events are used.
_MARKED_WITHIN_PX, _BAND_PX = 15.0, 35.0
#: Near its ends, px, an edge has the events of its neighbours beside its own.
_ENDS_PX = 15.0
#: Events this near to a plane are its own, px: first, then for the fit. The point spread is about 1 px wide.
_NEAR_PX, _FIT_PX = 2.0, 3.0
#: Samples of three events: with a fifth of the events on the edge, one in a hundred samples is right.
_SAMPLES, _SCORED = 800, 1500
_ROUNDS = 12
_SPEED = 3  # The term of the speed
_PIECE_PX, _FEWEST_PIECES, _FEWEST_EVENTS = 25.0, 3, 12
#: Neighbouring pixels and the time that a pixel needs give pieces errors in common, px.
_COMMON_PX = 0.02
#: Pieces of a right edge scatter by 0.01 to 0.03 px about a smooth curve; parts of several edges by far more, px.
_MOST_SCATTER_PX = 0.08


@dataclass(frozen=True)
class EdgePoints:
    """Points of an edge in the image at one time, each from a piece of the edge."""

    points_px: Array  # (N, 2)
    darkwards: Array  # (2,) unit vector across the edge, to its dark side
    sigma_px: Array  # (N,) standard uncertainty across the edge

    @property
    def line(self) -> Array:
        """(3,) homogeneous straight line through the points, weighted: l . [u v 1] = 0, in px across the line."""
        weights = 1.0 / self.sigma_px
        middle = np.average(self.points_px, axis=0, weights=weights**2)
        across = np.linalg.svd((self.points_px - middle) * weights[:, None])[2][1]
        return np.array([*across, -across @ middle])


def edge_points(
    events: tuple[Array, Array, Array, Array], at_us: float, marked_px: Array, rng: np.random.Generator
) -> EdgePoints:
    """Find the edge that a person marked by its ends, (2, 2) px, in events t, x, y, p, and where it is at ``at_us``.

    Raises TargetNotFound: If fewer than three pieces of the edge have enough events.
    """
    t, x, y, p = (np.asarray(part, np.float64) for part in events)
    begin, along = marked_px[0], marked_px[1] - marked_px[0]
    length = float(np.linalg.norm(along))
    along = along / length
    normal = np.array([-along[1], along[0]])
    from_begin = np.column_stack([x, y]) - begin
    s, d, late = from_begin @ along, from_begin @ normal, 1e-3 * (t - at_us)
    in_band = (s > _ENDS_PX) & (s < length - _ENDS_PX) & (np.abs(d) < _BAND_PX)
    swept = [np.column_stack([s, d, late])[in_band & ((p > 0) == on)] for on in (False, True)]
    of_plane = [_on_plane(each, length, rng) for each in swept]
    brighter = len(of_plane[True]) > len(of_plane[False])
    s, d, late = of_plane[brighter].T
    terms = _terms(s, late, length)
    coefficients, near = _fitted(terms, d)
    # Where an edge makes pixels brighter, it moves to its dark side.
    darkwards = normal * np.sign(coefficients[_SPEED]) * (1 if brighter else -1)
    count = max(_FEWEST_PIECES, int((length - 2 * _ENDS_PX) / _PIECE_PX))
    limits = np.linspace(_ENDS_PX, length - _ENDS_PX, count + 1)
    left = d - terms @ coefficients
    at, across, sigma = [], [], []
    for low, high in pairwise(limits):
        own = near & (s >= low) & (s < high)
        if np.count_nonzero(own) < _FEWEST_EVENTS:
            continue
        at.append(float(s[own].mean()))
        across.append(float(left[own].mean()))
        sigma.append(float(left[own].std() / np.sqrt(np.count_nonzero(own))))
    if len(at) < _FEWEST_PIECES:
        raise TargetNotFound(
            f"{len(at)} pieces of the edge have enough events; {_FEWEST_PIECES} are needed.",
            where="edge",
            remedy="Move the camera across the edge, not along it.",
        )
    if np.std(across) > _MOST_SCATTER_PX:
        raise TargetNotFound(
            f"The pieces of the edge scatter by {np.std(across):.2f} px.",
            where="edge",
            remedy="Mark the edge more exactly, or move the camera across it, not along it.",
        )
    places = np.array(at)
    offsets = np.array(across) + _terms(places, np.zeros(len(at)), length) @ coefficients
    points = begin + places[:, None] * along + offsets[:, None] * normal
    return EdgePoints(points, darkwards, np.hypot(sigma, _COMMON_PX))


def _terms(s: Array, late: Array, length: float) -> Array:
    """Return the (N, 5) terms of an edge that is bent a little, moves and turns."""
    share = s / length - 0.5
    return np.column_stack([np.ones_like(s), share, share**2, late, share * late])


def _on_plane(swept: Array, length: float, rng: np.random.Generator) -> Array:
    """Return the events (M, 3), s, d and time, near the plane that has the most of them."""
    if len(swept) < 3 * _FEWEST_EVENTS:
        return swept[:0]
    chosen = swept[rng.integers(len(swept), size=(_SAMPLES, 3))]
    design = np.stack([np.ones(chosen.shape[:2]), chosen[..., 0] / length, chosen[..., 2]], axis=-1)
    usable = np.abs(np.linalg.det(design)) > 0.1
    planes = np.linalg.solve(design[usable], chosen[usable][..., 1:2])[..., 0]
    ends = np.stack([planes[:, 0], planes[:, 0] + planes[:, 1]])
    planes = planes[(np.abs(ends) < _MARKED_WITHIN_PX).all(axis=0)]
    if not len(planes):
        return swept[:0]
    scored = swept[rng.permutation(len(swept))[:_SCORED]]
    terms = np.column_stack([np.ones(len(scored)), scored[:, 0] / length, scored[:, 2]])
    best = planes[np.argmax((np.abs(scored[:, 1] - planes @ terms.T) < _NEAR_PX).sum(axis=1))]
    everywhere = np.column_stack([np.ones(len(swept)), swept[:, 0] / length, swept[:, 2]])
    return np.asarray(swept[np.abs(swept[:, 1] - everywhere @ best) < 2 * _FIT_PX])


def _fitted(terms: Array, d: Array) -> tuple[Array, Bools]:
    """Return the least squares fit of the events near it, and which those are."""
    near = np.ones(len(d), np.bool_)
    coefficients = np.zeros(terms.shape[1])
    for _ in range(_ROUNDS):
        coefficients = np.linalg.lstsq(terms[near], d[near], rcond=None)[0]
        nearer = np.abs(d - terms @ coefficients) < _FIT_PX
        if np.count_nonzero(nearer) <= terms.shape[1] or (nearer == near).all():
            break
        near = nearer
    return coefficients, near
