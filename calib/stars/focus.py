"""How sharp a live picture is: the width of the stars' edges, the blur of the print, and a figure without any print.

Three measures cover a lens from out of focus to sharp:

edge width
    Standard deviation of the blur, px, of stars that are found (`calib.stars.likelihood.edge_width_px`): up to 1.3 px.
blur circle
    Diameter, px, of the circle by which the print must be blurred so that the image shows the same shapes: about 5 to
    25 px. The tag must be readable; the stars need not be visible.
sharpness
    Standard deviation of the picture's details, as a share of white: it grows while the lens is turned towards focus,
    whatever is in the picture. It has no unit and depends on the scene.

The module uses arrays and the print; it knows no lens and no time.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Final, NamedTuple

import cv2
import numpy as np

from calib.arrays import AnyArray, Array, Array32, Bools, Bytes, Ints, selected
from calib.model.homography import apply_homography, linear_at
from calib.stars.edge_pixels import quantise
from calib.stars.grid_map import LocalMap
from calib.stars.likelihood import edge_width_px
from calib.target import StarTarget

#: Blur circles that are tried, px, and enlargements of the tag: bright light makes black print look smaller.
CIRCLES_PX: Final = (0.0, 2.0, 4.0, 5.0, 6.0, 7.0, 8.0, 10.0, 12.0, 14.0, 16.0, 18.0, 20.0, 23.0, 26.0, 30.0)
ENLARGED: Final = (1.0, 1.02, 1.04, 1.06, 1.08)
#: Samples of the print a pitch; half the side of the print that is blurred, and of the part of it that is compared,
#: pitches: the tag and a ring of stars. What the transform wraps around stays in the margin between the two.
PER_PITCH, HALF_SIDE, COMPARED = 24, 4.5, 3.2
#: Number of samples of the image along a side, and number of groups of equal size by expected brightness: some 500
#: samples in each, so that their means have little noise.
ALONG, GROUPS = 110, 24
#: Blur that lens and pixel have in focus, px: that of the simulated camera.
IN_FOCUS_PX = 0.7
#: Least share of the image's variance that the blurred print explains: drawn, at its place 0.80 or more with circles up
#: to 34 px; moved by two pitches or turned by 40 degrees, 0.18 at most.
MIN_EXPLAINED = 0.3
#: Least number of stars whose edges give a width: that of fewer jumps from picture to picture.
MIN_STARS_FOR_WIDTH = 6


class BlurCircle(NamedTuple):
    """Blur of the print around the tag."""

    diameter_px: float  # Diameter of the blur circle, px
    explained: float  # Share of the image's variance that the print explains when it is blurred so, 0 to 1


def edge_widths_px(
    image: AnyArray,
    centres: Array,
    local_map: LocalMap,
    target: StarTarget,
    groups: Sequence[Ints],
) -> list[float | None]:
    """Measure the standard deviation of the edges' blur, px, of groups of stars, as `likelihood.edge_width_px`.

    None for fewer than `MIN_STARS_FOR_WIDTH` stars. The image is not smoothed; centres are right to about 0.1 px.
    """
    levels = quantise(image)
    # A pitch of three digits: the printed star, whose edges are radii, is then drawn once for many pictures.
    pitch = float(f"{local_map.pitch_px:.3g}") if len(centres) else None
    return [
        edge_width_px(levels, centres[group], selected(local_map, group), target, pitch_px=pitch)
        if len(group) >= MIN_STARS_FOR_WIDTH
        else None
        for group in groups
    ]


def blur_circle(
    image: AnyArray, homography: Array, target: StarTarget, *, enlarged: Sequence[float] = ENLARGED
) -> BlurCircle | None:
    """Measure by which circle the print around the tag is blurred; None if it does not explain the image.

    The print is blurred by circles of several diameters. For each, the pixels are sorted into groups of equal expected
    brightness. The best circle is the one whose groups explain most of the image's variance: the correlation ratio
    (Pearson, 1905), which needs no model of how brightness becomes a grey value or a number of events. Image
    registration by it: Roche et al. (1998). The search over enlargements of the tag is this project's own. The
    homography is from [column row 1] of the target's grid to [u v 1] px.
    """
    middle = np.array(target.tag_centre_mm) / target.pitch_mm
    steps = (np.arange(ALONG) + 0.5) / ALONG * 2.0 * COMPARED - COMPARED
    places = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    pitch = float(np.sqrt(np.abs(np.linalg.det(linear_at(homography, middle[None])[0]))))
    in_focus = round(IN_FOCUS_PX / pitch, 3)
    cells = np.rint((places + HALF_SIDE) * PER_PITCH - 0.5).astype(np.int64)
    best: BlurCircle | None = None
    for scale in enlarged:
        at = np.rint(apply_homography(homography, middle + scale * places)).astype(np.int64)
        inside = (at >= 0).all(axis=1) & (at[:, 0] < image.shape[1]) & (at[:, 1] < image.shape[0])
        if np.count_nonzero(inside) < 0.5 * len(at):
            return None
        values = np.nan_to_num(image[at[inside, 1], at[inside, 0]].astype(np.float32))
        if values.std() == 0.0:
            return None
        columns, rows = cells[inside].T
        prints = (_blurred_print(target, round(circle / pitch, 3), in_focus) for circle in CIRCLES_PX)
        explained = np.array([_explained(values, pattern[rows, columns]) for pattern in prints])
        if best is None or explained.max() > best.explained:
            best = BlurCircle(_vertex(explained), float(explained.max()))
    return best if best is not None and best.explained >= MIN_EXPLAINED else None


def sharpness(image: AnyArray, lit: Bytes) -> float | None:
    """Return how much detail, about 0.03 to 0.45, an image has inside the beam; None if the beam covers too little.

    Own figure: the standard deviation of the image, reduced to half its size and without its wide part, as a share of
    white. It falls while the blur grows, from 3 to 30 px under a bright light and from 6 to 20 px under a dim one.
    ``lit`` is 1 inside the beam, of any smaller size (`calib.stars.beam.Beam.lit`).
    """
    small = cv2.resize(np.asarray(image, np.float32), None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    small = cv2.medianBlur(small, 3)
    white = float(np.quantile(small[::2, ::2], 0.97))
    inside = _inside(lit, small.shape, 7)
    if white <= 0.0 or np.count_nonzero(inside) < 1000:
        return None
    share = np.clip(small / white, 0.0, 1.0)
    reduced = cv2.resize(share, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA)
    wide = cv2.resize(cv2.GaussianBlur(reduced, (0, 0), 6.0), (share.shape[1], share.shape[0]))
    return float((share - wide)[inside].std())


def contrast(image: AnyArray, lit: Bytes) -> float | None:
    """Return Michelson's contrast (1927) inside the beam, 0 to 1, of the quantiles 0.95 and 0.05; None if unlit."""
    values = np.asarray(image[::3, ::3], np.float32)
    inside = _inside(lit, values.shape, 1)
    if np.count_nonzero(inside) < 100:
        return None
    dark, bright = (max(float(v), 0.0) for v in np.quantile(values[inside], [0.05, 0.95]))
    return (bright - dark) / (bright + dark) if bright + dark > 0.0 else None


def _inside(lit: Bytes, shape: tuple[int, ...], margin: int) -> Bools:
    """Return which pixels of an image of some shape are lit; cells within half a margin of the dark are not."""
    eroded = cv2.erode(lit, np.ones((margin, margin), np.uint8), borderType=cv2.BORDER_REPLICATE)
    return np.asarray(cv2.resize(eroded, (shape[1], shape[0]), interpolation=cv2.INTER_NEAREST) > 0)


@lru_cache(maxsize=2)
def _print_spectrum(target: StarTarget) -> Array:
    """Return the Fourier transform of the print around the tag."""
    over = 2
    count = int(2 * HALF_SIDE * PER_PITCH)
    steps = (np.arange(count * over) + 0.5) / (PER_PITCH * over) - HALF_SIDE
    x, y = np.meshgrid(steps * target.pitch_mm, steps * target.pitch_mm)
    fine = target.reflectance(target.tag_centre_mm[0] + x, target.tag_centre_mm[1] + y)
    return np.asarray(np.fft.rfft2(fine.reshape(count, over, count, over).mean(axis=(1, 3))))


@lru_cache(maxsize=256)
def _blurred_print(target: StarTarget, circle: float, sigma: float) -> Array32:
    """Return the print around the tag, blurred by a circle of a diameter and by a Gaussian, both in pitches.

    The transform of a uniform disc is 2 J1(z) / z with z = pi k d (Goodman, 2005).
    """
    from scipy.special import j1

    spectrum = _print_spectrum(target)
    count = spectrum.shape[0]
    down, across = (waves(count, 1.0 / PER_PITCH) for waves in (np.fft.fftfreq, np.fft.rfftfreq))
    k = np.hypot(down[:, None], across[None])
    z = np.maximum(np.pi * k * circle, 1e-9)
    transfer = 2.0 * j1(z) / z * np.exp(-2.0 * (np.pi * k * sigma) ** 2)
    return np.asarray(np.fft.irfft2(spectrum * transfer, s=(count, count)), np.float32)


def _explained(values: Array32, expected: Array32) -> float:
    """Return the correlation ratio (Pearson, 1905) of (N,) values in `GROUPS` equal groups by expected brightness."""
    ordered = values[np.argsort(expected)]
    size = len(ordered) // GROUPS
    means = ordered[: size * GROUPS].reshape(GROUPS, size).mean(axis=1)
    return float(means.var() / values.var())


def _vertex(explained: Array) -> float:
    """Return the circle that explains most: the vertex of a parabola through the best of `CIRCLES_PX`."""
    k = int(np.argmax(explained))
    if k in (0, len(CIRCLES_PX) - 1):
        return CIRCLES_PX[k]
    a, b, _ = np.polyfit(CIRCLES_PX[k - 1 : k + 2], explained[k - 1 : k + 2], 2)
    return float(np.clip(-b / (2.0 * a), CIRCLES_PX[k - 1], CIRCLES_PX[k + 1])) if a < 0.0 else CIRCLES_PX[k]
