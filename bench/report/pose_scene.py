"""The poses in three dimensions: the camera, and the part of the target that it saw at each pose."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bench.record.results import CalibrationData, ViewData
from bench.record.stored_calibration import camera_of
from bench.report.svg_plot import INK, LINE, MUTED, PANEL, POSE_COLOURS, Picture, shape_of
from calib.arrays import Array
from calib.model.camera import CameraModel

_YAW_DEG, _PITCH_DEG = 38.0, 24.0
"""Direction from which the scene is seen: from the right of the camera and from above."""
_MOST = 40
"""Largest number of poses drawn: more hide each other."""
_EDGE_POINTS = 9  # Enough for a smooth curve where the lens bends the side of the sensor
_ROOM = 22.0
"""Room for the title, points."""
_CORNERS = (0, 8, 16, 24)
"""Places of an image's corners among the points of its outline."""


def pose_scene(calibration: CalibrationData) -> str:
    """Draw camera, target plane and what each pose saw of it; empty if no pose has a rotation and a place."""
    views = calibration["views"]
    shown = views[:: max(1, -(-len(views) // _MOST))]
    camera = camera_of(calibration["camera"], calibration["image_size"])
    scenes = [
        (np.array(view["centre_mm"], float), outline_on_target(camera, calibration["image_size"], view))
        for view in shown
    ]
    scenes = [(centre, frame) for centre, frame in scenes if len(frame) > _CORNERS[-1]]
    if not scenes:
        return ""
    flat = np.concatenate([frame for _, frame in scenes])
    low, high = flat.min(axis=0), flat.max(axis=0)
    plane = _raised(np.array([low, (high[0], low[1]), high, (low[0], high[1])]))
    places = _Places([plane, *(centre[None, :] for centre, _ in scenes)])
    picture = Picture(
        *PANEL, "scene", "The poses in three dimensions", f"{len(scenes)} poses before the target."
    )
    picture.text(
        0.0, 9.0, f"Poses: {len(scenes)} of {len(views)}", colour=INK, size=9.5, more='font-weight="600"'
    )
    picture.add(_path(places.of(plane), LINE, "none", 1.0, closed=True))
    for number, (centre, frame) in enumerate(scenes):
        colour = POSE_COLOURS[number % len(POSE_COLOURS)]
        apex, outline = places.of(centre[None, :])[0], places.of(_raised(frame))
        picture.add(_path(outline, colour, colour, 1.1, closed=True, opacity=min(0.14, 2.0 / len(scenes))))
        for corner in _CORNERS:
            picture.add(_path(np.stack([apex, outline[corner]]), colour, "none", 0.6))
        picture.add(f'<circle cx="{apex[0]:g}" cy="{apex[1]:g}" r="2.6" fill="{colour}"/>')
    _name(picture, places.of(scenes[0][0][None, :])[0] + [0.0, 14.0], "camera")
    _name(picture, places.of(plane)[np.argmin(places.of(plane)[:, 1])] - [0.0, 5.0], "target")
    return picture.svg()


class _Places:
    """Where points of the target's frame, mm, lie in the picture: an orthographic view that shows all of them."""

    def __init__(self, parts: Sequence[Array]) -> None:
        every = _seen(np.concatenate(parts))
        low, high = every.min(axis=0), every.max(axis=0)
        room = np.array([PANEL[0] - 16.0, PANEL[1] - _ROOM - 14.0])
        self._scale = float((room / np.maximum(high - low, 1e-9)).min())
        self._at = np.array([8.0, _ROOM]) + (room - self._scale * (high - low)) / 2 - self._scale * low

    def of(self, points: Array) -> Array:
        """Return (N, 2) places of (N, 3) points."""
        return np.asarray(np.round(self._at + self._scale * _seen(points), 2) + 0.0)


def _seen(points: Array) -> Array:
    """Return (N, 2) coordinates, to the right and down, of (N, 3) points: the camera stands on the left.

    A parallel projection after a turn about y and one about x.
    """
    yaw, pitch = np.radians([_YAW_DEG, _PITCH_DEG])
    x, y, z = points.T
    across = x * np.cos(yaw) + z * np.sin(yaw)
    depth = -x * np.sin(yaw) + z * np.cos(yaw)
    return np.column_stack([across, y * np.cos(pitch) - depth * np.sin(pitch)])


def _raised(flat: Array) -> Array:
    """Return (N, 3) points of the target's plane."""
    return np.column_stack([flat, np.zeros(len(flat))])


def _path(
    places: Array, stroke: str, fill: str, width: float, *, closed: bool = False, opacity: float = 1.0
) -> str:
    filled = f'fill="{fill}" fill-opacity="{opacity:.3g}"' if fill != "none" else 'fill="none"'
    faint = ' class="faint-line"' if stroke == LINE else ""
    return f'<path d="{shape_of(places, closed=closed)}" {filled}{faint} stroke="{stroke}" stroke-width="{width:g}"/>'


def _name(picture: Picture, place: Array, text: str) -> None:
    picture.text(float(place[0]), float(place[1]), text, colour=MUTED, anchor="middle", size=8.0)


def outline_on_target(camera: CameraModel, image_size: Sequence[int], view: ViewData) -> Array:
    """Return the outline of the image of a pose on the target, mm, in order; points beyond it are left out."""
    rotation, centre = np.array(view["rotation"]), np.array(view["centre_mm"])
    directions = camera.rays(_outline(image_size)) @ rotation
    ahead = np.isfinite(directions).all(axis=1) & (directions[:, 2] > 1e-6)
    met = centre[:2] - directions[ahead, :2] * (centre[2] / directions[ahead, 2:])
    return np.asarray(np.round(met, 4))


def _outline(image_size: Sequence[int]) -> Array:
    """Return points along the edge of an image, in order."""
    width, height = image_size
    along = np.linspace(0.0, 1.0, _EDGE_POINTS)[:-1]
    zero, ones = np.zeros_like(along), np.ones_like(along)
    sides = ((along, zero), (ones, along), (1 - along, ones), (zero, 1 - along))
    return np.concatenate([np.column_stack([x * (width - 1), y * (height - 1)]) for x, y in sides])
