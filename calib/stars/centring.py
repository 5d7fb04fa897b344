"""One star in an image: is it there, and where exactly is its centre.

Knows the look of a single star around a guess of its place and shape; nothing of its neighbours or of ids.

A star is told by the correlation of the image with its segments. Its centre is found by symmetry: with the
local map q(s) = c + A s + B(s, s) from the target's plane (s in pitches from the star) to the image, half a
turn about the star leaves the print unchanged, so c minimises

    sum over s of w(s) (I(q(s)) - I(q(-s)))^2 .

Light that falls off across the star, as at the rim of the disc, is not symmetrical: a slope by a share g and one
by an amount b are found with c, I(q(s)) - I(q(-s)) = g.s (I(q(s)) + I(q(-s))) + b.s.

A cancels against itself in the pairs' middles and is needed only to know where to look; B, the curvature of
perspective and distortion, moves the middles and is needed as well as the neighbours can tell it.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

#: Radii, in pitches, at which a star's segments are compared with the image; further in they may run together.
TEMPLATE_RADII = (0.24, 0.28, 0.32, 0.36, 0.40, 0.44, 0.47)
#: ... and those that are enough to look for it.
SEARCH_RADII = (0.26, 0.35, 0.44)
#: Outer of these: a star cut by the disc's rim lacks contrast there.
OUTER_FROM = 0.35
#: Places along a segment's width, as shares of it.
TEMPLATE_ACROSS = (0.2, 0.5, 0.8)
#: Half the side of the square in which symmetry is looked at, in pitches: the star's own cell, not more, so
#: that neighbours share no pixels.
SYMMETRY_REACH = 0.49
#: Octants in which a star's contrast is looked at.
OCTANTS = 8
#: Share of a star's cell that must lie in the image.
MIN_COVERED = 0.8
#: Centre, and slopes of the light across the star.
UNKNOWNS = 6
_STEPS = 12


class StarTemplate(NamedTuple):
    """Samples of a star's segments: where, in pitches from its centre, and white (+1) or black (-1)."""

    offsets: NDArray[np.float64]
    values: NDArray[np.float64]
    octants: NDArray[np.int64]
    outer: NDArray[np.bool_]

    @classmethod
    def of(cls, segments: int, radii: tuple[float, ...] = TEMPLATE_RADII) -> StarTemplate:
        """Template of a star of so many segments, counted from +Y, the first one white."""
        across = np.array(TEMPLATE_ACROSS)
        turns = (np.arange(segments)[:, None] + across[None, :]).ravel() / segments
        angle, radius = np.meshgrid(2 * np.pi * (turns + 0.25), radii)
        white = np.floor(turns * segments) % 2 == 0
        octant = np.floor(turns * OCTANTS).astype(np.int64)
        shape = radius.shape
        return cls(
            np.column_stack([(radius * np.cos(angle)).ravel(), (radius * np.sin(angle)).ravel()]),
            np.broadcast_to(np.where(white, 1.0, -1.0), shape).ravel().copy(),
            np.broadcast_to(octant, shape).ravel().copy(),
            (radius >= OUTER_FROM).ravel(),
        )


class LocalMap(NamedTuple):
    """Map around N stars: A (N, 2, 2), px a pitch; B (N, 2, 3), px a pitch^2 for s_x^2, s_x s_y, s_y^2."""

    linear: NDArray[np.float64]
    curved: NDArray[np.float64]


class SymmetryFit(NamedTuple):
    """Stars after refinement.

    Attributes
    ----------
    centres
        (N, 2) px.
    information
        (N, 2, 2) what the residuals say of the centre, (brightness / px)^2: J^T J, less what the slopes take.
    residual
        (N,) mean square of the symmetry's residuals.
    steepness
        (N,) length of g, 1/pitch: how uneven the light is across the star.
    converged
        (N,) whether the last step was below a thousandth of a pixel.
    """

    centres: NDArray[np.float64]
    information: NDArray[np.float64]
    residual: NDArray[np.float64]
    steepness: NDArray[np.float64]
    converged: NDArray[np.bool_]

    def kept(self, mask: NDArray[np.bool_]) -> SymmetryFit:
        """Return those of the mask."""
        return SymmetryFit(
            self.centres[mask],
            self.information[mask],
            self.residual[mask],
            self.steepness[mask],
            self.converged[mask],
        )


def smooth(image: NDArray[np.float32], sigma_px: float) -> NDArray[np.float32]:
    """Blur an image by a Gaussian, so that noise of single pixels and their grid no longer matter."""
    return np.ascontiguousarray(cv2.GaussianBlur(image, (0, 0), sigma_px), np.float32)


def symmetry_samples(pitch_px: float) -> NDArray[np.float64]:
    """Return (M, 2) offsets s in pitches, one of each pair (s, -s), about a pixel apart."""
    side = int(np.clip(np.ceil(2 * SYMMETRY_REACH * pitch_px), 16, 64))
    steps = (np.arange(side) + 0.5) / side * 2.0 - 1.0
    u, v = np.meshgrid(steps * SYMMETRY_REACH, steps * SYMMETRY_REACH)
    upper = (v > 0) | ((v == 0) & (u > 0))
    return np.column_stack([u[upper], v[upper]])


@njit(cache=True, error_model="numpy")
def _sample(image: Any, x: float, y: float) -> float:
    """Bilinear value; nan outside."""
    if not (0.0 <= x < image.shape[1] - 1 and 0.0 <= y < image.shape[0] - 1):
        return np.nan
    c, r = int(x), int(y)
    a, b = x - c, y - r
    top = (1.0 - a) * image[r, c] + a * image[r, c + 1]
    bottom = (1.0 - a) * image[r + 1, c] + a * image[r + 1, c + 1]
    return (1.0 - b) * top + b * bottom


@njit(cache=True, error_model="numpy")
def _spline_weights(a: float) -> tuple[float, float, float, float]:
    """Values of the cubic B-spline at the four pixels around a point, a beyond the second."""
    b = 1.0 - a
    return (
        b * b * b / 6.0,
        (4.0 - 6.0 * a * a + 3.0 * a * a * a) / 6.0,
        (4.0 - 6.0 * b * b + 3.0 * b * b * b) / 6.0,
        a * a * a / 6.0,
    )


@njit(cache=True, error_model="numpy")
def _spline_slopes(a: float) -> tuple[float, float, float, float]:
    """Derivatives of `_spline_weights`."""
    b = 1.0 - a
    return (-0.5 * b * b, -2.0 * a + 1.5 * a * a, 2.0 * b - 1.5 * b * b, 0.5 * a * a)


@njit(cache=True, error_model="numpy")
def _smooth_sample(image: Any, x: float, y: float) -> tuple[float, float, float]:
    """Value and derivatives along x and y of the image as a cubic B-spline of its pixels; nan outside.

    The spline blurs a little more, and has no kinks at pixels: bilinear values would pull edges that run along
    the grid towards it.
    """
    if not (1.0 <= x < image.shape[1] - 2 and 1.0 <= y < image.shape[0] - 2):
        return np.nan, np.nan, np.nan
    c, r = int(x), int(y)
    wx, sx = _spline_weights(x - c), _spline_slopes(x - c)
    wy, sy = _spline_weights(y - r), _spline_slopes(y - r)
    value = along_x = along_y = 0.0
    for i in range(4):
        across = slope = 0.0
        for j in range(4):
            pixel = image[r - 1 + i, c - 1 + j]
            across += wx[j] * pixel
            slope += sx[j] * pixel
        value += wy[i] * across
        along_x += wy[i] * slope
        along_y += sy[i] * across
    return value, along_x, along_y


@njit(cache=True, error_model="numpy")
def _correlation(image: Any, x: float, y: float, linear: Any, template: StarTemplate) -> float:
    """Correlation of the image with a star at (x, y); nan where too much of it lies outside."""
    total = squares = product = balance = 0.0
    n = 0
    for i in range(template.values.size):
        u, v = template.offsets[i, 0], template.offsets[i, 1]
        value = _sample(
            image, x + linear[0, 0] * u + linear[0, 1] * v, y + linear[1, 0] * u + linear[1, 1] * v
        )
        if not np.isnan(value):
            n += 1
            total += value
            squares += value * value
            product += value * template.values[i]
            balance += template.values[i]
    if n < MIN_COVERED * template.values.size:
        return np.nan
    mean = total / n
    variance = squares / n - mean * mean
    return (product - mean * balance) / n / np.sqrt(variance) if variance > 0.0 else 0.0


@njit(cache=True, error_model="numpy")
def search_stars(
    image: Any, guesses: Any, linear: Any, reach_px: Any, template: StarTemplate, sign: float
) -> tuple[Any, Any]:
    """Find the best place of a star around each guess, on a grid of about one pixel.

    Parameters
    ----------
    image
        (H, W) float32.
    guesses
        (N, 2) px.
    linear
        (N, 2, 2) px a pitch.
    reach_px
        (N,) how far to look, px.
    template
        The star's look.
    sign
        +1 where white is bright, -1 where it is dark.

    Returns
    -------
    (N, 2) px and (N,) correlations; nan where no place lies well enough inside the image.
    """
    n = len(guesses)
    best, score = np.full((n, 2), np.nan), np.full(n, np.nan)
    for k in range(n):
        steps = int(np.ceil(reach_px[k]))
        for i in range(-steps, steps + 1):
            for j in range(-steps, steps + 1):
                if i * i + j * j > reach_px[k] ** 2 + 0.5:
                    continue
                x, y = guesses[k, 0] + j, guesses[k, 1] + i
                found = sign * _correlation(image, x, y, linear[k], template)
                if not found <= score[k] and not np.isnan(found):
                    score[k], best[k, 0], best[k, 1] = found, x, y
    return best, score


@njit(cache=True, error_model="numpy")
def star_contrasts(
    image: Any, centres: Any, linear: Any, template: StarTemplate, sign: float
) -> tuple[Any, Any]:
    """Correlation of each star, (N,), and white minus black in each octant's outer part, (N, OCTANTS)."""
    n = len(centres)
    score, contrast = np.full(n, np.nan), np.full((n, OCTANTS), np.nan)
    for k in range(n):
        x, y = centres[k, 0], centres[k, 1]
        score[k] = sign * _correlation(image, x, y, linear[k], template)
        sums, counts = np.zeros(OCTANTS), np.zeros(OCTANTS)
        for i in range(template.values.size):
            if template.outer[i]:
                u, v = template.offsets[i, 0], template.offsets[i, 1]
                value = _sample(
                    image,
                    x + linear[k, 0, 0] * u + linear[k, 0, 1] * v,
                    y + linear[k, 1, 0] * u + linear[k, 1, 1] * v,
                )
                if not np.isnan(value):
                    sums[template.octants[i]] += sign * value * template.values[i]
                    counts[template.octants[i]] += 0.5
        contrast[k] = sums / counts
    return score, contrast


@njit(cache=True, error_model="numpy")
def _normal_equations(
    image: Any,
    x: float,
    y: float,
    shape: Any,
    curved: Any,
    samples: Any,
    slopes: Any,
    normal: Any,
    right: Any,
) -> float:
    """Fill J^T J and J^T r of the symmetry's residuals; return the mean of r^2, nan where too few are inside.

    Unknowns are the centre, and by `slopes` how light falls off across the star: by a share (x, y) and by an
    amount (x, y) a pitch.
    """
    normal[:] = 0.0
    right[:] = 0.0
    squares = 0.0
    n = 0
    j = np.empty(UNKNOWNS)
    for i in range(len(samples)):
        u, v = samples[i, 0], samples[i, 1]
        uu, uv, vv = u * u, u * v, v * v
        ax, ay = shape[0, 0] * u + shape[0, 1] * v, shape[1, 0] * u + shape[1, 1] * v
        mx = x + curved[0, 0] * uu + curved[0, 1] * uv + curved[0, 2] * vv
        my = y + curved[1, 0] * uu + curved[1, 1] * uv + curved[1, 2] * vv
        there, there_x, there_y = _smooth_sample(image, mx + ax, my + ay)
        here, here_x, here_y = _smooth_sample(image, mx - ax, my - ay)
        if np.isnan(there) or np.isnan(here):
            continue
        n += 1
        both = there + here
        j[0], j[1], j[2], j[3], j[4], j[5] = there_x - here_x, there_y - here_y, -u * both, -v * both, -u, -v
        r = there - here + slopes[0] * j[2] + slopes[1] * j[3] + slopes[2] * j[4] + slopes[3] * j[5]
        squares += r * r
        for k in range(UNKNOWNS):
            right[k] += j[k] * r
            for m in range(k + 1):
                normal[k, m] += j[k] * j[m]
    for k in range(UNKNOWNS):
        for m in range(k):
            normal[m, k] = normal[k, m]
    return squares / n if n >= MIN_COVERED * len(samples) else np.nan


@njit(cache=True, error_model="numpy")
def _solvable(normal: Any) -> bool:
    """Whether the image says anything about every unknown: nothing does where it is flat.

    However large its grey values are: they are the unit of some unknowns.
    """
    scale, scaled = np.empty(UNKNOWNS), np.empty((UNKNOWNS, UNKNOWNS))
    for k in range(UNKNOWNS):
        if not normal[k, k] > 0.0:
            return False
        scale[k] = np.sqrt(normal[k, k])
    for k in range(UNKNOWNS):
        for m in range(UNKNOWNS):
            scaled[k, m] = normal[k, m] / scale[k] / scale[m]
    return bool(np.linalg.cond(scaled) < 1e12)


@njit(cache=True, error_model="numpy")
def refine_by_symmetry(
    image: Any, guesses: Any, shape: LocalMap, samples: Any, reach_px: float
) -> SymmetryFit:
    """Minimise the symmetry's residuals over each centre by Gauss-Newton.

    Parameters
    ----------
    image
        (H, W) float32, from `smooth`.
    guesses
        (N, 2) px.
    shape
        The map around each star.
    samples
        From `symmetry_samples`.
    reach_px
        A centre that walks further than this from its guess is given up, px.

    Returns
    -------
    Centres that were given up, or whose cell lies too far outside the image, are nan and not converged.
    """
    n = len(guesses)
    centres, information = np.full((n, 2), np.nan), np.full((n, 2, 2), np.nan)
    residual, steepness, converged = np.full(n, np.nan), np.full(n, np.nan), np.zeros(n, np.bool_)
    normal, right = np.empty((UNKNOWNS, UNKNOWNS)), np.empty(UNKNOWNS)
    for k in range(n):
        x, y = guesses[k, 0], guesses[k, 1]
        slopes = np.zeros(UNKNOWNS - 2)
        for _ in range(_STEPS):
            squares = _normal_equations(
                image, x, y, shape.linear[k], shape.curved[k], samples, slopes, normal, right
            )
            if np.isnan(squares) or not _solvable(normal):
                break
            step = np.linalg.solve(normal, right)
            length = np.hypot(step[0], step[1])
            shorter = min(1.0, 1.5 / length) if length > 0.0 else 1.0
            x, y = x - shorter * step[0], y - shorter * step[1]
            slopes -= shorter * step[2:]
            if np.hypot(x - guesses[k, 0], y - guesses[k, 1]) > reach_px:
                break
            if length < 1e-3:
                converged[k] = True
                centres[k, 0], centres[k, 1] = x, y
                residual[k], steepness[k] = squares, np.hypot(slopes[0], slopes[1])
                information[k] = np.linalg.inv(np.linalg.inv(normal)[:2, :2])
                break
    return SymmetryFit(centres, information, residual, steepness, converged)
