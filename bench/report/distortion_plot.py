"""The distortion of a lens, drawn against the angle of the field."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from bench.report.svg_plot import INK, MUTED, PANEL, POSE_COLOURS, Axes, Picture, Words, axes_in
from bench.report.svg_scale import Scale, text_width
from bench.wording.numbers import number
from bench.wording.target_words import STARS, TargetWords
from calib.arrays import Array
from calib.model.camera import CameraModel
from calib.model.lens import is_fisheye

_POINTS = 121  # Of a curve: closer than it is drawn
_TANGENTIAL = frozenset({"p1", "p2"})
_STEP_SIGMAS = 1e-3  # Of a numerical derivative


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
    ideal = f"f {'' if is_fisheye(camera.distortion) else 'tan '}\N{GREEK SMALL LETTER THETA}"
    title = f"Radial displacement; band: U, k = {k:.3g}"
    around = Words((title,), "field angle, degrees", f"displacement from {ideal}, px")
    last = float(angles[-1])
    about = f"At {last:.3g} degrees the displacement is {shown[-1]:.3g} px, with U = {number(expanded[-1], 2)} px."
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
    """Return the image radius less that of the ideal lens, px, for the mean focal length f.

    The ideal radius is f tan(angle); that of a fisheye is f times the angle.
    """
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
