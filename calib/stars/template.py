"""Whether a star is at a guessed place: correlation with the pattern of its segments; no neighbours, no ids."""

from __future__ import annotations

from typing import Any, NamedTuple

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from calib.compiled import INNER, INNER_WITH_ARRAYS, KERNEL

#: Radii at which a star's segments are compared with the image, pitches. Further inside, segments may merge.
TEMPLATE_RADII = (0.24, 0.28, 0.32, 0.36, 0.40, 0.44, 0.47)
#: Radii that are sufficient to search for a star, pitches.
SEARCH_RADII = (0.26, 0.35, 0.44)
#: Least radius of the outer part of a star, pitches. A star cut by the disc's rim lacks contrast there.
OUTER_RADIUS = 0.35
#: Sampled places across a segment, as shares of its width.
TEMPLATE_ACROSS = (0.2, 0.5, 0.8)
#: Number of sectors in which a star's contrast is measured.
OCTANTS = 8
#: Least share of a star's samples that must lie in the image.
MIN_COVERED = 0.8
#: Stars whose median correlation with the sharp pattern is below this are searched with a learnt pattern too.
SHARP_CORRELATION = 0.65
#: Least correlation of a learnt pattern with the sharp one; below it, the places that it was learnt from are no stars.
MIN_LIKENESS = 0.2
#: Least variance of a learnt pattern in an octant, as a share of that of the octant with the largest one.
MIN_STRUCTURE = 0.1


class StarTemplate(NamedTuple):
    """Samples of the segments of a star."""

    offsets: NDArray[np.float64]  # (S, 2) float64, pitches, places of the samples relative to the centre
    values: NDArray[np.float64]  # (S,) float64, +1 on a white segment, -1 on a black one
    octants: NDArray[np.int64]  # (S,) int64, number of the sector of each sample, 0 to `OCTANTS` - 1
    outer: NDArray[np.bool_]  # (S,) bool, whether the radius is `OUTER_RADIUS` or more
    # (S,) float64, brightness with mean 0 and variance 1 with which an image is correlated: ``values``, or
    # what `learnt` found in an image that is out of focus.
    expected: NDArray[np.float64]

    @classmethod
    def of(cls, segments: int, radii: tuple[float, ...] = TEMPLATE_RADII) -> StarTemplate:
        """Sample a star, as `calib.target` prints it, whose segments are counted from +Y, the first one white.

        It is sampled at the shares `TEMPLATE_ACROSS` of each segment.
        """
        across = np.array(TEMPLATE_ACROSS)
        turns = (np.arange(segments)[:, None] + across[None, :]).ravel() / segments
        angle, radius = np.meshgrid(2 * np.pi * (turns + 0.25), radii)
        white = np.floor(turns * segments) % 2 == 0
        octant = np.floor(turns * OCTANTS).astype(np.int64)
        shape = radius.shape
        values = np.broadcast_to(np.where(white, 1.0, -1.0), shape).ravel().copy()
        return cls(
            np.column_stack([(radius * np.cos(angle)).ravel(), (radius * np.sin(angle)).ravel()]),
            values,
            np.broadcast_to(octant, shape).ravel().copy(),
            (radius >= OUTER_RADIUS).ravel(),
            values,
        )

    def learnt(
        self,
        image: NDArray[np.float32],
        centres: NDArray[np.float64],
        linear: NDArray[np.float64],
        sign: float,
    ) -> StarTemplate | None:
        """Learn from stars, right to a few px, what a star looks like in an image; None if the places show no stars.

        If the lens is out of focus and the image is black and white, white covers the middle of each star, and the
        black segments are short. The sharp pattern then correlates badly and is best a pixel or two off the centre. Own
        procedure: the mean over the stars, made equal under quarter turns (half turns if a quarter turn swaps black and
        white), as the print is. So the learnt pattern cannot move a centre. Linear maps are (N, 2, 2) px per pitch.
        """
        samples = _samples(image, centres, linear, self)
        samples = sign * samples[np.isfinite(samples).all(axis=1)]
        if not len(samples):
            return None
        seen = samples.mean(axis=0)
        across = len(TEMPLATE_ACROSS)
        radii = np.unique(np.hypot(*self.offsets.T).round(9)).size
        segments = self.values.size // radii // across
        turns = 4 if segments % 8 == 0 else 2
        folded = seen.reshape(radii, turns, -1).mean(axis=1, keepdims=True)
        whole = np.broadcast_to(folded, (radii, turns, folded.shape[2])).ravel()
        spread = float(whole.std())
        if spread == 0.0 or float(((whole - whole.mean()) * self.values).mean()) < MIN_LIKENESS * spread:
            return None
        return self._replace(expected=(whole - whole.mean()) / spread)


def _samples(
    image: NDArray[np.float32],
    centres: NDArray[np.float64],
    linear: NDArray[np.float64],
    template: StarTemplate,
) -> NDArray[np.float64]:
    """Return the (N, S) bilinear values of the image at the samples of N stars; nan outside of the image."""
    at = centres[:, None, :] + np.einsum("nij,sj->nsi", linear, template.offsets)
    last = np.array(image.shape[::-1]) - 1
    inside = ((at >= 0) & (at < last)).all(axis=2)
    x, y = np.moveaxis(np.where(inside[:, :, None], at, 0.0).astype(np.float32), 2, 0)
    return np.where(inside, cv2.remap(image, x, y, cv2.INTER_LINEAR).astype(float), np.nan)


def learnt_contrasts(
    image: NDArray[np.float32],
    centres: NDArray[np.float64],
    linear: NDArray[np.float64],
    template: StarTemplate,
    sign: float,
) -> NDArray[np.float64]:
    """Return how strongly each octant of each star shows a learnt pattern: (N, OCTANTS) brightness.

    Own measure: the slope of the image over ``template.expected``, by least squares in each octant; nan if a part lies
    outside of the image. An octant in which the learnt pattern is nearly flat gets the median of the star's others.
    """
    seen = sign * _samples(image, centres, linear, template)
    slopes, squares = np.empty((len(centres), OCTANTS)), np.empty(OCTANTS)
    for octant in range(OCTANTS):
        here = template.octants == octant
        expected = template.expected[here] - template.expected[here].mean()
        squares[octant] = expected @ expected
        slopes[:, octant] = seen[:, here] @ expected / max(squares[octant], 1e-9)
    flat = squares < MIN_STRUCTURE * squares.max()
    slopes[:, flat] = np.median(slopes[:, ~flat], axis=1, keepdims=True)
    return slopes


@njit(**INNER)
def _sample(image: Any, x: float, y: float) -> float:
    """Return the bilinear value of the image at a point; nan outside (Abramowitz and Stegun, 1972, section 25.2)."""
    if not (0.0 <= x < image.shape[1] - 1 and 0.0 <= y < image.shape[0] - 1):
        return np.nan
    c, r = int(x), int(y)
    a, b = x - c, y - r
    top = (1.0 - a) * image[r, c] + a * image[r, c + 1]
    bottom = (1.0 - a) * image[r + 1, c] + a * image[r + 1, c + 1]
    return (1.0 - b) * top + b * bottom


@njit(**INNER_WITH_ARRAYS)
def _seen(image: Any, x: float, y: float, linear: Any, template: StarTemplate) -> Any:
    """Return the (S,) bilinear values of the image at the samples of a star at (x, y); nan outside."""
    offsets = template.offsets
    seen = np.empty(len(offsets))
    for i in range(len(offsets)):
        u, v = offsets[i, 0], offsets[i, 1]
        seen[i] = _sample(
            image, x + linear[0, 0] * u + linear[0, 1] * v, y + linear[1, 0] * u + linear[1, 1] * v
        )
    return seen


@njit(**INNER)
def _correlation(seen: Any, template: StarTemplate) -> float:
    """Return the correlation (Lewis, 1995) of what was seen with a star; nan if too much of it lies outside."""
    expected = template.expected
    total = squares = product = balance = 0.0
    n = 0
    for i in range(seen.size):
        value = seen[i]
        if not np.isnan(value):
            n += 1
            total += value
            squares += value * value
            product += value * expected[i]
            balance += expected[i]
    if n < MIN_COVERED * seen.size:
        return np.nan
    mean = total / n
    variance = squares / n - mean * mean
    return (product - mean * balance) / n / np.sqrt(variance) if variance > 0.0 else 0.0


@njit(**KERNEL)
def star_contrasts(
    image: Any, centres: Any, linear: Any, template: StarTemplate, sign: float
) -> tuple[Any, Any]:
    """Return each star's correlation with its pattern, (N,) -1 to 1, and its contrast by octants, (N, OCTANTS).

    Correlation: Lewis (1995); nan if too much of the star lies outside of the image. Own contrast: mean of white minus
    mean of black in the outer part of each octant; an octant with more white than black, or one of them only, is
    compared with the mean of the star. Centres (N, 2), px; linear maps (N, 2, 2), px per pitch; the sign is +1 if white
    is bright.
    """
    n = len(centres)
    score, contrast = np.empty(n), np.empty((n, OCTANTS))
    for k in range(n):
        x, y = centres[k, 0], centres[k, 1]
        seen = _seen(image, x, y, linear[k], template)
        score[k] = sign * _correlation(seen, template)
        sums, counts, excess = np.zeros(OCTANTS), np.zeros(OCTANTS), np.zeros(OCTANTS)
        shades, shade_counts = np.zeros(2), np.zeros(2)
        for i in range(template.values.size):
            if template.outer[i]:
                excess[template.octants[i]] += template.values[i]
                value = seen[i]
                if not np.isnan(value):
                    sums[template.octants[i]] += sign * value * template.values[i]
                    counts[template.octants[i]] += 0.5
                    shade = 1 if template.values[i] > 0.0 else 0
                    shades[shade] += sign * value
                    shade_counts[shade] += 1.0
        mean = 0.5 * (shades[0] / shade_counts[0] + shades[1] / shade_counts[1])
        for octant in range(OCTANTS):
            if excess[octant] != 0.0:
                sums[octant] -= excess[octant] * mean
            contrast[k, octant] = sums[octant] / counts[octant]
    return score, contrast
