"""Where stars are, by the likelihood of every pixel's brightness: what the view itself teaches about its pixels.

Knows the print around a star and stars already placed to a few hundredths of a pixel; nothing of how events come
about. A threshold makes event images nearly black and white; symmetry then treats each pixel at an edge as a coin
tossed, though it says on which side of it the edge lies. Here every pixel near an edge speaks by what is known of
pixels at that distance from an edge:

1. tau, for every pixel of every star: its signed distance, px, from the nearest edge of the print (white
   positive), by the stars' present centres. It is read from one blurred star, T, as tau = sigma Phi^-1(T).
2. P(level | tau): how often pixels at that distance show each level of brightness, counted over the whole view and
   smoothed over tau.
3. Each star moves to the most likely centre, by Fisher scoring on

       log L = sum over pixels of log P(level | tau(c) + a + b.s),

   a and b (a shift of the threshold, and its slope across the star) taking up light that is uneven.

The steps are repeated while P sharpens. What a mistaken blur or P does is even under half a turn, as the print is,
and so cannot move a centre.

Pixels along one edge do not speak independently where the edge runs along the pixel grid. How much the scores of
an edge scatter over all stars, beyond what the likelihood promises, is measured for each edge direction, and its
weight lowered by as much.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from calib.stars.centring import LocalMap
from calib.stars.edge_pixels import (
    TAU_BIN_PX,
    UNKNOWNS,
    ScoreTables,
    count_levels,
    edge_scores,
    gather_edge_pixels,
)
from calib.stars.printed_star import EdgeMap, blurred_edge_map, render_star
from calib.target import StarTarget

#: Blurs of the print that tau is read from, px: lens and pixel together. The one that tells most is taken; what
#: still differs is absorbed by P.
PRINT_BLURS_PX = (0.5, 0.75, 1.1, 1.6, 2.3)
#: Stars on which blurs are compared.
BLUR_STARS = 30
#: Smoothing of P over tau, px, from round to round; each round moves the stars this many times.
BANDWIDTHS_PX = (0.12, 0.08, 0.05)
MOVES = 2
#: Pixels' worth of "any level, as overall" mixed into every P.
PSEUDO_COUNT = 2.0
#: Prior sigma of the shift, px, and of its slopes, px a pitch.
SHIFT_SIGMA, SLOPE_SIGMA = 0.3, 0.1
#: Excess of an edge's scatter, in units of the median edge's, that is believed.
EXCESS_RANGE = (0.5, 50.0)
#: Round after which it is measured.
EXCESS_AFTER = 1
_RIDGE = 1e-6
#: Furthest a star moves at once, px.
MAX_MOVE_PX = 0.15


class LikelihoodFit(NamedTuple):
    """Most likely stars.

    Attributes
    ----------
    centres
        (N, 2) px.
    covariances
        (N, 2, 2) px^2, as the likelihood promises them.
    steepness
        (N,) length of b, px a pitch: how uneven the light is across the star.
    """

    centres: NDArray[np.float64]
    covariances: NDArray[np.float64]
    steepness: NDArray[np.float64]


def refine_by_likelihood(
    levels: NDArray[np.uint8], centres: NDArray[np.float64], shape: LocalMap, target: StarTarget
) -> LikelihoodFit:
    """Move stars to their most likely centres.

    Parameters
    ----------
    levels
        (H, W) from `quantise`, of the image as it is, not smoothed.
    centres
        (N, 2) px, right to about 0.1 px; some dozens at least, for P to be learnt from.
    shape
        The map around each star.
    target
        The printed target.
    """
    pitch = float(np.sqrt(np.median(np.abs(np.linalg.det(shape.linear)))))
    drawn = _likely_print(levels, centres, shape, target, pitch)
    pixels = gather_edge_pixels(levels, centres, shape.linear, shape.curved, drawn)
    unknowns = np.zeros((len(centres), UNKNOWNS))
    excess = np.ones(target.segments)
    for number, bandwidth in enumerate(BANDWIDTHS_PX):
        tables = _learn(count_levels(pixels, unknowns, drawn.limit_px), bandwidth / TAU_BIN_PX)
        for _ in range(MOVES):
            score, fisher = edge_scores(pixels, unknowns, tables, drawn.limit_px, target.segments)
            prior = _prior(unknowns)
            normal = np.einsum("e,neij->nij", 1.0 / excess, fisher)
            normal += (prior + _RIDGE)[:, :, None] * np.eye(UNKNOWNS)
            right = np.einsum("e,nei->ni", 1.0 / excess, score) - prior * unknowns
            step = np.linalg.solve(normal, right[:, :, None])[:, :, 0]
            unknowns += np.clip(step, -MAX_MOVE_PX, MAX_MOVE_PX)
        if number == EXCESS_AFTER:
            excess = _excess(score, fisher)
    steepness = np.linalg.norm(unknowns[:, 3:], axis=1)
    return LikelihoodFit(centres + unknowns[:, :2], np.linalg.inv(normal)[:, :2, :2], steepness)


def _prior(unknowns: NDArray[np.float64]) -> NDArray[np.float64]:
    """Precision of the unknowns beforehand, (N, 5).

    Slopes are small nearly everywhere, and large at the rim of the disc: a Cauchy prior, by its weights.
    """
    prior = np.zeros_like(unknowns)
    prior[:, 2] = SHIFT_SIGMA**-2
    steepness = (unknowns[:, 3:] ** 2).sum(axis=1, keepdims=True)
    prior[:, 3:] = 3.0 / (SLOPE_SIGMA**2 + steepness)
    return prior


def _likely_print(
    levels: NDArray[np.uint8],
    centres: NDArray[np.float64],
    shape: LocalMap,
    target: StarTarget,
    pitch: float,
) -> EdgeMap:
    """Draw the star with the blur that tells most of the centres, judged on some of the stars.

    What a blur tells rises up to the right one and falls beyond it.
    """
    some = slice(None, None, max(1, len(centres) // BLUR_STARS))
    at = np.zeros((len(centres[some]), UNKNOWNS))
    sharp = render_star(target, pitch)
    best, most = None, -np.inf
    for blur in PRINT_BLURS_PX:
        drawn = blurred_edge_map(sharp, target.segments, pitch, blur)
        pixels = gather_edge_pixels(levels, centres[some], shape.linear[some], shape.curved[some], drawn)
        tables = _learn(count_levels(pixels, at, drawn.limit_px), BANDWIDTHS_PX[0] / TAU_BIN_PX)
        _, fisher = edge_scores(pixels, at, tables, drawn.limit_px, target.segments)
        told = float(np.trace(fisher.sum(axis=(0, 1))[:2, :2]))
        if best is not None and told < most:
            break
        best, most = drawn, told
    assert best is not None
    return best


def _excess(score: NDArray[np.float64], fisher: NDArray[np.float64]) -> NDArray[np.float64]:
    """By how much the scores of each edge scatter more than promised; the same for opposite edges.

    Variance components by their moments (MINQUE): with H the sum of all F_e, what is left of the score of edge e
    after the star has moved is r_e = s_e - F_e H^-1 sum(s), so that with Cov(s_e) = phi_e F_e

        E |r_e|^2 = sum over f of phi_f tr (d_ef - F_e H^-1) F_f (d_ef - F_e H^-1)^T .

    An edge and the one opposite must weigh the same, or a mistaken P would move the centre.
    """
    half = score.shape[1] // 2
    pair_score = score[:, :half] + score[:, half:]
    pair_fisher = fisher[:, :half] + fisher[:, half:]
    total = pair_fisher.sum(axis=1) + _RIDGE * np.eye(UNKNOWNS)
    gain = pair_fisher @ np.linalg.inv(total)[:, None]
    left = pair_score - np.einsum("neij,nj->nei", gain, pair_score.sum(axis=1))
    measured = np.mean(left[:, :, 0] ** 2 + left[:, :, 1] ** 2, axis=0)
    expected = np.empty((half, half))
    for e in range(half):
        for f in range(half):
            through = (np.eye(UNKNOWNS) if e == f else 0.0) - gain[:, e]
            spread = np.einsum("nij,njk,nlk->nil", through, pair_fisher[:, f], through)
            expected[e, f] = np.mean(spread[:, 0, 0] + spread[:, 1, 1])
    excess = np.linalg.solve(expected + 1e-9 * np.eye(half) * np.trace(expected), measured)
    typical = max(float(np.median(excess)), 1e-3)
    return np.tile(np.clip(excess, EXCESS_RANGE[0] * typical, EXCESS_RANGE[1] * typical), 2)


def _learn(counts: NDArray[np.float64], bandwidth_bins: float) -> ScoreTables:
    """Turn counts of levels over tau into P, smoothed over tau, and that into derivatives and information."""
    reach = int(4 * bandwidth_bins) + 1
    steps = np.arange(-reach, reach + 1)
    kernel = np.exp(-0.5 * (steps / bandwidth_bins) ** 2)
    kernel /= kernel.sum()
    smooth = np.array([np.convolve(row, kernel, "same") for row in counts])
    overall = (counts.sum(axis=1, keepdims=True) + 1.0) / (counts.sum() + len(counts))
    share = (smooth + PSEUDO_COUNT * overall) / (smooth.sum(axis=0) + PSEUDO_COUNT)
    slope = np.gradient(share, axis=1) / TAU_BIN_PX
    return ScoreTables(slope / share, (slope**2 / share).sum(axis=0))
