"""The geometry of the poses: where the gimbal turned the camera, and which part of the target each pose saw."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.records.results import CalibrationData, Results
from bench.report.camera_values import camera_of
from bench.report.drawing import PANEL, POSE_COLOURS
from bench.report.plot_frame import Key, Words, axes_in
from bench.report.scales import Scale
from bench.report.svg_plot import Axes, Picture

Array = NDArray[np.float64]

_USED, _LEFT_OUT, _REFUSED = "used", "accepted, not used", "no recording accepted"
_COLOURS = {_USED: POSE_COLOURS[0], _LEFT_OUT: POSE_COLOURS[4], _REFUSED: "#a32020"}
_FRAME_SHARE = 0.11
"""Width of a frame in the plot, as a share of its width."""
_MOST_NUMBERS, _MOST_FRAMES = 40, 150
_EDGE_POINTS = 9


@dataclass(frozen=True)
class _Place:
    """A pose of the plot: its number, its pan, tilt and roll in degrees, and whether the calibration used it."""

    number: int
    pan_deg: float
    tilt_deg: float
    roll_deg: float
    use: str


def pose_directions(results: Results) -> str:
    """Draw the pan and tilt of each pose as a small frame that is turned by the roll of the camera.

    Returns: SVG; empty if no pose has angles, or if all have the same ones, as where a board was moved.
    """
    places = _places(results)
    if not places or len({(place.pan_deg, place.tilt_deg) for place in places}) < min(2, len(places)):
        return ""
    width, height = results["calibration"]["image_size"]
    about = f"Pan {_range_text(p.pan_deg for p in places)}, tilt {_range_text(p.tilt_deg for p in places)} degrees."
    picture = Picture(*PANEL, "poses", "Pan, tilt and roll of the poses", about)
    words = Words((), "pan, degrees", "tilt, degrees", _legend(places))
    axes = axes_in(picture, *_limits(places), words, equal="extend")
    half = np.array([1.0, height / width]) * _FRAME_SHARE * abs(axes.x.high - axes.x.low) / 2
    for how, colour in _COLOURS.items():
        _frames(axes, [place for place in places if place.use == how], half, colour, filled=how == _USED)
    if len(places) <= _MOST_NUMBERS:
        for place in places:
            axes.text((place.pan_deg, place.tilt_deg), f"{place.number}", by=(0.0, 2.8), anchor="middle")
    return picture.svg()


def pose_frames(calibration: CalibrationData) -> str:
    """Draw the outline of the image of each pose on the target.

    calibration: ``calibration`` of results.json.
    Returns: SVG; empty if no pose has a rotation.
    """
    views = [view for view in calibration["views"] if "rotation" in view and "centre_mm" in view]
    if not views:
        return ""
    camera = camera_of(calibration["camera"], calibration["image_size"])
    rays = camera.rays(_outline(calibration["image_size"]))
    shown = views[:: -(-len(views) // _MOST_FRAMES)]
    frames = [_on_target(rays, np.array(view["rotation"]), np.array(view["centre_mm"])) for view in shown]
    every = np.concatenate(frames)
    if not len(every):
        return ""
    (left, top), (right, bottom) = every.min(axis=0), every.max(axis=0)
    wide, high = 0.05 * (right - left), 0.05 * (bottom - top)
    words = Words(("Images of the poses on the target",), "x on the target, mm", "y on the target, mm")
    about = f"x {left:.4g} to {right:.4g} mm, y {top:.4g} to {bottom:.4g} mm."
    picture = Picture(*PANEL, "frames", "Outlines of the images on the target", about)
    across, down = (
        Scale(float(left - wide), float(right + wide)),
        Scale(float(bottom + high), float(top - high)),
    )
    axes = axes_in(picture, across, down, words, equal="extend")
    for number, frame in enumerate(frames):
        colour = POSE_COLOURS[number % len(POSE_COLOURS)]
        axes.shapes([frame], colour, min(0.12, 1.0 / len(views)), colour)
    return picture.svg()


def _on_target(rays: Array, rotation: Array, centre: Array) -> Array:
    """Return where rays of an image meet the target, mm; rays that do not meet it are left out."""
    directions = rays @ rotation
    ahead = np.isfinite(directions).all(axis=1) & (directions[:, 2] > 1e-6)
    met = centre[:2] - directions[ahead, :2] * (centre[2] / directions[ahead, 2:])
    return np.asarray(np.round(met, 4))


def _places(results: Results) -> list[_Place]:
    """Return the poses that have angles."""
    rotations = {v["name"]: v["rotation"] for v in results["calibration"]["views"] if "rotation" in v}
    found = []
    for pose in results.get("poses") or []:
        angles = pose.get("measured_deg") or pose.get("commanded_deg") or {}
        if not {"pan", "tilt"} & set(angles):
            continue
        accepted = any(attempt["accepted"] for attempt in pose.get("attempts") or [])
        used = pose.get("rms_px") is not None
        how = _USED if used else _LEFT_OUT if accepted else _REFUSED
        rotation = rotations.get(pose["name"]) if used else None
        roll = float(angles.get("roll", 0.0))
        if rotation is not None:
            roll = float(np.degrees(np.arctan2(rotation[1][0], rotation[0][0])))
        found.append(
            _Place(
                int(pose["index"]), float(angles.get("pan", 0.0)), float(angles.get("tilt", 0.0)), roll, how
            )
        )
    return found


def _limits(places: Sequence[_Place]) -> tuple[Scale, Scale]:
    """Return limits that show every pose with its frame."""
    pan, tilt = (np.array([getattr(place, name) for place in places]) for name in ("pan_deg", "tilt_deg"))
    ratio = PANEL[0] / PANEL[1]
    half = 1.35 / 2 * max(float(np.ptp(pan)), ratio * float(np.ptp(tilt)), 1.0)
    across, up = float(pan.min() + pan.max()) / 2, float(tilt.min() + tilt.max()) / 2
    return Scale(across - half, across + half), Scale(up - half / ratio, up + half / ratio)


def _frames(axes: Axes, places: Sequence[_Place], half: Array, colour: str, *, filled: bool) -> None:
    """Draw the frames of some poses as one path, each turned by its roll."""
    if not places:
        return
    corners = half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    outlines = []
    for place in places:
        cos, sin = np.cos(np.radians(place.roll_deg)), np.sin(np.radians(place.roll_deg))
        outlines.append(corners @ np.array([[cos, -sin], [sin, cos]]) + [place.pan_deg, place.tilt_deg])
    axes.shapes(outlines, colour, 0.16 if filled else 0.0, colour, 1.1, dash="" if filled else "4 2.5")


def _legend(places: Sequence[_Place]) -> list[Key]:
    counts = {how: sum(place.use == how for place in places) for how in _COLOURS}
    return [
        Key(f"{count} {how}", _COLOURS[how], "line" if how == _USED else "dashed")
        for how, count in counts.items()
        if count
    ]


def _range_text(values: Iterable[float]) -> str:
    found = list(values)
    return f"{min(found):.3g} to {max(found):.3g}"


def _outline(image_size: Sequence[int]) -> Array:
    """Return points along the edge of an image, in order."""
    width, height = image_size
    along = np.linspace(0.0, 1.0, _EDGE_POINTS)[:-1]
    zero, one = np.zeros_like(along), np.ones_like(along)
    sides = ((along, zero), (one, along), (1 - along, one), (zero, 1 - along))
    return np.concatenate([np.column_stack([x * (width - 1), y * (height - 1)]) for x, y in sides])
