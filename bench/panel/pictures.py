"""Stars and residuals of one recording as a page shows them."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.run.last_view import LastView

Json = dict[str, Any]
Array = NDArray[np.float64]

_ORDERS = (5, 3)
_STARS_A_TERM = 2
_DIGITS = 3
_PNG_SIZE = struct.Struct(">16xII")
"""Width and height in the first bytes of a PNG file (ISO/IEC 15948, 11.2.2)."""


def picture_of_view(left: LastView) -> Json:
    """Return what a page shows of the picture that a run in progress has left.

    Returns: As `picture_answer`.
    """
    nodes = np.array(left.nodes, np.float64).reshape(-1, 2)
    points_px = np.array(left.points_px, np.float64).reshape(-1, 2)
    width, height = _PNG_SIZE.unpack_from(left.png)
    return {**own_residuals((width, height), nodes, points_px), "fault": left.fault}


def own_residuals(size: tuple[int, int], nodes: Array, points_px: Array) -> Json:
    """Return stars with their residuals to a smooth fit of this pose alone.

    size: Width and height of the image, px.
    nodes: (N, 2) float64, column and row of each star on the target.
    points_px: (N, 2) float64, px, stars found.
    Returns: As `picture_answer`.
    """
    residuals = smooth_residuals(nodes, points_px)
    return picture_answer(size, points_px, residuals, "a smooth fit of this pose alone")


def smooth_residuals(nodes: Array, points_px: Array) -> Array | None:
    """Return what a polynomial from the target to the image leaves of the stars' places.

    It is of fifth order, or of third order if there are few stars. It follows perspective and distortion closely enough
    to show single stars that are wrong; it is no calibration.

    nodes: (N, 2) float64, column and row of each star on the target.
    points_px: (N, 2) float64, px, stars found.
    Returns: (N, 2) float64, px; None if there are too few stars for it.
    """
    order = next((n for n in _ORDERS if len(nodes) >= _STARS_A_TERM * (n + 1) * (n + 2) // 2), None)
    if order is None:
        return None
    centred = nodes - nodes.mean(axis=0)
    x, y = (centred / max(float(np.abs(centred).max()), 1e-9)).T
    powers = [x**i * y**j for i in range(order + 1) for j in range(order + 1 - i)]
    design = np.column_stack(powers)
    fitted, *_ = np.linalg.lstsq(design, points_px, rcond=None)
    return np.asarray(points_px - design @ fitted)


def picture_answer(
    size: tuple[int, int], points_px: Array, residuals_px: Array | None = None, residuals_of: str = ""
) -> Json:
    """Return stars and residuals as JSON holds them.

    size: Width and height of the image, px.
    points_px: (N, 2) float64, px, stars found.
    residuals_px: (N, 2) float64, px; None if there are none.
    Returns: ``size``, ``stars``, ``residuals``, ``residuals_of``, ``rms_px``, ``fault``.
    """
    answer: Json = {
        "size": list(size),
        "stars": np.round(points_px, _DIGITS).tolist(),
        "residuals": None,
        "residuals_of": "",
        "rms_px": None,
        "fault": "",
    }
    if residuals_px is not None and len(residuals_px):
        answer["residuals"] = np.round(residuals_px, _DIGITS + 1).tolist()
        answer["residuals_of"] = residuals_of
        answer["rms_px"] = float(np.sqrt(np.mean(np.sum(residuals_px**2, axis=1))))
    return answer
