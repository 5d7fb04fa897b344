"""Two cameras on one rig: their relative rotation, from poses that both saw through one collimator.

Behind a collimator every camera is at infinity from the target. The translation between two cameras is therefore not
observable, and none is given.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import special

from calib.calibration import Calibration
from calib.errors import DegenerateViews
from calib.model.rotation import exp_map, log_map, nearest_rotation
from calib.uncertainty.projection_uncertainty import ARCSEC

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RelativeRotation:
    """The rotation from one camera of a rig to another."""

    rotation: Array  # (3, 3) float64 rotation, second camera <- first camera
    covariance: Array  # (3, 3) float64 covariance of the rotation vector on the second camera's side, rad^2
    views: tuple[str, ...]
    # (n, 3) float64 relative rotation of each pose minus the common one, about the second camera's axes, arc
    # seconds.
    residuals_arcsec: Array
    # chi_square, degrees_of_freedom: Chi-square of the residuals and its degrees of freedom; large if the rig
    # flexed.
    chi_square: float
    degrees_of_freedom: int

    @property
    def sigma_arcsec(self) -> Array:
        """(3,) float64 1-sigma about the second camera's axes, arc seconds."""
        return np.asarray(ARCSEC * np.sqrt(np.diag(self.covariance)))

    @property
    def vector_deg(self) -> Array:
        """(3,) float64 rotation vector, degrees."""
        return np.asarray(np.rad2deg(log_map(self.rotation[None])[0]))

    @property
    def rigid(self) -> bool:
        """Whether the chi-square is below its 99.9 % quantile."""
        return bool(self.chi_square <= special.chdtri(max(self.degrees_of_freedom, 1), 0.001))

    def to_dict(self) -> dict[str, Any]:
        """Return the result as plain numbers, lists and names, ready for JSON; the translation is None.

        Returns: Key ``disagreement_arcsec`` holds the residuals.
        """
        return {
            "rotation": self.rotation.tolist(),
            "vector_deg": self.vector_deg.tolist(),
            "covariance_rad2": self.covariance.tolist(),
            "sigma_arcsec": self.sigma_arcsec.tolist(),
            "translation": None,
            "translation_note": "not observable: behind a collimator the target stands at infinity",
            "views": list(self.views),
            "disagreement_arcsec": self.residuals_arcsec.tolist(),
            "chi_square": self.chi_square,
            "degrees_of_freedom": self.degrees_of_freedom,
            "rigid": self.rigid,
        }


def relative_rotation(first: Calibration, second: Calibration) -> RelativeRotation:
    """Estimate the rotation second <- first from all poses that both cameras saw, by generalised least squares.

    Generalised least squares: Aitken (1936), for the rotation vectors of R_second R_first^T.

    Raises DegenerateViews: If the calibrations have no view with the same name.
    """
    names = [view.name for view in first.views]
    second_names = [view.name for view in second.views]
    common = tuple(name for name in names if name in second_names)
    if not common:
        raise DegenerateViews(
            "The two cameras share no pose.", remedy="Give the two views of one pose the same name."
        )
    a, b = [names.index(name) for name in common], [second_names.index(name) for name in common]
    pairs = second.rotations[b] @ np.swapaxes(first.rotations[a], 1, 2)
    covariance = _joint(second.rotation_covariance, b) + _rotated(_joint(first.rotation_covariance, a), pairs)
    information = np.linalg.pinv(covariance, rcond=1e-12, hermitian=True)
    jacobian = np.tile(np.eye(3), (len(common), 1))
    covariance_of_mean = np.asarray(np.linalg.inv(jacobian.T @ information @ jacobian), np.float64)
    rotation = nearest_rotation(pairs.mean(axis=0))
    for _ in range(20):
        off = log_map(pairs @ rotation.T).reshape(-1)
        step = covariance_of_mean @ jacobian.T @ information @ off
        rotation = exp_map(step) @ rotation
        if np.abs(step).max() < 1e-14:
            break
    off = log_map(pairs @ rotation.T).reshape(-1)
    return RelativeRotation(
        rotation,
        covariance_of_mean,
        common,
        ARCSEC * off.reshape(-1, 3),
        float(off @ information @ off),
        3 * len(common) - 3,
    )


def _joint(covariance: Array, views: list[int]) -> Array:
    """Return the rows and columns of some views of a (3 n, 3 n) covariance."""
    rows = np.concatenate([np.arange(3 * i, 3 * i + 3) for i in views])
    return covariance[np.ix_(rows, rows)]


def _rotated(covariance: Array, turns: Array) -> Array:
    """Transform a (3 n, 3 n) covariance from the first camera's side to the second one's.

    Linear propagation, T C T^T (JCGM 100:2008, section 5.2).
    """
    carrier = np.zeros_like(covariance)
    for i, turn in enumerate(turns):
        carrier[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = turn
    return np.asarray(carrier @ covariance @ carrier.T)
