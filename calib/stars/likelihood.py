"""Centres of stars by maximum likelihood of the brightness of all pixels near their edges.

The module uses the print around a star, and stars that are already located to a few hundredths of a pixel. It does not
use a model of how events arise.

A threshold makes event images nearly black and white. Symmetry then treats each pixel at an edge as a random one,
although its brightness shows on which side of the edge the pixel lies. Here the statistics of such pixels are learnt
from the view itself:

1. For every pixel of every star, tau is the signed distance, px, from the nearest printed edge, positive on white, for
   the current centres. It is read from one blurred printed star (`calib.stars.printed_star`).
2. P(level | tau) is the share of the pixels at that distance that have this level of brightness, counted over the
   whole view and smoothed over tau.
3. Each star moves to its most likely centre c, by Fisher scoring on

       log L = sum over pixels of log P(level | tau(c) + a + b.s).

   Here s is the position within the star, pitches. The shift a of the threshold, px, and its slope b, px per pitch,
   absorb uneven light. The inverse of the Fisher information is the covariance (Cramér-Rao bound).

The steps are repeated while the smoothing becomes narrower. The print is unchanged by half a turn, and so are the
effects of a wrong blur or a wrong P. Therefore these cannot move a centre.

Pixels along one edge are not independent if the edge runs along the pixel grid. So the scatter of the scores of each
edge direction over all stars is compared with the Fisher information, and the weight of the direction is divided by the
ratio (its overdispersion).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, lru_cache
from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter1d

from calib.arrays import Array, Array32, Bools, Bytes, selected
from calib.stars.edge_pixels import (
    EDGE_UNKNOWNS,
    TAU_BIN_PX,
    ScoreTables,
    count_levels,
    edge_scores,
    gather_edge_pixels,
)
from calib.stars.grid_map import LocalMap
from calib.stars.printed_star import EdgeMap, blurred_edge_map, render_star
from calib.target import StarTarget

#: Blurs of lens and pixel together that are tried, px. The one with most information about the centres is used; P
#: absorbs the remaining difference.
BLURS_PX = (0.5, 0.75, 1.1, 1.6, 2.3)
#: Least and largest width of an edge that is measured, px, and step of its logarithm, between which a parabola is
#: drawn. From 2 px on, what is measured does not grow any more.
EDGE_WIDTHS_PX, EDGE_WIDTH_STEP = (0.25, 4.0), 0.2
#: About the number of stars on which the blurs are compared: the blur is much the same for all stars of a view.
BLUR_STARS = 30
#: Standard deviation of the smoothing of P over tau in each round, px: it falls as the centres become right.
BANDWIDTHS_PX = (0.12, 0.08, 0.05)
#: Number of scoring steps in each round.
STEPS_PER_ROUND = 2
#: Number of pixels with the overall distribution of levels that are mixed into every bin of P, so that no share is
#: zero.
PSEUDO_COUNT = 2.0
#: Prior standard deviation of the shift of the threshold, px, and scale of the prior of its slope, px per pitch.
SHIFT_SIGMA, SLOPE_SIGMA = 0.3, 0.1
#: Least and largest overdispersion of an edge, in units of the median edge's: that of one edge is estimated with noise,
#: and may come out negative.
OVERDISPERSION_RANGE = (0.5, 50.0)
#: Number of the round, from 0, after which the overdispersion is measured: the centres are right by then, and the last
#: round uses it.
OVERDISPERSION_ROUND = 1
#: Largest step of an unknown, px or px per pitch: the first centres are right to about 0.1 px.
MAX_STEP_PX = 0.15
#: Decimals of the pitch at which the printed star is drawn, px. It is drawn by samples: rounding errors of the pitch
#: would decide on which side of an edge some of them fall, and would move centres by a thousandth of a pixel.
PITCH_DIGITS = 6
_RIDGE = 1e-6  # Keeps a star without edges solvable


class LikelihoodFit(NamedTuple):
    """Most likely centres of N stars."""

    centres: Array  # (N, 2) float64, px
    # (N, 2, 2) float64, px^2, from the Fisher information, weighted by the overdispersion.
    covariances: Array
    # (N,) float64, px per pitch, length of b: how uneven the light is across the star.
    light_slope: Array
    blur_px: float  # Blur of the printed star with which its pixels told most about the centres


def refine_by_likelihood(
    levels: Bytes,
    centres: Array,
    local_map: LocalMap,
    target: StarTarget,
    is_open: Bools | None = None,
) -> LikelihoodFit:
    """Move stars to their most likely centres, in their order.

    Fisher scoring: Osborne (1992). Covariances: Cramér-Rao bound (Rao, 1945). The head of the module gives the
    likelihood, which is this project's own. The levels are those of the image before smoothing; the centres are right
    to about 0.1 px. Several dozen stars are needed, because P is learnt from them. ``is_open`` is from
    `calib.stars.printed_star`; None if all stars lie between stars.
    """
    pitch = round(local_map.pitch_px, PITCH_DIGITS)
    blur_px = max(BLURS_PX, key=_information_by_blur(levels, centres, local_map, target, pitch))
    edge_map = _edge_map(target, pitch, blur_px)
    pixels = gather_edge_pixels(levels, centres, local_map, edge_map, is_open)
    unknowns = np.zeros((len(centres), EDGE_UNKNOWNS))
    overdispersion = np.ones(target.segments)
    for number, bandwidth in enumerate(BANDWIDTHS_PX):
        tables = _score_tables(count_levels(pixels, unknowns, edge_map.limit_px), bandwidth / TAU_BIN_PX)
        for _ in range(STEPS_PER_ROUND):
            score, fisher = edge_scores(pixels, unknowns, tables, edge_map.limit_px, target.segments)
            prior = _prior_precision(unknowns)
            normal = np.einsum("e,neij->nij", 1.0 / overdispersion, fisher)
            normal += (prior + _RIDGE)[:, :, None] * np.eye(EDGE_UNKNOWNS)
            right = np.einsum("e,nei->ni", 1.0 / overdispersion, score) - prior * unknowns
            step = np.linalg.solve(normal, right[:, :, None])[:, :, 0]
            unknowns += np.clip(step, -MAX_STEP_PX, MAX_STEP_PX)
        if number == OVERDISPERSION_ROUND:
            overdispersion = overdispersion_of_edges(score, fisher)
    light_slope = np.linalg.norm(unknowns[:, 3:], axis=1)
    covariances = np.linalg.inv(normal)[:, :2, :2]
    return LikelihoodFit(centres + unknowns[:, :2], covariances, light_slope, blur_px)


def edge_width_px(
    levels: Bytes,
    centres: Array,
    local_map: LocalMap,
    target: StarTarget,
    *,
    pitch_px: float | None = None,
    start_px: float | None = None,
) -> float:
    """Measure the standard deviation, px, of the stars' blur by lens and pixel together, between `EDGE_WIDTHS_PX`.

    The printed star is blurred by Gaussians of several widths. The width is that with which the pixels near the edges
    give most information about the centres (own criterion): the vertex of a parabola over its logarithm. On simulated
    recordings, it is 0.8 to 1.0 of the blur by lens and pixel up to 2 px, under a square and under a sine flicker; it
    does not grow beyond that. Levels and centres are those of `refine_by_likelihood`. The blurred printed stars are
    kept for the next call with the same pitch; None takes it from ``local_map``. None for the start is the middle of
    `EDGE_WIDTHS_PX`.
    """
    pitch = round(local_map.pitch_px, PITCH_DIGITS) if pitch_px is None else pitch_px
    information = _information_by_blur(levels, centres, local_map, target, pitch)
    steps = np.arange(np.log(EDGE_WIDTHS_PX[0]), np.log(EDGE_WIDTHS_PX[1]), EDGE_WIDTH_STEP)
    blurs = np.exp(steps).tolist()
    k = len(blurs) // 2 if start_px is None else int(np.argmin(np.abs(steps - np.log(start_px))))
    while k + 1 < len(blurs) and information(blurs[k + 1]) > information(blurs[k]):
        k += 1
    while k > 0 and information(blurs[k - 1]) > information(blurs[k]):
        k -= 1
    if k in (0, len(blurs) - 1):
        return float(blurs[k])
    low, top, high = (information(blurs[i]) for i in (k - 1, k, k + 1))
    bend = low - 2.0 * top + high
    shift = 0.5 * (low - high) / bend if bend < 0.0 else 0.0
    return float(np.exp(steps[k] + shift * EDGE_WIDTH_STEP))


def _prior_precision(unknowns: Array) -> Array:
    """Return the prior precision of the unknowns, (N, 5).

    Slopes are small nearly everywhere and large at the rim of the disc. Their prior is a bivariate Cauchy distribution
    (Student's with one degree of freedom), by iteratively reweighted least squares: in two dimensions its weight is 3 /
    (s^2 + b^2) (Lange, Little and Taylor, 1989).
    """
    prior = np.zeros_like(unknowns)
    prior[:, 2] = SHIFT_SIGMA**-2
    square = (unknowns[:, 3:] ** 2).sum(axis=1, keepdims=True)
    prior[:, 3:] = 3.0 / (SLOPE_SIGMA**2 + square)
    return prior


@lru_cache(maxsize=2)
def _sharp_star(target: StarTarget, pitch: float) -> Array32:
    # Stars drawn at nearly the same pitch do not do: one part in a hundred moves centres by some thousandths of a px.
    return render_star(target, pitch)


@lru_cache(maxsize=8)
def _edge_map(target: StarTarget, pitch: float, blur_px: float) -> EdgeMap:
    """Return the printed star with a blur."""
    return blurred_edge_map(_sharp_star(target, pitch), target.segments, pitch, blur_px)


def _information_by_blur(
    levels: Bytes, centres: Array, local_map: LocalMap, target: StarTarget, pitch: float
) -> Callable[[float], float]:
    """Return the information of some of the stars about their centres, by the blur of the printed star.

    The trace of the Fisher information, 1/px^2; it is kept for each blur.
    """
    some = slice(None, None, max(1, len(centres) // BLUR_STARS))
    centres, local_map = centres[some], selected(local_map, some)

    @cache
    def trace(blur_px: float) -> float:
        edge_map = _edge_map(target, pitch, blur_px)
        unknowns = np.zeros((len(centres), EDGE_UNKNOWNS))
        pixels = gather_edge_pixels(levels, centres, local_map, edge_map)
        counts = count_levels(pixels, unknowns, edge_map.limit_px)
        tables = _score_tables(counts, BANDWIDTHS_PX[0] / TAU_BIN_PX)
        _, fisher = edge_scores(pixels, unknowns, tables, edge_map.limit_px, target.segments)
        return float(np.trace(fisher.sum(axis=(0, 1))[:2, :2]))

    return trace


def overdispersion_of_edges(score: Array, fisher: Array) -> Array:
    """Return by how much the scores of each edge scatter more than the Fisher information says, (edges,).

    The variance components are estimated by their moments (MINQUE; Rao 1971). Let H be the sum of all F_e. After the
    star has moved, the remaining score of edge e is r_e = s_e - F_e H^-1 sum(s). With Cov(s_e) = phi_e F_e,

        E |r_e|^2 = sum over f of phi_f tr (d_ef - F_e H^-1) F_f (d_ef - F_e H^-1)^T ,

    where the trace is taken over the centre's two components. Opposite edges get the same value; otherwise a wrong P
    would move the centre.
    """
    half = score.shape[1] // 2
    pair_score = score[:, :half] + score[:, half:]
    pair_fisher = fisher[:, :half] + fisher[:, half:]
    total = pair_fisher.sum(axis=1) + _RIDGE * np.eye(EDGE_UNKNOWNS)
    gain = pair_fisher @ np.linalg.inv(total)[:, None]
    left = pair_score - np.einsum("neij,nj->nei", gain, pair_score.sum(axis=1))
    measured = np.mean(left[:, :, 0] ** 2 + left[:, :, 1] ** 2, axis=0)
    rows = np.eye(half)[:, :, None, None] * np.eye(2, EDGE_UNKNOWNS) - gain[:, :, None, :2]
    expected = ((rows @ pair_fisher[:, None]) * rows).sum(axis=(0, 3, 4)) / len(score)
    ratio = np.linalg.solve(expected + 1e-9 * np.eye(half) * np.trace(expected), measured)
    typical = max(float(np.median(ratio)), 1e-3)
    lowest, highest = OVERDISPERSION_RANGE
    return np.tile(np.clip(ratio, lowest * typical, highest * typical), 2)


def _score_tables(counts: Array, bandwidth_bins: float) -> ScoreTables:
    """Turn (LEVELS, bins) counts into P(level | tau), smoothed over tau by a Gaussian, and P into scores.

    The shares are a kernel regression of the levels on tau (Nadaraya, 1964; Watson, 1964). Score: P' / P. Fisher
    information: sum over the levels of P'^2 / P.
    """
    reach = int(4 * bandwidth_bins) + 1
    smoothed = gaussian_filter1d(counts, bandwidth_bins, axis=1, mode="constant", radius=reach)
    overall = (counts.sum(axis=1, keepdims=True) + 1.0) / (counts.sum() + len(counts))
    share = (smoothed + PSEUDO_COUNT * overall) / (smoothed.sum(axis=0) + PSEUDO_COUNT)
    slope = np.gradient(share, axis=1) / TAU_BIN_PX
    score = slope / share
    return ScoreTables(score.astype(np.float32), (slope * score).sum(axis=0).astype(np.float32))
