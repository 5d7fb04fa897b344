"""The disc of light in a live picture: how much of the frame the beam covers, and the circle of its rim.

The module uses brightness only: no stars, no print, no camera. It serves to aim; a calibration uses the rim that
`calib.stars.rim` measures. The steps are:

1. reduce the image until the print is only some cells wide;
2. close the gaps of the dark print, up to about the size of a tag's module, and take the convex hull of the light;
3. take the border of the largest lit part that is not the frame's border, and fit a circle to it.

The rim of a real beam is ragged, and a frame shows a short arc of it. A circle of any radius through such an arc may be
off by several radii. So the radius is given where it is known; without it, an arc must be long enough.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from calib.arrays import AnyArray, Array, Array32, Bytes

#: Long side of the reduced image, cells, and side of the square that closes the print's gaps, as a share of it.
REDUCED, CLOSING = 192, 0.06
#: Brightness from which a cell is lit, as a share of the brightness of white print: the light of a lamp is uneven, and
#: dark print is closed before.
LIT = 0.35
#: Least share of the frame that is lit, and least length of the rim, cells: a speck is no beam, and a circle has three
#: unknowns.
MIN_LIT, MIN_RIM = 0.002, 12
#: Least share of the frame that is dark for a circle. Closing the print's gaps rounds smaller dark corners off.
MIN_DARK = 0.04
#: Largest rms distance of the rim from its circle, as a share of the radius: a real rim is ragged. Largest radius,
#: frame diagonals: of a larger circle, the frame shows a straight line.
MAX_OFF, MAX_RADIUS = 0.1, 4.0
#: Shortest arc, degrees, that shows a circle whose radius is not known: of a shorter one, the circle may be off by
#: radii.
MIN_ARC_DEG = 50.0


class Beam(NamedTuple):
    """The beam's disc in a picture."""

    share: float  # Share of the frame that is lit, 0 to 1
    # Centre (column, row) of the circle through the rim, px; None if the rim does not show it.
    centre_px: tuple[float, float] | None
    radius_px: float | None  # Radius of the circle, px
    lit: Bytes  # (h, w) uint8, 1 where the reduced image is lit
    scale: float  # Size of a cell of ``lit``, px


def find_beam(image: AnyArray, *, least: float = 0.0, radius_px: float | None = None) -> Beam:
    """Find the disc of light in an image of any sharpness, as the head of the module says; a share of 0 without light.

    Circle: linear least squares (Kåsa, 1976); with a given radius, least squares of the distances (Gander, Golub &
    Strebel, 1994). Below the brightness ``least`` of white print nothing counts as light.
    """
    small, scale = reduced(image, REDUCED)
    side = 2 * round(CLOSING * REDUCED / 2) + 1
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
    # A dark border would stop the closing at the frame; the default border of OpenCV's morphology does not.
    closed = cv2.morphologyEx(small, cv2.MORPH_CLOSE, disc)
    white, dark = float(np.quantile(closed, 0.98)), max(float(np.quantile(closed, 0.01)), 0.0)
    level = LIT * white if dark < LIT * white else 0.0
    lit = _filled((closed > level).astype(np.uint8))
    share = float(lit.mean())
    if white <= least or share < MIN_LIT:
        return Beam(0.0, None, None, np.zeros(small.shape, np.uint8), scale)
    rim, circle = _rim(lit), None
    if len(rim) >= MIN_RIM and share <= 1.0 - MIN_DARK:
        circle = _circle(rim, lit) if radius_px is None else _circle_of(radius_px / scale, rim, lit)
    if circle is None:
        return Beam(share, None, None, lit, scale)
    (x, y), radius = circle
    centre = ((x + 0.5) * scale - 0.5, (y + 0.5) * scale - 0.5)
    return Beam(share, centre, radius * scale, lit, scale)


def reduced(image: AnyArray, side: int) -> tuple[Array32, float]:
    """Return an image reduced until its longer side has so many cells, its specks removed; and a cell's size, px."""
    values = np.nan_to_num(np.asarray(image, np.float32))
    scale = max(values.shape) / side
    shape = (max(1, round(values.shape[1] / scale)), max(1, round(values.shape[0] / scale)))
    small = cv2.medianBlur(cv2.resize(values, shape, interpolation=cv2.INTER_AREA), 3)
    return np.asarray(small, np.float32), scale


def _filled(lit: Bytes) -> Bytes:
    """Return the convex hull of the largest lit part: a disc cut by the frame is convex, and the print is not.

    A tag at the frame's border is dark up to the border, so that filling holes is not enough. Own procedure.
    """
    count, parts, stats, _ = cv2.connectedComponentsWithStats(lit, connectivity=8)
    if count < 2:
        return lit
    largest = (parts == 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))).astype(np.uint8)
    outlines, _ = cv2.findContours(largest, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    filled = np.zeros_like(lit)
    cv2.fillConvexPoly(filled, cv2.convexHull(outlines[0]), 1)
    return filled


def _rim(lit: Bytes) -> Array:
    """Return the (N, 2) lit cells that have a dark neighbour; cells within two cells of the frame are omitted."""
    inner = cv2.erode(lit, np.ones((3, 3), np.uint8), borderType=cv2.BORDER_REPLICATE)
    border = (lit > 0) & (inner == 0)
    border[:2], border[-2:], border[:, :2], border[:, -2:] = False, False, False, False
    return np.argwhere(border)[:, ::-1].astype(float)


def _circle(rim: Array, lit: Bytes) -> tuple[tuple[float, float], float] | None:
    """Fit a circle, and again without far points (Kåsa, 1976; own limits); None if it is no arc around the light."""
    kept = rim
    for _ in range(3):
        design = np.column_stack([2.0 * kept, np.ones(len(kept))])
        (x, y, c), _, rank, _ = np.linalg.lstsq(design, (kept**2).sum(axis=1), rcond=None)
        if rank < 3 or c + x * x + y * y <= 0.0:
            return None
        radius = float(np.sqrt(c + x * x + y * y))
        off = np.abs(np.hypot(rim[:, 0] - x, rim[:, 1] - y) - radius)
        kept = rim[off <= max(2.5 * float(np.median(off)), 1.0)]
        if len(kept) < MIN_RIM:
            return None
    rms = float(np.sqrt(np.mean((np.hypot(kept[:, 0] - x, kept[:, 1] - y) - radius) ** 2)))
    inside = np.hypot(*(_middle(lit) - (x, y))) < radius
    if rms > MAX_OFF * radius or radius > MAX_RADIUS * np.hypot(*lit.shape) or not inside:
        return None
    return ((float(x), float(y)), radius) if _arc_deg(kept - (x, y)) >= MIN_ARC_DEG else None


def _circle_of(radius: float, rim: Array, lit: Bytes) -> tuple[tuple[float, float], float] | None:
    """Fit the centre, cells, of a circle of a given radius; None if the rim does not lie on one around the light.

    Least squares of the distances from the circle (Gander, Golub & Strebel, 1994).
    """
    from scipy.optimize import least_squares

    # Begin on the side of the light: a short arc fits as well from its other side.
    offset = _middle(lit) - rim.mean(axis=0)
    start = rim.mean(axis=0) + radius * offset / max(float(np.hypot(*offset)), 1e-9)

    def off(centre: Array) -> Array:
        return np.asarray(np.hypot(*(rim - centre).T) - radius)

    fit = least_squares(off, start)
    inside = np.hypot(*(_middle(lit) - fit.x)) < radius
    if not inside or float(np.sqrt(np.mean(fit.fun**2))) > MAX_OFF * radius:
        return None
    return (float(fit.x[0]), float(fit.x[1])), radius


def _middle(lit: Bytes) -> Array:
    """Return the centroid of the light, (column, row), cells."""
    return np.asarray(np.argwhere(lit > 0)[:, ::-1].mean(axis=0))


def _arc_deg(out: Array) -> float:
    """Return the arc that (N, 2) points span around the origin, degrees: the whole turn less the widest gap."""
    angles = np.sort(np.degrees(np.arctan2(out[:, 1], out[:, 0])))
    return 360.0 - float(np.diff(angles, append=angles[0] + 360.0).max())
