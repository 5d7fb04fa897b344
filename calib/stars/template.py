"""Whether a star is at a guessed place: correlation with the pattern of its segments; no neighbours, no ids."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.arrays import Array, Array32, Bools, Ints

#: Radii at which a star's segments are compared with the image, pitches. Further inside, segments may merge.
TEMPLATE_RADII = (0.24, 0.28, 0.32, 0.36, 0.40, 0.44, 0.47)
#: Radii that are sufficient to search for a star, pitches.
SEARCH_RADII = (0.26, 0.35, 0.44)
#: Least radius of the outer part of a star, pitches. A star cut by the disc's rim lacks contrast there.
OUTER_RADIUS = 0.35
#: Sampled places across a segment, as shares of its width: off its edges, where blur mixes black and white.
TEMPLATE_ACROSS = (0.2, 0.5, 0.8)
#: Number of sectors in which a star's contrast is measured: of 16 segments, each has a white and a black one.
OCTANTS = 8
#: Least share of a star's samples that must lie in the image: a star that the frame cuts is compared with too little.
MIN_COVERED = 0.8
#: Stars whose median correlation with the sharp pattern is below this are searched with a learnt pattern too: at a blur
#: of 1.5 px, the sharp one finds 4 of 230.
SHARP_CORRELATION = 0.65
#: Least correlation of a learnt pattern with the sharp one; below it, the places that it was learnt from are no stars.
MIN_LIKENESS = 0.2
#: Standard deviation, as a share of the brightness, up to which an image counts as flat: it is interpolated in single
#: precision, which is right to 6e-8.
FLAT = 2e-6
#: Number of rows of points that OpenCV interpolates at once: it takes fewer than 32,767.
ROWS = 1 << 14


class StarTemplate(NamedTuple):
    """Samples of the segments of a star."""

    offsets: Array  # (S, 2) float64, pitches, places of the samples relative to the centre
    values: Array  # (S,) float64, +1 on a white segment, -1 on a black one
    octants: Ints  # (S,) int64, number of the sector of each sample, 0 to `OCTANTS` - 1
    outer: Bools  # (S,) bool, whether the radius is `OUTER_RADIUS` or more
    # (S,) float64, brightness with mean 0 and variance 1 with which an image is correlated: ``values``, or
    # what `learnt` found in an image that is out of focus.
    expected: Array
    segments: int  # Number of segments

    @classmethod
    def of(cls, segments: int, radii: tuple[float, ...] = TEMPLATE_RADII) -> StarTemplate:
        """Sample a star, as `calib.target` prints it, whose segments are counted from +Y, the first one white.

        It is sampled at the shares `TEMPLATE_ACROSS` of each segment.
        """
        across = np.array(TEMPLATE_ACROSS)
        turns = (np.arange(segments)[:, None] + across[None, :]).ravel() / segments
        angle, radius = np.meshgrid(2 * np.pi * (turns + 0.25), radii)
        white = np.floor(turns * segments) % 2 == 0
        values = np.tile(np.where(white, 1.0, -1.0), len(radii))
        octants = np.tile(np.floor(turns * OCTANTS).astype(np.int64), len(radii))
        offsets = np.column_stack([(radius * np.cos(angle)).ravel(), (radius * np.sin(angle)).ravel()])
        return cls(offsets, values, octants, (radius >= OUTER_RADIUS).ravel(), values, segments)

    def learnt(self, image: Array32, centres: Array, linear: Array, sign: float) -> StarTemplate | None:
        """Learn from stars, right to a few px, what a star looks like in an image; None if the places show no stars.

        If the lens is out of focus and the image is black and white, white covers the middle of each star, and the
        black segments are short. The sharp pattern then correlates badly and is best a pixel or two off the centre. Own
        procedure: the mean over the stars, made equal under quarter turns (half turns if a quarter turn swaps black and
        white), as the print is. So the learnt pattern cannot move a centre. Linear maps are (N, 2, 2) px per pitch.
        """
        samples = values_at(image, *self.places(centres, linear))
        samples = sign * samples[np.isfinite(samples).all(axis=1)]
        if not len(samples):
            return None
        turns = 4 if self.segments % 8 == 0 else 2
        folded = samples.mean(axis=0).reshape(-1, turns, self.segments * len(TEMPLATE_ACROSS) // turns)
        whole = np.repeat(folded.mean(axis=1, keepdims=True), turns, axis=1).ravel()
        spread = float(whole.std())
        if spread == 0.0 or float(((whole - whole.mean()) * self.values).mean()) < MIN_LIKENESS * spread:
            return None
        return self._replace(expected=(whole - whole.mean()) / spread)

    def places(self, centres: Array, linear: Array) -> Array:
        """Return the x and y, (2, N, S) px, of the samples of N stars, given their (N, 2, 2) linear maps."""
        return np.asarray((centres[:, :, None] + linear @ self.offsets.T).swapaxes(0, 1))


def values_at(image: Array32, x: NDArray[np.floating], y: NDArray[np.floating]) -> Array32:
    """Return the bilinear values of an image at points, of the shape of ``x`` and ``y``, px; nan outside."""
    across, down = (np.asarray(each, np.float32).reshape(-1, x.shape[-1]) for each in (x, y))
    pixel_sums = np.empty(across.shape, np.float32)
    border = cv2.BORDER_CONSTANT
    for first in range(0, len(pixel_sums), ROWS):
        part = slice(first, first + ROWS)
        cv2.remap(image, across[part], down[part], cv2.INTER_LINEAR, pixel_sums[part], border, np.nan)
    return pixel_sums.reshape(x.shape)


def correlations(seen: Array32, template: StarTemplate) -> Array:
    """Return the correlation (Lewis, 1995) of (..., S) values with a star; nan if too many of them are nan.

    It is 0 if the image is flat there.
    """
    count = np.full(seen.shape[:-1], seen.shape[-1], np.float32)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = seen.sum(axis=-1) / count
        off = seen - mean[..., None]
        partly = np.isnan(mean)
        if partly.any():
            known = ~np.isnan(seen[partly])
            count[partly] = known.sum(axis=-1, dtype=np.float32)
            mean[partly] = np.where(known, seen[partly], 0.0).sum(axis=-1) / count[partly]
            off[partly] = np.where(known, seen[partly] - mean[partly, None], 0.0)
        variance = np.einsum("...s,...s->...", off, off) / count
        correlation = off @ template.expected.astype(np.float32) / count / np.sqrt(variance)
    correlation = np.where(variance > (FLAT * mean) ** 2, correlation, 0.0)
    return np.where(count >= MIN_COVERED * seen.shape[-1], correlation, np.nan)


def star_contrasts(
    image: Array32, centres: Array, linear: Array, template: StarTemplate, sign: float
) -> tuple[Array, Array]:
    """Return each star's correlation with its pattern, (N,) -1 to 1, and its contrast by octants, (N, OCTANTS).

    Own contrast: twice the slope of the image over the pattern in the outer part of each octant, both without their
    mean over the star; of a sharp star that is white minus black. Nan if too much, or all of an octant, lies outside of
    the image. Centres (N, 2), px; linear maps (N, 2, 2), px per pitch; the sign is +1 if white is bright.
    """
    seen = sign * values_at(image, *template.places(centres, linear))
    outer, expected = seen[:, template.outer].astype(float), template.expected[template.outer]
    expected = expected - expected.mean()
    known, octants = ~np.isnan(outer), template.octants[template.outer, None] == np.arange(OCTANTS)
    with np.errstate(invalid="ignore", divide="ignore"):
        bright, dark = (
            np.where(known & side, outer, 0.0).sum(axis=1) / (known & side).sum(axis=1)
            for side in (expected > 0.0, expected <= 0.0)
        )
        off = np.where(known, outer - 0.5 * (bright + dark)[:, None], 0.0)
        contrast = 2.0 * (off * expected) @ octants / ((known * expected**2) @ octants)
    return correlations(seen, template), contrast
