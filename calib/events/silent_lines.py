"""Rows and columns that send no events where their neighbours do: they are dead, or the readout missed them.

Left as they are, they are dark edges through the stars, and displace these.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from calib.arrays import Array, Bools, Ints
from calib.events.accumulation import Grey

#: A line belongs to the lit part of the image if it has this share of the lit pixels of the fullest one. A single pixel
#: that noise lights, far beside the beam, makes no line between it and the beam a silent one.
BUSY = 0.1


class SilentLines(NamedTuple):
    """Numbers of the silent lines of an image."""

    rows: Ints = np.zeros(0, np.int64)
    columns: Ints = np.zeros(0, np.int64)

    @classmethod
    def of(cls, fired: Bools, lit: Bools) -> SilentLines:
        """Find the lines without any pixel that fired between lines with lit pixels; both are (H, W)."""
        return cls(*(_silent(np.asarray(fired.any(axis=across)), lit.sum(axis=across)) for across in (1, 0)))

    def filled(self, image: Grey) -> Grey:
        """Return an image, (H, W), with its silent lines interpolated linearly between the lines beside them."""
        for axis, lines in enumerate((self.rows, self.columns)):
            if len(lines):
                image = _interpolated(image, lines, axis)
        return image

    def crossed(self, points_px: Array, reach_px: float) -> Bools:
        """Return which of (N, 2) points, px, lie within a distance of a silent line, (N,)."""
        apart = [np.abs(points_px[:, k, None] - lines) for k, lines in enumerate((self.columns, self.rows))]
        return np.asarray((np.concatenate(apart, axis=1) < reach_px).any(axis=1))


def _silent(fired: Bools, lit: Ints) -> Ints:
    busy = np.flatnonzero(lit > BUSY * lit.max(initial=0))
    return np.arange(busy[0], busy[-1])[~fired[busy[0] : busy[-1]]] if len(busy) else np.zeros(0, np.int64)


def _interpolated(image: Grey, lines: Ints, axis: int) -> Grey:
    along = np.moveaxis(image.copy(), axis, 0)
    others = np.setdiff1d(np.arange(len(along)), lines)
    after = np.searchsorted(others, lines)
    before, behind = others[after - 1], others[after]
    share = ((lines - before) / (behind - before))[:, None]
    along[lines] = ((1.0 - share) * along[before] + share * along[behind]).astype(image.dtype)
    return np.moveaxis(along, 0, axis)
