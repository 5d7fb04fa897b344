"""The distortion curve: the radial displacement of an image point against the field angle, with its uncertainty."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from bench.report.drawing import INK, MUTED, PANEL, POSE_COLOURS, STYLE, hide_frame, to_svg
from calib.model.camera import CameraModel
from calib.model.lens import is_fisheye

Array = NDArray[np.float64]

_POINTS = 121
_TANGENTIAL = frozenset({"p1", "p2"})
_STEP_SIGMAS = 1e-3


def distortion_curve(camera: CameraModel, covariance: Array, k: float, outermost_deg: float | None) -> str:
    """Draw the radial displacement by the lens against the field angle, with its expanded uncertainty.

    Parameters
    ----------
    camera
        The camera.
    covariance
        (K, K) covariance of its parameters, in the order of `CameraModel.parameter_names`.
    k
        Coverage factor.
    outermost_deg
        Field angle of the outermost star, degrees; None if it is not known.

    Returns
    -------
    str
        SVG.
    """
    edges = field_angles_deg(camera)
    angles = np.linspace(0.0, max(edges.values()), _POINTS)
    shown, sigma = displacement(camera, covariance, angles)
    # The last bits differ between processes; the plot does not need them.
    shown, expanded = np.round(shown, 6), np.round(k * sigma, 6)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=PANEL, layout="constrained")
        axes = figure.add_subplot()
        axes.axhline(0, color=MUTED, linewidth=0.7)
        axes.fill_between(
            angles, shown - expanded, shown + expanded, color=POSE_COLOURS[0], alpha=0.2, linewidth=0
        )
        axes.plot(angles, shown, color=POSE_COLOURS[0], linewidth=1.5)
        axes.set(xlim=(0, float(angles[-1]) * 1.02), xlabel="field angle, degrees")
        _marks(axes, edges)
        if outermost_deg is not None:
            axes.axvline(outermost_deg, color=POSE_COLOURS[1], linewidth=1.0, linestyle=":")
            axes.annotate(
                "outermost star", (outermost_deg, 0.03), (-3, 0), xycoords=("data", "axes fraction"),
                textcoords="offset points", ha="right", color=POSE_COLOURS[1], fontsize=8,
            )  # fmt: skip
        ideal = (
            "f \N{GREEK SMALL LETTER THETA}"
            if is_fisheye(camera.distortion)
            else "f tan \N{GREEK SMALL LETTER THETA}"
        )
        axes.set_ylabel(f"displacement from {ideal}, px")
        axes.set_title(f"Radial displacement; band: U, k = {k:.3g}")
        hide_frame(axes)
        return to_svg(figure, "distortion", "Distortion curve: radial displacement against the field angle")


def displacement(camera: CameraModel, covariance: Array, angles_deg: Array) -> tuple[Array, Array]:
    """Return the radial displacement by the lens and its standard uncertainty.

    The law of propagation is that of JCGM 100:2008, section 5.2, with numerical derivatives.

    Parameters
    ----------
    camera
        The camera.
    covariance
        (K, K) covariance of its parameters, in the order of `CameraModel.parameter_names`.
    angles_deg
        (N,) float64, field angles, degrees.

    Returns
    -------
    tuple of Array
        (N,) displacement away from the axis, and (N,) its standard uncertainty, px. Tangential terms do not count.
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
    """Return the field angle of the middle of a side edge, of the upper or lower edge, and of the farthest corner.

    Parameters
    ----------
    camera
        The camera.

    Returns
    -------
    dict
        Angle by name, degrees; points without a ray are left out.
    """
    width, height = camera.image_size
    places = {
        "top, bottom": [(camera.cx, 0.0), (camera.cx, height - 1.0)],
        "sides": [(0.0, camera.cy), (width - 1.0, camera.cy)],
        "corner": [(x, y) for x in (0.0, width - 1.0) for y in (0.0, height - 1.0)],
    }
    found = {name: angles_of(camera, np.array(points)) for name, points in places.items()}
    return {name: float(np.nanmax(a)) for name, a in found.items() if np.isfinite(a).any()}


def angles_of(camera: CameraModel, points: Array) -> Array:
    """Return the angle between the optical axis and the ray of each image point.

    Parameters
    ----------
    camera
        The camera.
    points
        (N, 2) float64, px.

    Returns
    -------
    Array
        (N,) float64, degrees; NaN where an image point has no ray.
    """
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


def _marks(axes: Axes, edges: Mapping[str, float]) -> None:
    """Mark the field angles of the sensor's edges at the top of the plot."""
    for name, angle in edges.items():
        axes.axvline(angle, color=MUTED, linewidth=0.6, linestyle="--")
        axes.annotate(
            name, (angle, 1.0), (-3, -2), xycoords=("data", "axes fraction"), textcoords="offset points",
            ha="right", va="top", color=INK, fontsize=8,
        )  # fmt: skip


def outermost_deg(camera: CameraModel, points: Sequence[Array]) -> float | None:
    """Return the field angle of the outermost star.

    Parameters
    ----------
    camera
        The camera.
    points
        For each pose (N, 2) float64, px: its stars.

    Returns
    -------
    float or None
        Degrees; None without a star that has a ray.
    """
    angles = [angles_of(camera, some) for some in points if len(some)]
    finite = [float(np.nanmax(some)) for some in angles if np.isfinite(some).any()]
    return max(finite, default=None)
