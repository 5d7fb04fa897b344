"""The geometry of the poses: where the gimbal turned the camera, and which part of the target each pose saw."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import PathPatch
from matplotlib.path import Path as Outline
from numpy.typing import NDArray

from bench.report.camera_values import camera_of
from bench.report.drawing import INK, MUTED, PANEL, POSE_COLOURS, STYLE, hide_frame, to_svg

Array = NDArray[np.float64]
Json = Mapping[str, Any]

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


def pose_directions(results: Json) -> str:
    """Draw the pan and tilt of each pose as a small frame that is turned by the roll of the camera.

    Parameters
    ----------
    results
        Content of results.json.

    Returns
    -------
    str
        SVG; empty if no pose has angles.
    """
    places = _places(results)
    if not places:
        return ""
    width, height = results["calibration"]["image_size"]
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=PANEL, layout="constrained")
        axes = figure.add_subplot()
        span = _limits(axes, places)
        half = np.array([1.0, height / width]) * _FRAME_SHARE * span / 2
        for how, colour in _COLOURS.items():
            own = [place for place in places if place.use == how]
            _frames(axes, own, half, colour, filled=how == _USED)
        if len(places) <= _MOST_NUMBERS:
            for place in places:
                axes.annotate(
                    f"{place.number}",
                    (place.pan_deg, place.tilt_deg),
                    ha="center",
                    va="center",
                    fontsize=8,
                    color=INK,
                )
        axes.set(xlabel="pan, degrees", ylabel="tilt, degrees")
        _legend(axes, places)
        hide_frame(axes)
        return to_svg(figure, "poses", "Pan, tilt and roll of the poses")


def pose_frames(calibration: Json) -> str:
    """Draw the outline of the image of each pose on the target.

    Parameters
    ----------
    calibration
        ``calibration`` of results.json.

    Returns
    -------
    str
        SVG; empty if no pose has a rotation.
    """
    views = [view for view in calibration["views"] if "rotation" in view and "centre_mm" in view]
    if not views:
        return ""
    camera = camera_of(calibration["camera"], calibration["image_size"])
    rays = camera.rays(_outline(calibration["image_size"]))
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=PANEL, layout="constrained")
        axes = figure.add_subplot()
        for number, view in enumerate(views[:: -(-len(views) // _MOST_FRAMES)]):
            directions = rays @ np.array(view["rotation"])
            centre = np.array(view["centre_mm"])
            ahead = np.isfinite(directions).all(axis=1) & (directions[:, 2] > 1e-6)
            at = centre[:2] - directions[ahead, :2] * (centre[2] / directions[ahead, 2:])
            at = np.round(np.vstack([at, at[:1]]), 4)
            colour = POSE_COLOURS[number % len(POSE_COLOURS)]
            axes.plot(at[:, 0], at[:, 1], color=colour, linewidth=1.0)
            axes.fill(at[:, 0], at[:, 1], color=colour, alpha=min(0.12, 1.0 / len(views)), linewidth=0)
        axes.set(aspect="equal", xlabel="x on the target, mm", ylabel="y on the target, mm")
        axes.invert_yaxis()
        axes.set_title("Images of the poses on the target")
        hide_frame(axes)
        return to_svg(figure, "frames", "Outlines of the images on the target")


def _places(results: Json) -> list[_Place]:
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


def _limits(axes: Axes, places: Sequence[_Place]) -> float:
    """Set equal scales and limits that show every pose; return the width of the plot, degrees."""
    pan, tilt = (np.array([getattr(place, name) for place in places]) for name in ("pan_deg", "tilt_deg"))
    ratio = PANEL[0] / PANEL[1]
    span = 1.35 * max(float(np.ptp(pan)), ratio * float(np.ptp(tilt)), 1.0)
    for middle, half, setter in (
        ((pan.min() + pan.max()) / 2, span / 2, axes.set_xlim),
        ((tilt.min() + tilt.max()) / 2, span / ratio / 2, axes.set_ylim),
    ):
        setter(float(middle - half), float(middle + half))
    axes.set_aspect("equal")
    return span


def _frames(axes: Axes, places: Sequence[_Place], half: Array, colour: str, *, filled: bool) -> None:
    """Draw the frames of some poses as one path; the line from the centre points to the right side of the image."""
    if not places:
        return
    corners = half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    vertices, codes = [], []
    for place in places:
        cos, sin = np.cos(np.radians(place.roll_deg)), np.sin(np.radians(place.roll_deg))
        turned = corners @ np.array([[cos, -sin], [sin, cos]]) + [place.pan_deg, place.tilt_deg]
        vertices.append(np.vstack([turned, turned[:1]]))
        codes += [Outline.MOVETO, Outline.LINETO, Outline.LINETO, Outline.LINETO, Outline.CLOSEPOLY]
    axes.add_patch(
        PathPatch(
            Outline(np.round(np.concatenate(vertices), 6), codes),
            facecolor=(*mpl.colors.to_rgb(colour), 0.16 if filled else 0.0),
            edgecolor=colour,
            linewidth=1.1,
            linestyle="-" if filled else "--",
        )
    )


def _legend(axes: Axes, places: Sequence[_Place]) -> None:
    counts = {how: sum(place.use == how for place in places) for how in _COLOURS}
    handles = [
        Line2D([], [], color=_COLOURS[how], linestyle="-" if how == _USED else "--", label=f"{count} {how}")
        for how, count in counts.items()
        if count
    ]
    axes.legend(
        handles=handles, loc="lower left", bbox_to_anchor=(0, 1.0), ncols=len(handles), frameon=False,
        borderaxespad=0.2, handlelength=1.4, columnspacing=1.2, labelcolor=MUTED,
    )  # fmt: skip


def _outline(image_size: Sequence[int]) -> Array:
    """Return points along the edge of an image, in order."""
    width, height = image_size
    along = np.linspace(0.0, 1.0, _EDGE_POINTS)[:-1]
    zero, one = np.zeros_like(along), np.ones_like(along)
    sides = ((along, zero), (one, along), (1 - along, one), (zero, 1 - along))
    return np.concatenate([np.column_stack([x * (width - 1), y * (height - 1)]) for x, y in sides])
