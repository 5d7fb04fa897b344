"""The quantities that a result states, as linear functions of the unknowns: none of two that views show together.

Views show the term of r^8 (`calib.model.lens.R8`) and k1 to k3 together. Programs have no such term, so a result states
the k1 to k3 that project as the whole series does over the sensor: to 1/32 of what the term moves the corner.
They show the radius and a scale of the common field together, too. The stated one is the length that the camera sees.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib.arrays import Array
from calib.joint.effects.collimator import CENTRE, COMMON_PLACES, FIELD
from calib.joint.layout import Layout
from calib.joint.posterior import Posterior
from calib.model.camera import CameraModel
from calib.model.lens import R8

#: What k1 to k3 take up of r^8 if the corner is at 1, and the power of the corner's tangent with which that grows.
_NEAREST = {"k1": (1.0 / 32.0, 6), "k2": (-18.0 / 32.0, 4), "k3": (48.0 / 32.0, 2)}


@dataclass(frozen=True)
class Reported:
    """Quantities of a result as linear functions of the shared unknowns."""

    names: tuple[str, ...]
    rows: Array  # (K, S)
    follows: Array  # (K,) how each follows the term of r^8 that it takes up

    def factors(self, posterior: Posterior, sigmas: Array) -> list[float]:
        """Return the coverage factors; sigmas: (K,). U of k1 to k3 also covers the coefficients of the whole series."""
        layout = posterior.optimum.marginal.problem.bench.layout
        units = np.eye(len(layout.names))[layout.places(self.names)]
        series = float(posterior.mean[layout.index[R8]]) if R8 in layout.index else 0.0
        functions = np.where(self.follows[:, None] == 0.0, self.rows, units)
        halves = np.array([posterior.expanded(row) for row in functions]) + np.abs(self.follows * series)
        return [float(factor) for factor in halves / sigmas]


def reported(posterior: Posterior, further: tuple[str, ...]) -> Reported:
    """Return the parameters of the camera that a result states, and ``further`` unknowns."""
    bench = posterior.optimum.marginal.problem.bench
    layout, camera = bench.layout, bench.camera(posterior.mean)
    names = (*(name for name in layout.pose.camera if name != R8), *further)
    shares = _taken_up(camera) if R8 in layout.index else {}
    follows = np.array([shares.get(name, 0.0) for name in names])
    rows = as_seen(layout, posterior.mean)[layout.places(names)]
    if shares:
        rows[:, layout.index[R8]] = follows
    return Reported(names, rows, follows)


def as_seen(layout: Layout, mean: Array) -> Array:
    """Return (S, S) the shared unknowns as functions of themselves, with the common field's scale in the radius.

    A field that makes distances on the target longer by a share is a radius that is shorter by it. That counts at the
    foot of the (S,) ``mean``, where the axis is: over the disc, fields that grow with a power have a scale, too.
    """
    basis, rows = layout.basis, np.eye(len(layout.names))
    share = basis.scale_at(mean[layout.places(CENTRE[:2])])[COMMON_PLACES]
    field, r = layout.places([f"{FIELD}{k}" for k in COMMON_PLACES]), layout.index["r"]
    rows[r, field] = -basis.reference[2] * share
    rows[np.ix_(field, field)] -= np.outer(basis.shape(np.asarray)[COMMON_PLACES], share)
    return rows


def without_r8(camera: CameraModel) -> CameraModel:
    """Return the camera whose k1 to k3 take up the term of r^8; one without this term as it is."""
    if R8 not in camera.distortion:
        return camera
    lens = {name: value for name, value in camera.distortion.items() if name != R8}
    for name, share in _taken_up(camera).items():
        lens[name] += share * camera.distortion[R8]
    return replace(camera, distortion=lens)


def _taken_up(camera: CameraModel) -> dict[str, float]:
    """Return what k1 to k3 become by a unit of r^8: at most 1/32 of it is left anywhere (Lanczos, 1938).

    Over the unit interval, s^3 less 1/32 of Chebyshev's third polynomial is its nearest one of degree 2.
    """
    width, height = camera.image_size
    rays = camera.rays(np.array([(x, y) for x in (0.0, width - 1.0) for y in (0.0, height - 1.0)]))
    seen = np.hypot(rays[:, 0], rays[:, 1]) / rays[:, 2]
    nominal = 0.5 * float(np.hypot(width, height)) / camera.fx
    corner = float(np.nanmax([*seen, nominal]))  # a corner without a ray lies beyond a fold of the distortion
    return {name: share * corner**power for name, (share, power) in _NEAREST.items()}
