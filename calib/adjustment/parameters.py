"""The parameters of the adjustment: a camera, a collimator, and the rotation and centre of each view.

Views between which the camera hardly turned belong to one pose: they share the errors of collimator and pixel grid.
Views that do not constrain a camera are recognised by the computed uncertainties, and explained by their geometry.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.arrays import Array, Bools
from calib.errors import DegenerateViews
from calib.model.camera import CameraModel
from calib.model.collimator import Collimator
from calib.model.gimbal import Gimbal
from calib.model.rotation import exp_map, log_map
from calib.view import View

#: Views that are turned by less against each other belong to one pose: 12 px at a focal length of 3345 px.
SAME_POSE_DEG = 0.2

#: Largest acceptable 1-sigma of a focal length, as a share of it: a maker states it as well.
MAX_FOCAL_SIGMA = 0.05
_NO_TURN_DEG = 0.5  # With smaller turns, noise alone would determine the focal length
_PARALLEL_SINE = 0.05  # 3 degrees
_NARROW_DEG = 5.0  # Half angle: within it, perspective changes a distance by less than half a per cent


@dataclass(frozen=True)
class AdjustmentParameters:
    """A camera, a collimator, and the rotation and centre of each of n views."""

    camera: CameraModel
    collimator: Collimator
    rotations: Array  # (n, 3, 3) float64 rotations, camera <- target
    # (n, 3) float64 centre of each view minus the collimator's centre, mm; zero in the spherical model.
    offsets: Array
    gimbal: Gimbal | None = None  # The gimbal, if its readings are observations

    @property
    def centres(self) -> Array:
        """(n, 3) float64 centre of each view in the target frame, mm."""
        return self.collimator.centre + self.offsets

    def values(self, names: Sequence[str]) -> Array:
        """Return the (K,) values of shared parameters, each in the unit of its parameter."""
        known = {**self.camera.to_dict(), **self.collimator.to_dict()}
        return np.array([known[name] for name in names])

    def after_step(self, names: Sequence[str], shared: Array, local: Array) -> AdjustmentParameters:
        """Return the parameters after a step: (G,) increments of the shared ones, and local ones of each view.

        A rotation is updated by a small rotation about itself, R <- exp([t]x) R, as Triggs et al. (2000) recommend.
        ``local`` is (n, 3) rotation vectors, rad, on the camera's side; or (n, 6), with shifts of the centres, mm.
        """
        known = {**self.camera.to_dict(), **self.collimator.to_dict()}
        for name, step in zip(names, shared.tolist(), strict=True):
            known[name] += step
        camera = self.camera.with_values(np.array([known[name] for name in self.camera.parameter_names]))
        rotations = exp_map(local[:, :3]) @ self.rotations
        offsets = self.offsets + local[:, 3:] if local.shape[1] > 3 else self.offsets
        return AdjustmentParameters(camera, self.collimator.with_values(known), rotations, offsets)

    def subset(self, kept: Sequence[int]) -> AdjustmentParameters:
        """Return the parameters of some of the views."""
        index = list(kept)
        return replace(self, rotations=self.rotations[index], offsets=self.offsets[index])


def poses_of(rotations: Array, moved: Bools | None = None) -> tuple[int, ...]:
    """Return for each view the index of its pose, from (n, 3, 3) rotations, camera <- target.

    A view belongs to the first pose whose first view is turned by less than 0.2 degrees against it. Own rule. ``moved``
    may tell for (n, n) pairs of views that the camera was moved between them, although it is turned alike.
    """
    same = turned_alike(rotations)
    if moved is not None:
        same &= ~moved
    firsts: list[int] = []
    poses = []
    for i, near in enumerate(same):
        pose = next((k for k, first in enumerate(firsts) if near[first]), len(firsts))
        if pose == len(firsts):
            firsts.append(i)
        poses.append(pose)
    return tuple(poses)


def turned_alike(rotations: Array) -> Bools:
    """Tell for (n, n) pairs of rotations (n, 3, 3) whether they differ by less than 0.2 degrees."""
    flat = np.asarray(rotations).reshape(len(rotations), 9)
    return np.asarray(np.linalg.norm(flat[:, None] - flat[None], axis=2) < _chord(SAME_POSE_DEG))


def _chord(turned_deg: float) -> float:
    """Return the chord between rotations turned by an angle t: |R - S| = sqrt(8) sin(t / 2), in the Frobenius norm."""
    return float(np.sqrt(8.0) * np.sin(np.deg2rad(turned_deg) / 2.0))


def views_of_poses(rotations: Array) -> list[list[int]]:
    """Return the views of each pose, as `poses_of`."""
    poses = poses_of(rotations)
    return [[i for i, pose in enumerate(poses) if pose == k] for k in range(max(poses) + 1)]


def require_distinct_poses(parameters: AdjustmentParameters) -> None:
    """Refuse views that all show the same pose, within half a degree: only noise would determine the focal length."""
    difference = (parameters.rotations - parameters.rotations[0]).reshape(-1, 9)
    if np.linalg.norm(difference, axis=1).max() < _chord(_NO_TURN_DEG):
        raise DegenerateViews(
            f"All {len(parameters.rotations)} views show the same pose.",
            remedy="Turn the camera by some degrees between views.",
        )


def require_constrained(parameters: AdjustmentParameters, sigmas: Mapping[str, float]) -> None:
    """Refuse a focal length with a 1-sigma over 5 % (own limit)."""
    for name, value in (("fx", parameters.camera.fx), ("fy", parameters.camera.fy)):
        if not sigmas[name] <= MAX_FOCAL_SIGMA * value:
            share = 200.0 * sigmas[name] / value
            raise DegenerateViews(
                f"These views determine {name} only to ±{share:.0f} % (k = 2).",
                remedy="Add views turned about other axes, with the points elsewhere in the image.",
            )


def explain_weak_geometry(views: Sequence[View], parameters: AdjustmentParameters) -> str:
    """Explain in one sentence why views may constrain little; empty if the geometry looks sound.

    Own rules: a roll, if the parts of all rotation vectors across the axis are below 0.05 of the longest vector; one
    axis, if the second singular value of the vectors is.
    """
    # R_i R_1^T as vectors, from the first view to another (Diebel, 2006).
    turns = log_map(parameters.rotations[1:] @ parameters.rotations[0].T)
    lengths = np.linalg.norm(turns, axis=1)
    if len(views) > 1 and (np.linalg.norm(turns[:, :2], axis=1) < _PARALLEL_SINE * lengths.max()).all():
        return "The views differ only by a roll about the optical axis."
    if len(views) > 2 and np.linalg.svd(turns, compute_uv=False)[1] < _PARALLEL_SINE * lengths.max():
        return "All views are turned about one axis."
    beam = beam_half_angle_deg(parameters, views)
    if beam < _NARROW_DEG:
        return f"The points span only +-{beam:.1f} degrees: the beam is too narrow."
    return ""


def beam_half_angle_deg(parameters: AdjustmentParameters, views: Sequence[View]) -> float:
    """Return the largest angle, degrees, between the ray of a star and the mean ray of its view (own definition)."""
    widest = 0.0
    for view, centre in zip(views, parameters.centres, strict=True):
        x, y = (view.target_mm - centre[:2]).T
        rays = np.array([x, y, np.full(len(view), -centre[2])]) / np.sqrt(x * x + y * y + centre[2] ** 2)
        middle = rays.mean(axis=1) / np.linalg.norm(rays.mean(axis=1))
        widest = max(widest, float(np.rad2deg(np.arccos(np.clip((middle @ rays).min(), -1, 1)))))
    return widest
