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

from typing import Any, NamedTuple

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.special import ndtri

from calib.star_refine import SYMMETRY_REACH, LocalShape
from calib.target import StarTarget

#: Blurs of the print that tau is read from, px: lens and pixel together. The one that tells most is taken; what
#: still differs is absorbed by P.
PRINT_BLURS_PX = (0.5, 0.75, 1.1, 1.6, 2.3)
#: Stars on which blurs are compared.
BLUR_STARS = 30
#: Samples of the print a px.
OVERSAMPLING = 6
#: Half the side of the print drawn, in pitches: a star and the rim of its neighbours.
PRINT_REACH = 0.62
#: Furthest distance looked at, in blurs, and bins of tau, px.
TAU_LIMIT_BLURS, TAU_BIN_PX = 3.2, 0.03
#: Smoothing of P over tau, px, from round to round; each round moves the stars this many times.
BANDWIDTHS_PX = (0.12, 0.08, 0.05)
MOVES = 2
#: Pixels' worth of "any level, as overall" mixed into every P.
PSEUDO_COUNT = 2.0
#: Levels of brightness told apart.
LEVELS = 64
#: Centre x, y; shift of the threshold; its slopes.
UNKNOWNS = 5
#: Prior sigma of the shift, px, and of its slopes, px a pitch.
SHIFT_SIGMA, SLOPE_SIGMA = 0.3, 0.1
#: Excess of an edge's scatter, in units of the median edge's, that is believed.
EXCESS_RANGE = (0.5, 50.0)
#: Round after which it is measured.
EXCESS_AFTER = 1
_RIDGE = 1e-6
#: Furthest a star moves at once, px.
MAX_MOVE_PX = 0.15


class Print(NamedTuple):
    """One star, drawn finely: tau, px, and the number of the nearest edge, on a grid around its centre."""

    tau: NDArray[np.float32]
    edge: NDArray[np.uint8]
    half: int
    samples_per_pitch: float
    limit_px: float


class _Pixels(NamedTuple):
    """All pixels near an edge of all stars, one after the other; star k has those from first[k] to first[k + 1].

    Attributes
    ----------
    first
        (N + 1,) int64.
    tau
        (M,) px, by the centres first given.
    slope
        (M, 5) float32, how tau changes with each of the star's unknowns.
    edge, level
        (M,) uint8, number of the nearest edge, level of brightness.
    """

    first: NDArray[np.int64]
    tau: NDArray[np.float32]
    slope: NDArray[np.float32]
    edge: NDArray[np.uint8]
    level: NDArray[np.uint8]


class LikelyStars(NamedTuple):
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


class _Tables(NamedTuple):
    """Of the levels' probabilities over tau: d log P / d tau (levels, bins), and Fisher's information (bins,)."""

    score: NDArray[np.float64]
    fisher: NDArray[np.float64]


def quantise(image: NDArray[Any]) -> NDArray[np.uint8]:
    """Return an image as at most `LEVELS` levels, (H, W): its own values where they are few, else equal shares.

    Examples
    --------
    >>> quantise(np.array([[0.0, 0.5], [1.0, 0.5]])).tolist()
    [[0, 1], [2, 1]]
    """
    sample = image.ravel()[:: max(1, image.size // 200_000)]
    values = np.unique(sample)
    if values.size > LEVELS:
        borders = np.unique(np.quantile(sample, np.linspace(0.0, 1.0, LEVELS + 1)[1:-1]))
    else:
        borders = (values[1:].astype(float) + values[:-1].astype(float)) / 2.0
    if image.dtype.kind == "u" and image.dtype.itemsize <= 2:
        every = np.arange(int(image.max()) + 1)
        return np.searchsorted(borders, every, side="right").astype(np.uint8)[image]
    return np.searchsorted(borders, image, side="right").astype(np.uint8)


def likely_stars(
    levels: NDArray[np.uint8], centres: NDArray[np.float64], shape: LocalShape, target: StarTarget
) -> LikelyStars:
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
    pixels = _pixels(levels, centres, shape.linear, shape.curved, drawn)
    unknowns = np.zeros((len(centres), UNKNOWNS))
    excess = np.ones(target.segments)
    for number, bandwidth in enumerate(BANDWIDTHS_PX):
        tables = _learn(_count(pixels, unknowns, drawn.limit_px), bandwidth / TAU_BIN_PX)
        for _ in range(MOVES):
            score, fisher = _scores(pixels, unknowns, tables, drawn.limit_px, target.segments)
            prior = _prior(unknowns)
            normal = np.einsum("e,neij->nij", 1.0 / excess, fisher)
            normal += (prior + _RIDGE)[:, :, None] * np.eye(UNKNOWNS)
            right = np.einsum("e,nei->ni", 1.0 / excess, score) - prior * unknowns
            step = np.linalg.solve(normal, right[:, :, None])[:, :, 0]
            unknowns += np.clip(step, -MAX_MOVE_PX, MAX_MOVE_PX)
        if number == EXCESS_AFTER:
            excess = _excess(score, fisher)
    steepness = np.linalg.norm(unknowns[:, 3:], axis=1)
    return LikelyStars(centres + unknowns[:, :2], np.linalg.inv(normal)[:, :2, :2], steepness)


def draw_print(target: StarTarget, pitch_px: float, blur_px: float) -> Print:
    """Draw a star among its neighbours, blurred, as finely as refinement asks for at that pitch."""
    return _blurred(_sharp_print(target, pitch_px), target.segments, pitch_px, blur_px)


def _sharp_print(target: StarTarget, pitch_px: float) -> NDArray[np.float64]:
    """Brightness around a star that has all its neighbours, on the grid of a `Print`."""
    columns, rows = np.meshgrid(np.arange(1, target.columns - 1), np.arange(1, target.rows - 1))
    whole = np.ones(columns.shape, bool)
    for dc in (-1, 0, 1):
        for dr in (-1, 0, 1):
            whole &= target.id_at(columns + dc, rows + dr) >= 0
    at = int(np.argmax(whole))
    u, v = _print_grid(pitch_px)
    x, y = (columns.ravel()[at] + u) * target.pitch_mm, (rows.ravel()[at] + v) * target.pitch_mm
    return target.reflectance(x, y)


def _print_grid(pitch_px: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Places of a print's samples, in pitches from the star."""
    half = int(np.ceil(PRINT_REACH * pitch_px * OVERSAMPLING))
    steps = np.arange(-half, half + 1) / (pitch_px * OVERSAMPLING)
    u, v = np.meshgrid(steps, steps)
    return u, v


def _blurred(sharp: NDArray[np.float64], segments: int, pitch_px: float, blur_px: float) -> Print:
    """Blur a sharp print, and read tau and the nearest edges off it."""
    blurred = cv2.GaussianBlur(sharp, (0, 0), blur_px * OVERSAMPLING)
    # Samples on an edge fall to either side by rounding; half a turn more makes the drawing even again.
    blurred = (blurred + blurred[::-1, ::-1]) / 2.0
    tau = blur_px * ndtri(np.clip(blurred, 1e-4, 1.0 - 1e-4))
    u, v = _print_grid(pitch_px)
    edge = np.round(np.arctan2(v, u) / (2.0 * np.pi) * segments) % segments
    scale, limit_px = pitch_px * OVERSAMPLING, TAU_LIMIT_BLURS * blur_px
    return Print(tau.astype(np.float32), edge.astype(np.uint8), len(sharp) // 2, scale, limit_px)


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
    shape: LocalShape,
    target: StarTarget,
    pitch: float,
) -> Print:
    """Draw the star with the blur that tells most of the centres, judged on some of the stars.

    What a blur tells rises up to the right one and falls beyond it.
    """
    some = slice(None, None, max(1, len(centres) // BLUR_STARS))
    at = np.zeros((len(centres[some]), UNKNOWNS))
    sharp = _sharp_print(target, pitch)
    best, most = None, -np.inf
    for blur in PRINT_BLURS_PX:
        drawn = _blurred(sharp, target.segments, pitch, blur)
        pixels = _pixels(levels, centres[some], shape.linear[some], shape.curved[some], drawn)
        tables = _learn(_count(pixels, at, drawn.limit_px), BANDWIDTHS_PX[0] / TAU_BIN_PX)
        _, fisher = _scores(pixels, at, tables, drawn.limit_px, target.segments)
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


def _learn(counts: NDArray[np.float64], bandwidth_bins: float) -> _Tables:
    """Turn counts of levels over tau into P, smoothed over tau, and that into derivatives and information."""
    reach = int(4 * bandwidth_bins) + 1
    steps = np.arange(-reach, reach + 1)
    kernel = np.exp(-0.5 * (steps / bandwidth_bins) ** 2)
    kernel /= kernel.sum()
    smooth = np.array([np.convolve(row, kernel, "same") for row in counts])
    overall = (counts.sum(axis=1, keepdims=True) + 1.0) / (counts.sum() + len(counts))
    share = (smooth + PSEUDO_COUNT * overall) / (smooth.sum(axis=0) + PSEUDO_COUNT)
    slope = np.gradient(share, axis=1) / TAU_BIN_PX
    return _Tables(slope / share, (slope**2 / share).sum(axis=0))


def _pixels(
    levels: NDArray[np.uint8],
    centres: NDArray[np.float64],
    linear: NDArray[np.float64],
    curved: NDArray[np.float64],
    drawn: Print,
) -> _Pixels:
    """Gather the pixels near edges of all stars."""
    sides = 2.0 * SYMMETRY_REACH * np.abs(linear).sum(axis=(1, 2))
    room = np.abs(np.linalg.det(linear)) * (2.0 * SYMMETRY_REACH) ** 2 + 2.0 * sides + 16.0
    m = int(room.sum())
    found = _Pixels(
        np.zeros(len(centres) + 1, np.int64),
        np.empty(m, np.float32),
        np.empty((m, UNKNOWNS), np.float32),
        np.empty(m, np.uint8),
        np.empty(m, np.uint8),
    )
    _gather(
        levels,
        centres,
        np.linalg.inv(linear),
        curved,
        drawn,
        SYMMETRY_REACH * np.abs(linear).sum(axis=2),
        found,
    )
    used = int(found.first[-1])
    return _Pixels(found.first, found.tau[:used], found.slope[:used], found.edge[:used], found.level[:used])


@njit(cache=True, error_model="numpy")
def _gather(
    levels: Any, centres: Any, inverse: Any, curved: Any, drawn: Print, reach: Any, found: _Pixels
) -> None:
    """Read tau of each pixel of each star's cell off the drawn star."""
    m = 0
    scale = drawn.samples_per_pitch
    for k in range(len(centres)):
        x, y, to, bend = centres[k, 0], centres[k, 1], inverse[k], curved[k]
        low, high = int(max(0.0, y - reach[k, 1])), int(min(levels.shape[0] - 1.0, y + reach[k, 1] + 1.0))
        left, right = int(max(0.0, x - reach[k, 0])), int(min(levels.shape[1] - 1.0, x + reach[k, 0] + 1.0))
        for r in range(low, high + 1):
            for c in range(left, right + 1):
                dx, dy = c - x, r - y
                u, v = to[0, 0] * dx + to[0, 1] * dy, to[1, 0] * dx + to[1, 1] * dy
                dx -= bend[0, 0] * u * u + bend[0, 1] * u * v + bend[0, 2] * v * v
                dy -= bend[1, 0] * u * u + bend[1, 1] * u * v + bend[1, 2] * v * v
                u, v = to[0, 0] * dx + to[0, 1] * dy, to[1, 0] * dx + to[1, 1] * dy
                if abs(u) > SYMMETRY_REACH or abs(v) > SYMMETRY_REACH:
                    continue
                i, j = int(v * scale + drawn.half), int(u * scale + drawn.half)
                a, b = u * scale + drawn.half - j, v * scale + drawn.half - i
                nw, ne = drawn.tau[i, j], drawn.tau[i, j + 1]
                sw, se = drawn.tau[i + 1, j], drawn.tau[i + 1, j + 1]
                tau = (1.0 - b) * ((1.0 - a) * nw + a * ne) + b * ((1.0 - a) * sw + a * se)
                if abs(tau) >= drawn.limit_px:
                    continue
                along_u = ((1.0 - b) * (ne - nw) + b * (se - sw)) * scale
                along_v = ((1.0 - a) * (sw - nw) + a * (se - ne)) * scale
                found.tau[m], found.edge[m], found.level[m] = tau, drawn.edge[i, j], levels[r, c]
                found.slope[m, 0] = -(to[0, 0] * along_u + to[1, 0] * along_v)
                found.slope[m, 1] = -(to[0, 1] * along_u + to[1, 1] * along_v)
                found.slope[m, 2], found.slope[m, 3], found.slope[m, 4] = 1.0, u, v
                m += 1
        found.first[k + 1] = m


@njit(cache=True, error_model="numpy")
def _tau_bin(pixels: _Pixels, m: int, unknowns: Any, limit_px: float) -> float:
    """Bin of tau, with its fraction, of a pixel by a star's present unknowns."""
    tau = pixels.tau[m]
    for p in range(UNKNOWNS):
        tau += pixels.slope[m, p] * unknowns[p]
    return (tau + limit_px) / TAU_BIN_PX


@njit(cache=True, error_model="numpy")
def _count(pixels: _Pixels, unknowns: Any, limit_px: float) -> Any:
    """(levels, bins): count the pixels' levels over tau, each shared between the two nearest bins."""
    bins = int(2.0 * limit_px / TAU_BIN_PX)
    counts = np.zeros((LEVELS, bins))
    for k in range(len(unknowns)):
        for m in range(pixels.first[k], pixels.first[k + 1]):
            at = _tau_bin(pixels, m, unknowns[k], limit_px)
            if 0.0 <= at < bins - 1:
                i = int(at)
                counts[pixels.level[m], i] += 1.0 - (at - i)
                counts[pixels.level[m], i + 1] += at - i
    return counts


@njit(cache=True, error_model="numpy")
def _scores(pixels: _Pixels, unknowns: Any, tables: _Tables, limit_px: float, edges: int) -> tuple[Any, Any]:
    """Derivatives of log L and information of the unknowns: (N, edges, 5) and (N, edges, 5, 5)."""
    n = len(unknowns)
    score, fisher = np.zeros((n, edges, UNKNOWNS)), np.zeros((n, edges, UNKNOWNS, UNKNOWNS))
    for k in range(n):
        for m in range(pixels.first[k], pixels.first[k + 1]):
            at = _tau_bin(pixels, m, unknowns[k], limit_px)
            if not 0.0 <= at < tables.fisher.size - 1:
                continue
            i = int(at)
            a, level, e = at - i, pixels.level[m], pixels.edge[m]
            pull = (1.0 - a) * tables.score[level, i] + a * tables.score[level, i + 1]
            told = (1.0 - a) * tables.fisher[i] + a * tables.fisher[i + 1]
            for p in range(UNKNOWNS):
                d = pixels.slope[m, p]
                score[k, e, p] += pull * d
                for q in range(p + 1):
                    fisher[k, e, p, q] += told * d * pixels.slope[m, q]
        for e in range(edges):
            for p in range(UNKNOWNS):
                for q in range(p):
                    fisher[k, e, q, p] = fisher[k, e, p, q]
    return score, fisher
