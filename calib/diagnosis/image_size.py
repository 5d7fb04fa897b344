"""The stated image size: points outside of it, or a size that is too large for the points and the principal point."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.errors import InputMismatch
from calib.model.camera import CameraModel
from calib.view import View

Size = tuple[int, int]

#: Sizes of event cameras and of common frame cameras, px.
KNOWN_SIZES: tuple[Size, ...] = (
    (1280, 720),
    (640, 480),
    (346, 260),
    (320, 320),
    (304, 240),
    (240, 180),
    (128, 128),
    (320, 240),
    (480, 320),
    (640, 512),
    (768, 640),
    (816, 612),
    (752, 480),
    (800, 600),
    (1024, 768),
    (1280, 800),
    (1280, 960),
    (1280, 1024),
    (1440, 1080),
    (1600, 1200),
    (1632, 1224),
    (1920, 1080),
    (1920, 1200),
    (2048, 1536),
    (2448, 2048),
    (2592, 1944),
    (4096, 3000),
)
#: Points up to this far outside of the outermost pixel centres are inside of the image, px: half a pixel, and another
#: half for points whose origin is the corner.
_OUTSIDE_PX = 1.0
#: A principal point this share of the width or height away from the middle is implausible.
_FAR_FROM_MIDDLE = 0.15
#: A size explains the views if its middle is within this share of the principal point ...
_NEAR_MIDDLE = 0.1
#: ... and if the outermost points come this close to its border, as a share of it.
_NEAR_BORDER = 0.1


@dataclass(frozen=True)
class ImageSizeDoubt:
    """A stated image size that the principal point contradicts."""

    stated: Size  # Width and height as stated, px
    principal_point_px: tuple[float, float]  # Principal point, px
    reached_px: tuple[float, float]  # Largest x and largest y of all points, px
    plausible: Size | None  # A size that would explain them; None if no known size does

    @property
    def sentence(self) -> str:
        """Says where the principal point lies, and which size would explain it."""
        middle = [(length - 1) / 2 for length in self.stated]
        away = np.hypot(*(np.array(self.principal_point_px) - middle))
        text = (
            f"The principal point lies {away:.0f} px from the middle of the stated image size "
            f"{self.stated[0]} x {self.stated[1]}, and no point lies beyond x = {self.reached_px[0]:.0f} and "
            f"y = {self.reached_px[1]:.0f}."
        )
        if self.plausible:
            return f"{text} The image size is probably {self.plausible[0]} x {self.plausible[1]}."
        return f"{text} Check the image size, and whether the points come from a part of the image."


def require_points_inside(views: Sequence[View]) -> None:
    """Refuse views with points outside of their image size; names the first one, and a known size that holds all."""
    for view in views:
        limit = np.array(view.image_size) - 1.0 + _OUTSIDE_PX
        outside = ((view.points_px < -_OUTSIDE_PX) | (view.points_px > limit)).any(axis=1)
        if not outside.any():
            continue
        beyond = np.maximum(view.points_px - limit, -_OUTSIDE_PX - view.points_px).max(axis=1)
        x, y = view.points_px[int(beyond.argmax())]
        size = _holding(_reached(views), views)
        hint = f" The points fit into {size[0]} x {size[1]}." if size else ""
        raise InputMismatch(
            f"{np.count_nonzero(outside)} of {len(view)} stars lie outside of the stated image size "
            f"{view.image_size[0]} x {view.image_size[1]}, the outermost at ({x:.1f}, {y:.1f}).{hint}",
            where=f"view {view.name}",
            remedy="Give the image size of the camera, width first.",
        )


def check_image_size(
    views: Sequence[View], camera: CameraModel, sigma_px: tuple[float, float]
) -> ImageSizeDoubt | None:
    """Look for a stated image size that the principal point contradicts; None if not, or if nothing decides.

    Own rule: the principal point is farther from the middle than 15 % of the width or height, by more than 4 sigma. A
    known size explains this if its middle is near the principal point, and the outermost points are near its border.
    ``sigma_px`` is that of cx and cy.
    """
    size = np.array(views[0].image_size, float)
    point = np.array([camera.cx, camera.cy])
    away = np.abs(point - (size - 1) / 2)
    if not (away - 4.0 * np.array(sigma_px) > _FAR_FROM_MIDDLE * size).any():
        return None
    reached = _reached(views)
    explained = [
        one
        for one in KNOWN_SIZES
        if (np.array(one) <= size).all()
        and (reached <= np.array(one) - 1.0 + _OUTSIDE_PX).all()
        and (np.array(one) - reached < _NEAR_BORDER * np.array(one)).all()
        and (np.abs(point - (np.array(one) - 1) / 2) < _NEAR_MIDDLE * np.array(one)).all()
    ]
    plausible = min(explained, key=lambda one: one[0] * one[1], default=None)
    return ImageSizeDoubt(
        views[0].image_size, (camera.cx, camera.cy), (float(reached[0]), float(reached[1])), plausible
    )


def _reached(views: Sequence[View]) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Return the largest x and the largest y of all points, (2,) px."""
    return np.asarray(np.max([view.points_px.max(axis=0) for view in views], axis=0))


def _holding(reached: np.ndarray[tuple[int], np.dtype[np.float64]], views: Sequence[View]) -> Size | None:
    """Return the smallest known size that holds all points closely; None if there is none."""
    if min(view.points_px.min() for view in views) < -_OUTSIDE_PX:
        return None
    holding = [one for one in KNOWN_SIZES if (reached <= np.array(one) - 1.0 + _OUTSIDE_PX).all()]
    smallest = min(holding, key=lambda one: one[0] * one[1], default=None)
    if smallest is None or not (np.array(smallest) - reached < 2.0 * _NEAR_BORDER * np.array(smallest)).all():
        return None
    return smallest
