"""Rays through a collimator of several lenses: spherical surfaces whose centres lie beside the axis, with bumps on the first one.

Light is followed backwards, from the camera's pupil towards the print, in the direction of +Z. The print is near Z = 0.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Surface:
    """A sphere between two media."""

    vertex_mm: float
    radius_mm: float  # positive if its centre lies towards the print
    aside_mm: Array  # (2,) of its centre from the axis: a tilt and a decentre of a sphere are one thing
    before: float  # refractive indices
    behind: float


@dataclass(frozen=True)
class Bumps:
    """Errors of the figure of a surface: a sum of Gaussians."""

    middles_mm: Array  # (M, 2)
    widths_mm: Array  # (M,)
    heights_mm: Array  # (M,)

    def slopes(self, at_mm: Array) -> Array:
        """Slopes (N, 2) of the surface at points (N, 2)."""
        from_middles_mm = at_mm[:, None] - self.middles_mm
        heights = self.heights_mm * np.exp(-0.5 * (from_middles_mm**2).sum(axis=2) / self.widths_mm**2)
        return -np.einsum("nm,nmi->ni", heights / self.widths_mm**2, from_middles_mm)


@dataclass(frozen=True)
class LensSystem:
    """The collimator's lenses before the print."""

    surfaces: tuple[Surface, ...]
    bumps: Bumps
    bow: Array  # (2,) 1 / mm: the print lies at Z = bow_x X^2 + bow_y Y^2

    def print_mm(self, from_mm: Array, tangents: Array) -> Array:
        """Where rays (N, 2) from points (N, 3) meet the print (N, 2) mm."""
        directions = np.column_stack([tangents, np.ones(len(tangents))])
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        at = from_mm
        for i, surface in enumerate(self.surfaces):
            at, directions = _refracted(at, directions, surface, None if i else self.bumps)
        slopes = directions[:, :2] / directions[:, 2:]
        flat = at[:, :2] - at[:, 2:] * slopes
        return np.asarray(flat + (flat**2 @ self.bow)[:, None] * slopes)

    def tangents(self, from_mm: Array, print_mm: Array, scale_mm: float) -> Array:
        """Tangents (N, 2) of the rays from points (N, 3) that meet the print at points (N, 2).

        scale_mm: About the focal length; each step is that of a collimator without errors.
        """
        tangents = print_mm / scale_mm
        for _ in range(60):
            off = print_mm - self.print_mm(from_mm, tangents)
            tangents = tangents + off / scale_mm
            if np.abs(off).max() < 1e-9:
                return tangents
        raise ArithmeticError("The rays do not converge.")


def _refracted(at: Array, directions: Array, surface: Surface, bumps: Bumps | None) -> tuple[Array, Array]:
    """Points (N, 3) where rays meet a surface, and their directions behind it (Snell's law in vector form)."""
    radius = surface.radius_mm
    centre = np.array([*surface.aside_mm, surface.vertex_mm + radius])
    from_centre = at - centre
    along = (from_centre * directions).sum(axis=1)
    beyond = along**2 - (from_centre**2).sum(axis=1) + radius**2
    points = at + (-along - np.sign(radius) * np.sqrt(beyond))[:, None] * directions
    normals = (points - centre) / radius
    if bumps is not None:
        normals[:, :2] += bumps.slopes(points[:, :2])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    ratio = surface.before / surface.behind
    cosine = -(normals * directions).sum(axis=1)
    inside = np.sqrt(1 - ratio**2 * (1 - cosine**2))
    return points, ratio * directions + (ratio * cosine - inside)[:, None] * normals


def focal_and_back_mm(surfaces: tuple[Surface, ...]) -> tuple[float, float]:
    """Focal length, and distance of the focus behind the last vertex, mm, by paraxial matrices."""
    height, slope = 1.0, 0.0  # slope times the refractive index
    for i, surface in enumerate(surfaces):
        if i:
            height += slope / surface.before * (surface.vertex_mm - surfaces[i - 1].vertex_mm)
        slope -= height * (surface.behind - surface.before) / surface.radius_mm
    return -1.0 / slope, -height / slope
