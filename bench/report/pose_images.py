"""Images of the poses: the event image, the detected stars and their positions projected by the calibration.

Pixel centres are at integers, so an image of width W spans -0.5 to W - 0.5.
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
from html import escape
from typing import Any

import cv2
import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from bench.measure.view_picture import ViewPicture
from bench.wording.target_words import STARS, TargetWords
from calib.arrays import Array

_ALL_PICTURES_BYTES = 1_050_000  # The report stays below 2 MB, so that a mail takes it
_ENCODINGS = ((1.0, None), (1.0, 85), (1.0, 65), (0.5, 80), (0.5, 60), (0.25, 70))
"""Scale and JPEG quality (None: PNG), tried in this order until an image is small enough."""
_RING_PX = 7.0  # Around a star of usual size
_CROSS_PX = 4.0  # Inside the ring
_RING_COLOUR, _CROSS_COLOUR = "#ff7a1a", "#00a3e0"
_CLOSE_UP_PX = 36.0  # A star and its surroundings


def pose_pictures(views: Sequence[ViewPicture], words: TargetWords = STARS) -> list[tuple[str, str]]:
    """Draw each pose that has an image as SVG with its name: rings and crosses at the stars and two close-ups."""
    images = [(view, view.image) for view in views if view.image is not None]
    limit = _ALL_PICTURES_BYTES // max(1, len(images))
    return [
        (_pose_picture(view, image, f"pose{number}", limit, words), view.name)
        for number, (view, image) in enumerate(images, 1)
    ]


def _pose_picture(
    view: ViewPicture, image: NDArray[np.uint8], identifier: str, limit_bytes: int, words: TargetWords
) -> str:
    height, width = image.shape
    side = (height - 24) / 2
    close_ups = "".join(
        _close_up(identifier, centre, (width + 24, row * (side + 24)), side)
        for row, centre in enumerate(_close_up_centres(view, (width, height)))
    )
    return Markup(  # noqa: S704 - the name was escaped
        f'<svg class="pose" role="img" aria-label="Image and {words.points} of {escape(view.name)}" '
        f'viewBox="-0.5 -0.5 {width + 24 + side:g} {height}" xmlns="http://www.w3.org/2000/svg">'
        f'<g id="{identifier}">'
        f'<image x="-0.5" y="-0.5" width="{width}" height="{height}" '
        f'image-rendering="pixelated" href="{_data_uri(image, limit_bytes)}"/>'
        f"{_outline(_RING_COLOUR, _rings(view.detected))}{_outline(_CROSS_COLOUR, _crosses(view.reprojected))}"
        f"</g>{close_ups}</svg>"
    )


def _outline(colour: str, path: str) -> str:
    # Attributes, not a stylesheet: rules do not reach what <use> repeats in the close-ups.
    return f'<path fill="none" stroke="{colour}" stroke-width="1.3" vector-effect="non-scaling-stroke" d="{path}"/>'


def _close_up_centres(view: ViewPicture, size: tuple[int, int]) -> list[Array]:
    """Return the star nearest to the image's centre and the star with the largest residual: the close-ups' centres."""
    if not len(view.detected):
        return []
    centre = (np.array(size) - 1) / 2
    nearest = np.linalg.norm(view.detected - centre, axis=1).argmin()
    worst = np.linalg.norm(view.residuals, axis=1).argmax()
    return [view.detected[nearest], view.detected[worst]]


def _close_up(identifier: str, centre: Array, place: tuple[float, float], side: float) -> str:
    left, top = centre - _CLOSE_UP_PX / 2
    return (
        f'<svg class="close-up" x="{place[0]:g}" y="{place[1] - 0.5:g}" width="{side:g}" height="{side:g}" '
        f'viewBox="{left:.2f} {top:.2f} {_CLOSE_UP_PX:g} {_CLOSE_UP_PX:g}"><use href="#{identifier}"/></svg>'
    )


def _rings(points: Array) -> str:
    r, d = _RING_PX, 2 * _RING_PX
    return "".join(
        f"M{x - r:.2f} {y:.2f}a{r:g} {r:g} 0 1 0 {d:g} 0a{r:g} {r:g} 0 1 0-{d:g} 0" for x, y in points
    )


def _crosses(points: Array) -> str:
    a, d = _CROSS_PX, 2 * _CROSS_PX
    return "".join(f"M{x - a:.2f} {y:.2f}h{d:g}M{x:.2f} {y - a:.2f}v{d:g}" for x, y in points)


def _data_uri(image: NDArray[np.uint8], limit_bytes: int) -> str:
    """Encode an image without loss if the result is small enough, otherwise with increasing loss."""
    data, kind = b"", ""
    for scale, quality in _ENCODINGS:
        shown: NDArray[Any] = image
        if scale != 1.0:
            shown = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        kind = "png" if quality is None else "jpeg"
        settings = [] if quality is None else [cv2.IMWRITE_JPEG_QUALITY, quality]
        data = cv2.imencode(f".{kind}", shown, settings)[1].tobytes()
        if len(data) <= limit_bytes:
            break
    return f"data:image/{kind};base64,{base64.b64encode(data).decode()}"
