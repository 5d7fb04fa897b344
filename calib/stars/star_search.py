"""Search of a star around a guess: the place, in steps of one pixel, that correlates best with its pattern.

It uses a smoothed image and a `StarTemplate`, and decides nothing about the grid. All compiled functions of the search
are here, next to those that they call.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from calib.compiled import INNER, INNER_WITH_ARRAYS, KERNEL
from calib.stars.template import MIN_COVERED, StarTemplate

#: Standard deviation, as a share of the brightness, up to which an image counts as flat: single precision is right to
#: 6e-8.
FLAT = 2e-6
#: Relative error of a sum in single precision, with a margin: a variance that is smaller than this share of the squared
#: mean is rounding.
ROUNDED = 1e-6


class _Places(NamedTuple):
    """Samples of a star at its guess, as pixels and how far the samples lie beyond them, each (S,).

    ``column``, ``row`` and ``pixel``, row by row, are those of the pixel to the upper left, int32; ``right`` and
    ``down`` are float32, 0 to 1 px; ``expected`` is that of the template, float32.
    """

    column: NDArray[np.int32]
    row: NDArray[np.int32]
    pixel: NDArray[np.int32]
    right: NDArray[np.float32]
    down: NDArray[np.float32]
    expected: NDArray[np.float32]


@njit(**INNER)
def _find_places(
    guess: Any, linear: Any, template: StarTemplate, width: int, places: _Places
) -> tuple[int, int, int, int]:
    """Fill in the samples of a star; return their least and largest column, and their least and largest row."""
    left = top = 1 << 30
    right = bottom = -left
    for i in range(template.values.size):
        u, v = template.offsets[i, 0], template.offsets[i, 1]
        x = guess[0] + linear[0, 0] * u + linear[0, 1] * v
        y = guess[1] + linear[1, 0] * u + linear[1, 1] * v
        c, r = int(np.floor(x)), int(np.floor(y))
        places.column[i], places.row[i], places.pixel[i] = c, r, r * width + c
        places.right[i], places.down[i] = x - c, y - r
        left, right, top, bottom = min(left, c), max(right, c), min(top, r), max(bottom, r)
    return left, right, top, bottom


@njit(**INNER, fastmath={"reassoc", "contract", "nsz"})
def _sums_at(pixels: Any, width: Any, shift: Any, level: Any, places: _Places) -> tuple[float, float, float]:
    """Return the sums of the values at the samples, of their squares, and of their products with the template.

    ``level`` is subtracted from all values, float32. ``shift`` is by how many pixels, row by row, the samples are
    moved, int32. There is no branch and no store, so that the loop runs over several samples at once. Bilinear
    interpolation: Abramowitz and Stegun (1972), section 25.2.
    """
    total = squares = product = np.float32(0.0)
    one = np.int32(1)
    for i in range(places.pixel.size):
        at = places.pixel[i] + shift
        nw, ne = pixels[np.uint64(at)], pixels[np.uint64(at + one)]
        sw, se = pixels[np.uint64(at + width)], pixels[np.uint64(at + width + one)]
        top, bottom = nw + places.right[i] * (ne - nw), sw + places.right[i] * (se - sw)
        value = top + places.down[i] * (bottom - top) - level
        total += value
        squares += value * value
        product += value * places.expected[i]
    return float(total), float(squares), float(product)


@njit(**INNER)
def _correlation_inside(
    pixels: Any, width: int, shift: int, level: Any, balance: float, places: _Places
) -> float:
    """Return the correlation of samples that all lie in the image with a star; nan if a pixel has no value.

    Lewis (1995), with 1 as the variance of the template; ``balance`` is the sum of the template.
    """
    total, squares, product = _sums_at(pixels, np.int32(width), np.int32(shift), level, places)
    n = places.pixel.size
    mean = total / n
    variance = squares / n - mean * mean
    if np.isnan(variance):
        return np.nan
    flat = (FLAT * level) ** 2 + ROUNDED * mean * mean
    return (product - mean * balance) / n / np.sqrt(variance) if variance > flat else 0.0


@njit(**INNER)
def _correlation_partly(image: Any, across: int, below: int, places: _Places) -> float:
    """Return the correlation of samples of which some lie outside of the image; nan if too many of them do.

    Normalised cross-correlation (Lewis, 1995). ``across`` and ``below`` are by how many pixels the samples are moved.
    """
    total = squares = product = balance = 0.0
    n = 0
    for i in range(places.column.size):
        c, r = places.column[i] + across, places.row[i] + below
        if not (0 <= c < image.shape[1] - 1 and 0 <= r < image.shape[0] - 1):
            continue
        a, b, expected = places.right[i], places.down[i], places.expected[i]
        top = (1.0 - a) * image[r, c] + a * image[r, c + 1]
        bottom = (1.0 - a) * image[r + 1, c] + a * image[r + 1, c + 1]
        value = (1.0 - b) * top + b * bottom
        if not np.isnan(value):
            n += 1
            total += value
            squares += value * value
            product += value * expected
            balance += expected
    if n < MIN_COVERED * places.column.size:
        return np.nan
    mean = total / n
    variance = squares / n - mean * mean
    return (product - mean * balance) / n / np.sqrt(variance) if variance > 0.0 else 0.0


@njit(**KERNEL)
def search_stars(
    image: Any, guesses: Any, linear: Any, reach_px: Any, template: StarTemplate, sign: float
) -> tuple[Any, Any]:
    """Find the best place, px, of a star around each guess, in steps of one pixel, and its correlation, -1 to 1.

    Normalised cross-correlation (Lewis, 1995); nan if no place lies sufficiently inside the image, (H, W) float32,
    smoothed. Guesses (N, 2), px; linear maps (N, 2, 2), px per pitch; radii (N,), px; the sign is +1 if white is
    bright, else -1.
    """
    n, samples = len(guesses), template.values.size
    best, score = np.empty((n, 2)), np.empty(n)
    numbers, shares = np.empty((3, samples), np.int32), np.empty((2, samples), np.float32)
    expected = template.expected.astype(np.float32)
    places = _Places(numbers[0], numbers[1], numbers[2], shares[0], shares[1], expected)
    for k in range(n):
        best[k] = np.nan
        score[k] = _search_star(image, guesses[k], linear[k], reach_px[k], template, sign, places, best[k])
    return best, score


@njit(**INNER_WITH_ARRAYS)
def _search_star(
    image: Any,
    guess: Any,
    linear: Any,
    reach_px: float,
    template: StarTemplate,
    sign: float,
    places: _Places,
    best: Any,
) -> float:
    """Find the best place around one guess; return its correlation."""
    height, width = image.shape
    pixels, balance, score = image.ravel(), template.expected.sum(), np.nan
    left, right, top, bottom = _find_places(guess, linear, template, width, places)
    level = image[min(max(int(guess[1]), 0), height - 1), min(max(int(guess[0]), 0), width - 1)]
    square = reach_px**2 + 0.5
    steps = int(np.sqrt(square))
    for i in range(-steps, steps + 1):
        aside = int(np.sqrt(square - i * i))
        for j in range(-aside, aside + 1):
            found = np.nan
            if left + j >= 0 and right + j < width - 1 and top + i >= 0 and bottom + i < height - 1:
                found = _correlation_inside(pixels, width, i * width + j, level, balance, places)
            if np.isnan(found):
                found = _correlation_partly(image, j, i, places)
            found *= sign
            if not found <= score and not np.isnan(found):
                score, best[0], best[1] = found, guess[0] + j, guess[1] + i
    return score
