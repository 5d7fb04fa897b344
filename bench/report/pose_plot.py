"""The geometry of the poses: where the gimbal turned the camera, and which part of the target each pose saw."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.record.coverage import coverage_factor
from bench.record.results import CalibrationData, CameraData, Results, ViewData
from bench.record.stored_calibration import camera_covariance, camera_of
from bench.report.svg_plot import INK, MUTED, PANEL, POSE_COLOURS, Axes, Key, Picture, Words, axes_in
from bench.report.svg_scale import Scale, text_width
from bench.wording.target_words import STARS, TargetWords
from calib.model.camera import CameraModel
from calib.model.lens import is_fisheye
from calib.model.result_parts import WORST_CORNER
from calib.uncertainty.projection_uncertainty import camera_difference, projection_uncertainty

Array = NDArray[np.float64]

_POINTS = 121
_TANGENTIAL = frozenset({"p1", "p2"})
_STEP_SIGMAS = 1e-3  # Of a numerical derivative
_USED, _LEFT_OUT, _REFUSED = "used", "accepted, not used", "no recording accepted"
_COLOURS = {_USED: POSE_COLOURS[0], _LEFT_OUT: POSE_COLOURS[4], _REFUSED: "#a32020"}
_FRAME_SHARE = 0.11
"""Width of a frame in the plot, as a share of its width."""
_MOST_NUMBERS, _MOST_FRAMES = 40, 150  # More overlap in a picture of this size
_EDGE_POINTS = 9  # A distorted side of the sensor looks curved, not broken


def distortion_curve(
    camera: CameraModel,
    covariance: Array,
    k: float,
    outermost_deg: float | None,
    words: TargetWords = STARS,
) -> str:
    """Draw the lens's radial displacement against the field angle, with its expanded uncertainty.

    ``covariance`` is (K, K) in the order of `CameraModel.parameter_names`; ``outermost_deg`` that of a star, or None.
    """
    edges = field_angles_deg(camera)
    angles = np.linspace(0.0, max(edges.values()), _POINTS)
    shown, sigma = displacement(camera, covariance, angles)
    # The last bits differ between processes; the plot does not need them.
    shown, expanded = np.round(shown, 6), np.round(k * sigma, 6)
    lower, upper = shown - expanded, shown + expanded
    ideal = (
        "f \N{GREEK SMALL LETTER THETA}"
        if is_fisheye(camera.distortion)
        else "f tan \N{GREEK SMALL LETTER THETA}"
    )
    around = Words(
        (f"Radial displacement; band: U, k = {k:.3g}",),
        "field angle, degrees",
        f"displacement from {ideal}, px",
    )
    last = float(angles[-1])
    about = f"At {last:.3g} degrees the displacement is {shown[-1]:.3g} px, with U = {expanded[-1]:.2g} px."
    picture = Picture(
        *PANEL, "distortion", "Distortion curve: radial displacement against the field angle", about
    )
    low, high = min(0.0, float(lower.min())), max(0.0, float(upper.max()))
    room = max(high - low, 1e-6)
    # Above the curve, the names of the edges have a row of their own.
    axes = axes_in(picture, Scale(0.0, 1.02 * last), Scale(low - 0.05 * room, high + 0.22 * room), around)
    axes.level(0.0, MUTED, 0.7)
    band = np.vstack([np.column_stack([angles, upper]), np.column_stack([angles, lower])[::-1]])
    axes.shapes([band], POSE_COLOURS[0], 0.2)
    axes.line(np.column_stack([angles, shown]), POSE_COLOURS[0], 1.5)
    marks = [(angle, name, MUTED, INK) for name, angle in edges.items()]
    if outermost_deg is not None:
        marks.append((outermost_deg, f"outermost {words.point}", POSE_COLOURS[1], POSE_COLOURS[1]))
    _mark_angles(axes, marks)
    return picture.svg()


def displacement(camera: CameraModel, covariance: Array, angles_deg: Array) -> tuple[Array, Array]:
    """Return the lens's radial displacement, (N,) px, and its standard uncertainty, without tangential terms.

    JCGM 100:2008, 5.2, by numerical derivatives; ``covariance`` is (K, K) in the order of
    `CameraModel.parameter_names`.
    """
    names = list(camera.parameter_names)
    values = camera.to_dict()
    at = [names.index(name) for name in names if name not in {"cx", "cy"} | _TANGENTIAL]
    steps = _STEP_SIGMAS * np.sqrt(np.diag(covariance))
    columns = []
    for i in at:
        if not steps[i] > 0:
            columns.append(np.zeros(len(angles_deg)))
            continue
        ends = [_radial({**values, names[i]: values[names[i]] + s * steps[i]}, angles_deg) for s in (1, -1)]
        columns.append((ends[0] - ends[1]) / (2 * steps[i]))
    jacobian = np.stack(columns, axis=1)
    variance = np.einsum("ni,ij,nj->n", jacobian, covariance[np.ix_(at, at)], jacobian)
    return _radial(values, angles_deg), np.sqrt(np.maximum(variance, 0.0))


def field_angles_deg(camera: CameraModel) -> dict[str, float]:
    """Return the field angles, degrees, of the middles of a side and an upper edge, and of the farthest corner."""
    width, height = camera.image_size
    places = {
        "top, bottom": [(camera.cx, 0.0), (camera.cx, height - 1.0)],
        "sides": [(0.0, camera.cy), (width - 1.0, camera.cy)],
        "corner": [(x, y) for x in (0.0, width - 1.0) for y in (0.0, height - 1.0)],
    }
    by_place = {name: angles_of(camera, np.array(points)) for name, points in places.items()}
    return {name: float(np.nanmax(a)) for name, a in by_place.items() if np.isfinite(a).any()}


def angles_of(camera: CameraModel, points: Array) -> Array:
    """Return the angle, degrees, between axis and ray of (N, 2) image points, px; NaN without a ray."""
    rays = camera.rays(points)
    return np.degrees(np.arctan2(np.linalg.norm(rays[:, :2], axis=1), rays[:, 2]))


def _radial(values: Mapping[str, float], angles_deg: Array) -> Array:
    """Return the image radius less that of the ideal lens, px, for the mean focal length."""
    angle = np.radians(angles_deg)
    lens = {n: v for n, v in values.items() if n not in {"fx", "fy", "cx", "cy"} | _TANGENTIAL}
    focal = (values["fx"] + values["fy"]) / 2
    camera = CameraModel(focal, focal, 0.0, 0.0, (1, 1), lens)
    rays = np.column_stack([np.sin(angle), np.zeros(len(angle)), np.cos(angle)])
    ideal = angle if is_fisheye(lens) else np.tan(angle)
    return np.asarray(camera.project(rays)[:, 0] - focal * ideal)


def _mark_angles(axes: Axes, marks: Sequence[tuple[float, str, str, str]]) -> None:
    """Mark field angles, each with its name and its colours; the names stand in rows so that none collide."""
    reached: list[float] = []
    for angle, name, line, ink in sorted(marks):
        axes.upright(angle, line, 0.8, "3 2" if line == MUTED else "1 1.6")
        right = float(axes.at([(angle, axes.y.high)])[0, 0]) - 3.0
        left = right - text_width(name, 8.0)
        row = next((n for n, end in enumerate(reached) if end + 5.0 < left), len(reached))
        reached[row:] = [right, *reached[row + 1 :]]
        axes.text((angle, axes.y.high), name, by=(-3.0, 8.0 + 9.0 * row), colour=ink, anchor="end")


def outermost_deg(camera: CameraModel, points: Sequence[Array]) -> float | None:
    """Return the field angle of the outermost star, degrees; None without a star that has a ray."""
    angles = [angles_of(camera, some) for some in points if len(some)]
    finite = [float(np.nanmax(some)) for some in angles if np.isfinite(some).any()]
    return max(finite, default=None)


def change_maps(then: CameraData, now: CameraData) -> tuple[Array, Array, Array] | None:
    """Return how far two calibrations project a direction apart, and its expanded uncertainty; their ratio is E_n.

    E_n: ISO 13528, independent uncertainties. (h, w, 2) points, (h, w) lengths and U, px; None without a covariance.
    """
    of_both = []
    for calibration in (then, now):
        covariance = camera_covariance(calibration)
        if covariance is None:
            return None
        camera = camera_of(calibration["camera"], calibration["image_size"])
        sigma = projection_uncertainty(camera, covariance).sigma_px
        of_both.append((camera, coverage_factor(calibration, WORST_CORNER) * sigma))
    difference = camera_difference(of_both[1][0], of_both[0][0])
    expanded = np.hypot(of_both[0][1], of_both[1][1])
    return difference.grid_px, np.linalg.norm(difference.offset_px, axis=2), expanded


@dataclass(frozen=True)
class _Place:
    """A pose of the plot: its number, its pan, tilt and roll in degrees, and whether the calibration used it."""

    number: int
    pan_deg: float
    tilt_deg: float
    roll_deg: float
    use: str


def pose_directions(results: Results) -> str:
    """Draw each pose's pan and tilt as a frame turned by the camera's roll; empty if no pose turns."""
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
    """Draw the outline of the image of each pose on the target; empty if no pose has a rotation."""
    views = [view for view in calibration["views"] if "rotation" in view and "centre_mm" in view]
    if not views:
        return ""
    camera = camera_of(calibration["camera"], calibration["image_size"])
    shown = views[:: -(-len(views) // _MOST_FRAMES)]
    frames = [outline_on_target(camera, calibration["image_size"], view) for view in shown]
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


def outline_on_target(camera: CameraModel, image_size: Sequence[int], view: ViewData) -> Array:
    """Return the outline of the image of a pose on the target, mm, in order; points beyond it are left out."""
    return _on_target(
        camera.rays(_outline(image_size)), np.array(view["rotation"]), np.array(view["centre_mm"])
    )


def _on_target(rays: Array, rotation: Array, centre: Array) -> Array:
    """Return where rays of an image meet the target, mm; rays that do not meet it are left out."""
    directions = rays @ rotation
    ahead = np.isfinite(directions).all(axis=1) & (directions[:, 2] > 1e-6)
    met = centre[:2] - directions[ahead, :2] * (centre[2] / directions[ahead, 2:])
    return np.asarray(np.round(met, 4))


def _places(results: Results) -> list[_Place]:
    """Return the poses that have angles."""
    rotations = {v["name"]: v["rotation"] for v in results["calibration"]["views"] if "rotation" in v}
    places = []
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
        places.append(
            _Place(
                int(pose["index"]), float(angles.get("pan", 0.0)), float(angles.get("tilt", 0.0)), roll, how
            )
        )
    return places


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
    finite = list(values)
    return f"{min(finite):.3g} to {max(finite):.3g}"


def _outline(image_size: Sequence[int]) -> Array:
    """Return points along the edge of an image, in order."""
    width, height = image_size
    along = np.linspace(0.0, 1.0, _EDGE_POINTS)[:-1]
    zero, ones = np.zeros_like(along), np.ones_like(along)
    sides = ((along, zero), (ones, along), (1 - along, ones), (zero, 1 - along))
    return np.concatenate([np.column_stack([x * (width - 1), y * (height - 1)]) for x, y in sides])
