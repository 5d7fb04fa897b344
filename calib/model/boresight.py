"""Boresight: how the camera is turned against the flange that carries it; and how errors of rotations follow."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.arrays import Array
from calib.model.rotation import log_map, skew


@dataclass(frozen=True)
class Boresight:
    """The rotation from the stage's flange to the camera, by the gimbal's readings.

    The flange's frame is that of the stage at the zero of its readings: x along the tilt axis, y along the pan axis, as
    far as it is square to tilt, and z along x times y, where the camera looks.
    """

    rotation: Array  # (3, 3) float64, camera <- flange
    covariance: Array  # (3, 3) float64 of its rotation vector about the camera's axes, rad^2
    expanded_deg: Array  # (3,) float64 expanded uncertainties about the camera's x, y and z
    # (3,) float64 unit vector in the flange's frame: the ray through the middle of the image.
    sight: Array
    # (2, 2) float64 covariance of the ray along the camera's x and y, rad^2.
    sight_covariance: Array
    sight_expanded_deg: Array  # (2,) float64 expanded uncertainties of the ray along the camera's x and y

    @property
    def vector_deg(self) -> Array:
        """(3,) float64 rotation vector, degrees."""
        return np.asarray(np.degrees(log_map(self.rotation[None])[0]))

    @property
    def right_down_deg(self) -> tuple[float, float]:
        """Angles of the ray from the flange's z towards its x and towards its y, degrees."""
        x, y, z = self.sight
        return float(np.degrees(np.arctan2(x, z))), float(np.degrees(np.arctan2(y, z)))

    def angle_to(self, normal: Array, sigma_rad: float) -> tuple[float, float]:
        """Return the angle of the ray to a (3,) direction of the flange's frame, and its expanded uncertainty, degrees.

        An angle near zero has no single gradient, so the larger uncertainty of the ray's two directions is taken.
        """
        unit = np.asarray(normal, np.float64) / np.linalg.norm(normal)
        angle = float(np.arctan2(np.linalg.norm(skew(self.sight[None])[0] @ unit), self.sight @ unit))
        own = float(np.linalg.eigvalsh(self.sight_covariance)[-1])
        sigmas = np.degrees(np.sqrt(np.diag(self.sight_covariance)))
        factor = float((self.sight_expanded_deg / sigmas).max())
        return float(np.degrees(angle)), float(np.degrees(factor * np.hypot(np.sqrt(own), sigma_rad)))

    def to_dict(self) -> dict[str, Any]:
        """Return the content as JSON holds it."""
        return {
            "camera_from_flange": self.rotation.tolist(),
            "vector_deg": self.vector_deg.tolist(),
            "expanded_deg": self.expanded_deg.tolist(),
            "covariance_rad2": self.covariance.tolist(),
            "sight": self.sight.tolist(),
            "right_down_deg": list(self.right_down_deg),
            "sight_expanded_deg": self.sight_expanded_deg.tolist(),
            "sight_covariance_rad2": self.sight_covariance.tolist(),
        }

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> Boresight:
        """Read what `to_dict` wrote."""
        names = ("camera_from_flange", "covariance_rad2", "expanded_deg", "sight", "sight_covariance_rad2")
        return cls(*(np.array(content[name], np.float64) for name in (*names, "sight_expanded_deg")))


@dataclass(frozen=True)
class RotationErrors:
    """A linear form at the posterior's mean: the error of each rotation vector, on the camera's side."""

    names: tuple[str, ...]  # The S shared unknowns
    means: Array  # (S,)
    covariance: Array  # (S, S)
    prior: Array  # (S, S) information of what was known before the views
    prior_pull: Array  # (S,) that information times (what was known - means)
    by_shared: Array  # (3 m, S) rad for a unit of each
    own: Array  # (3 m, 3 m) covariance of what each view adds, rad^2
