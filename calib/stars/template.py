"""Whether a star is at a place of an image: correlation with the pattern of its segments.

The module uses a single star at a guessed place and with a guessed linear map. It does not use neighbours or ids.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

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


class StarTemplate(NamedTuple):
    """Samples of the segments of a star.

    Attributes
    ----------
    offsets
        (S, 2) float64, pitches, places of the samples relative to the centre.
    values
        (S,) float64, +1 on a white segment, -1 on a black one.
    octants
        (S,) int64, number of the sector of each sample, 0 to `OCTANTS` - 1.
    outer
        (S,) bool, whether the radius is `OUTER_RADIUS` or more.
    """

    offsets: NDArray[np.float64]
    values: NDArray[np.float64]
    octants: NDArray[np.int64]
    outer: NDArray[np.bool_]

    @classmethod
    def of(cls, segments: int, radii: tuple[float, ...] = TEMPLATE_RADII) -> StarTemplate:
        """Sample a star whose segments are counted from +Y, the first one white.

        The pattern is that of `calib.target`, sampled at the shares `TEMPLATE_ACROSS` of each segment.

        Parameters
        ----------
        segments
            Number of segments of a star.
        radii
            Radii of the samples, pitches.

        Returns
        -------
        StarTemplate
            Three samples across each segment at each radius.
        """
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
            (radius >= OUTER_RADIUS).ravel(),
        )


@njit(cache=True, error_model="numpy")
def _sample(image: Any, x: float, y: float) -> float:
    """Return the bilinear value of the image at a point; nan outside.

    Source: Abramowitz and Stegun (1972), section 25.2.
    """
    if not (0.0 <= x < image.shape[1] - 1 and 0.0 <= y < image.shape[0] - 1):
        return np.nan
    c, r = int(x), int(y)
    a, b = x - c, y - r
    top = (1.0 - a) * image[r, c] + a * image[r, c + 1]
    bottom = (1.0 - a) * image[r + 1, c] + a * image[r + 1, c + 1]
    return (1.0 - b) * top + b * bottom


@njit(cache=True, error_model="numpy")
def _correlation(image: Any, x: float, y: float, linear: Any, template: StarTemplate) -> float:
    """Return the correlation coefficient of the image with a star at (x, y); nan if too much of it lies outside.

    Normalised cross-correlation (Lewis, 1995); the variance of the template, of values +1 and -1, is taken as 1.
    """
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
    """Find the best place of a star around each guess, in steps of one pixel.

    Criterion: normalised cross-correlation (Lewis, 1995).

    Parameters
    ----------
    image
        (H, W) float32, smoothed.
    guesses
        (N, 2) float64, px.
    linear
        (N, 2, 2) float64, px per pitch, linear map around each star.
    reach_px
        (N,) float64, radius of the search, px.
    template
        Samples of a star.
    sign
        +1 if white is bright in the image, -1 if it is dark.

    Returns
    -------
    places : array
        (N, 2) float64, px; nan if no place lies sufficiently inside the image.
    correlations : array
        (N,) float64, -1 to 1; nan as above.
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
    """Measure how well each star correlates with its pattern, and its contrast in each octant.

    Correlation: Lewis (1995). The contrast by octants is this project's own.

    Parameters
    ----------
    image
        (H, W) float32, smoothed.
    centres
        (N, 2) float64, px.
    linear
        (N, 2, 2) float64, px per pitch, linear map around each star.
    template
        Samples of a star.
    sign
        +1 if white is bright in the image, -1 if it is dark.

    Returns
    -------
    correlations : array
        (N,) float64, -1 to 1; nan if too much of the star lies outside of the image.
    contrasts : array
        (N, OCTANTS) float64, brightness, mean of white minus mean of black in the outer part of each octant.
    """
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
