"""Two cameras on one rig: how the second is turned and placed against the first.

Through a collimator both see a target at infinity, which gives the rotation. A board at finite distance, seen by both
at once, gives rotation and translation (`calib.studies.rig_boards`). What the collimator says about rotation and
intrinsics, or what files say about the intrinsics, is the prior of the adjustment of the boards; so nothing is held,
and nothing counts twice.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import linalg, special

from calib.arrays import Array, Ints
from calib.calibration import Calibration
from calib.errors import DegenerateViews, InputMismatch
from calib.model.camera import CameraModel
from calib.model.collimator import CENTRE
from calib.model.result_parts import RotationErrors
from calib.model.rotation import ARCSEC, exp_map, log_map, nearest_rotation

#: A camera from other views, and the covariance of its values; None holds them.
StatedCamera = tuple[CameraModel, Array | None]

#: Standard uncertainty of a value whose file states none, as a share of it.
_EXACT = 1e-7
_RIGID = 0.001  # Probability that a rigid rig is called loose
#: Share of the comparisons with a right rig that are outside of the uncertainty.
_WITHIN = 0.05


@dataclass(frozen=True)
class RigDifference:
    """A rig compared with a stated one."""

    arcsec: float
    mm: float | None  # None if one of them has no translation
    normalised: float  # Over the uncertainty of all components together, 95 %

    @property
    def right(self) -> bool:
        """Whether the stated rig is right within the uncertainty."""
        return self.normalised <= 1.0


@dataclass(frozen=True)
class Rig:
    """Two cameras and how they stand: X_second = rotation X_first + translation."""

    first: CameraModel
    second: CameraModel
    rotation: Array  # (3, 3) second <- first
    translation_mm: Array | None  # (3,); None if no board at finite distance was seen
    # Of the values of first, of second, of the rotation vector on the second camera's side, rad, and of the
    # translation, mm.
    covariance: Array
    views: tuple[str, ...] = ()  # Poses behind the collimator
    # (n, 3) float64 relative rotation of each pose minus the common one, about the second camera's axes, arc
    # seconds.
    residuals_arcsec: Array | None = None
    boards: tuple[str, ...] = ()
    boards_rms_px: Array | None = None  # (m, 2) of each board in the two images
    half_turned: tuple[str, ...] = ()  # Symmetric boards that the second camera numbered from the other end
    chi_square: float = 0.0  # Large if the rig flexed, or the cameras did not record at the same time
    degrees_of_freedom: int = 0

    @property
    def pose_covariance(self) -> Array:
        """(6, 6) covariance of rotation vector, rad, and translation, mm; (3, 3) without translation."""
        k = len(self.first.values) + len(self.second.values)
        return self.covariance[k:, k:]

    @property
    def sigma_arcsec(self) -> Array:
        """(3,) float64 1-sigma about the second camera's axes, arc seconds."""
        return np.asarray(ARCSEC * np.sqrt(np.diag(self.pose_covariance)[:3]))

    @property
    def sigma_mm(self) -> Array:
        """(3,) float64 1-sigma of the translation; empty without translation."""
        return np.asarray(np.sqrt(np.diag(self.pose_covariance)[3:]))

    @property
    def vector_deg(self) -> Array:
        """(3,) float64 rotation vector, degrees."""
        return np.asarray(np.rad2deg(log_map(self.rotation[None])[0]))

    @property
    def rigid(self) -> bool:
        """Whether the chi-square is below its 99.9 % quantile."""
        return bool(self.chi_square <= special.chdtri(max(self.degrees_of_freedom, 1), _RIGID))

    def compared(
        self, rotation: Array, translation_mm: Array | None, covariance: Array | None
    ) -> RigDifference:
        """Compare with a stated rig, in what both hold: rotation second <- first, covariance as `pose_covariance`.

        The Mahalanobis distance (1936) of all components, over the square root of the 95 % quantile of chi-square.
        """
        turn = log_map((self.rotation @ rotation.T)[None])[0]
        known = self.pose_covariance
        size = 3 if self.translation_mm is None or translation_mm is None else 6
        total = known[:size, :size] + (0.0 if covariance is None else covariance[:size, :size])
        shift = None if size == 3 else np.asarray(self.translation_mm) - np.asarray(translation_mm)
        off = turn if shift is None else np.concatenate([turn, shift])
        square = float(off @ np.linalg.solve(total, off))
        return RigDifference(
            ARCSEC * float(np.linalg.norm(turn)),
            None if shift is None else float(np.linalg.norm(shift)),
            float(np.sqrt(square / special.chdtri(size, _WITHIN))),
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the result as plain numbers, lists and names, ready for JSON."""
        moved = self.translation_mm is not None
        why = "not observable: behind a collimator the target stands at infinity"
        return {
            "rotation": self.rotation.tolist(),
            "vector_deg": self.vector_deg.tolist(),
            "covariance_rad2": self.pose_covariance[:3, :3].tolist(),
            "sigma_arcsec": self.sigma_arcsec.tolist(),
            "translation": None if self.translation_mm is None else self.translation_mm.tolist(),
            **({"sigma_mm": self.sigma_mm.tolist()} if moved else {"translation_note": why}),
            "pose_covariance": self.pose_covariance.tolist(),
            "cameras": [self.first.to_dict(), self.second.to_dict()],
            "views": list(self.views),
            "disagreement_arcsec": [] if self.residuals_arcsec is None else self.residuals_arcsec.tolist(),
            "boards": list(self.boards),
            "boards_rms_px": [] if self.boards_rms_px is None else self.boards_rms_px.tolist(),
            "half_turned": list(self.half_turned),
            "chi_square": self.chi_square,
            "degrees_of_freedom": self.degrees_of_freedom,
            "rigid": self.rigid,
        }


def common_names(first: Sequence[str], second: Sequence[str]) -> tuple[str, ...]:
    """Return the names that both have, or raise `DegenerateViews`."""
    common = tuple(name for name in first if name in second)
    if not common:
        raise DegenerateViews(
            "The two cameras share no pose.", remedy="Give the two views of one pose the same name."
        )
    return common


def through_collimator(
    first: Calibration, second: Calibration, stated: Sequence[StatedCamera | None] = (None, None)
) -> Rig:
    """Estimate the rotation from all poses that both cameras saw, by generalised least squares.

    Aitken (1936), for the rotation vectors of R_second R_first^T. Both looked into one collimator: its centre and
    radius are the same unknowns, and what was known of them before counts once. ``stated`` is what other views say of
    each camera.
    Raises DegenerateViews: If the calibrations have no view with the same name.
    Raises InputMismatch: If a stated camera contradicts the views.
    """
    names = [[view.name for view in camera.views] for camera in (first, second)]
    common = common_names(*names)
    a, b = ([own.index(name) for name in common] for own in names)
    pairs = second.rotations[b] @ np.swapaxes(first.rotations[a], 1, 2)
    start = nearest_rotation(pairs.mean(axis=0))
    errors_a, other = _errors(first), _errors(second)
    information, pull, places, shift = _one_collimator(errors_a, other)
    of_first, of_second = np.arange(len(first.camera.values)), places[: len(second.camera.values)]
    for calibration, camera, here in zip((first, second), stated, (of_first, of_second), strict=True):
        if camera is not None:
            known, toward = _known(calibration, *camera)
            information[np.ix_(here, here)] += known
            pull[here] += toward
    size, n = len(information), 3 * len(common)
    rows_a, rows_b = (_rows(own) for own in (a, b))
    turns = linalg.block_diag(*pairs)
    by = np.zeros((n, size))
    by[:, places] += other.by_shared[rows_b]
    by[:, : len(errors_a.names)] -= turns @ errors_a.by_shared[rows_a]
    own = other.own[np.ix_(rows_b, rows_b)] + turns @ errors_a.own[np.ix_(rows_a, rows_a)] @ turns.T
    weight = np.linalg.pinv(own, rcond=1e-12, hermitian=True)
    # The common rotation follows the error of each pose: omega - by u = off + noise.
    off = log_map(pairs @ start.T).reshape(-1) + other.by_shared[rows_b] @ shift
    rows = np.hstack([-by, np.tile(np.eye(3), (len(common), 1))])
    whole = linalg.block_diag(information, np.zeros((3, 3))) + rows.T @ weight @ rows
    covariance = np.linalg.inv(whole)
    step = covariance @ (np.concatenate([pull, np.zeros(3)]) + rows.T @ weight @ off)
    # Each pose by what the cameras know alone.
    expected = np.linalg.pinv(own + by @ np.linalg.inv(information) @ by.T, rcond=1e-12, hermitian=True)
    scatter = off + by @ np.linalg.solve(information, pull) - np.tile(step[-3:], len(common))
    kept, rotation = np.r_[of_first, of_second, size : size + 3], exp_map(step[-3:]) @ start
    return Rig(
        first.camera.with_values(first.camera.values + step[of_first]),
        second.camera.with_values(second.camera.values + step[of_second]),
        rotation,
        None,
        covariance[np.ix_(kept, kept)],
        common,
        ARCSEC * log_map(pairs @ rotation.T),
        chi_square=float(scatter @ expected @ scatter),
        degrees_of_freedom=n - 3,
    )


def _known(calibration: Calibration, stated: CameraModel, covariance: Array | None) -> tuple[Array, Array]:
    """Return information and pull of a stated camera, at the values that the views give.

    A coefficient that the stated camera lacks is zero in its model. Sensor and lens model must be the same.
    """
    camera, names = calibration.camera, calibration.camera.parameter_names
    held = dict(zip(stated.parameter_names, stated.values, strict=True))
    if stated.image_size != camera.image_size or any(held[name] for name in held if name not in names):
        raise InputMismatch(
            "A stated camera has another sensor or another lens model than its views.",
            remedy="Give views and calibration of the same camera.",
        )
    values = np.array([held.get(name, 0.0) for name in names])
    spread = _exact(values)
    if covariance is not None:
        have = [names.index(name) for name in held if name in names]
        rows = [at for at, name in enumerate(held) if name in names]
        spread[np.ix_(have, have)] = covariance[np.ix_(rows, rows)]
    off = values - camera.values
    apart = float(off @ np.linalg.solve(spread + calibration.camera_covariance, off))
    if apart > special.chdtri(len(off), _RIGID):
        raise InputMismatch(
            "A stated camera contradicts its views behind the collimator by more than their uncertainties.",
            remedy="Look at it with `starbench check`, or leave out --calibration.",
        )
    known = np.asarray(np.linalg.inv(spread), np.float64)
    return known, known @ off


def _exact(values: Array) -> Array:
    """Return the covariance of values that are held."""
    return np.asarray(np.diag((_EXACT * np.maximum(np.abs(values), 1.0)) ** 2), np.float64)


def _rows(views: Sequence[int]) -> Ints:
    return np.concatenate([np.arange(3 * i, 3 * i + 3) for i in views])


def _errors(calibration: Calibration) -> RotationErrors:
    """Return how the rotations follow what the views share; of a reference method, the camera beside them."""
    if calibration.rotation_errors is not None:
        return calibration.rotation_errors
    camera, rows = calibration.camera, len(calibration.rotation_covariance)
    names, size = camera.parameter_names, len(camera.values)
    prior = np.zeros((size, size)), np.zeros(size), np.zeros((rows, size))
    known = calibration.camera_covariance, *prior, calibration.rotation_covariance
    return RotationErrors(names, camera.values, *known)


def _one_collimator(first: RotationErrors, other: RotationErrors) -> tuple[Array, Array, Ints, Array]:
    """Return (U, U) information and (U,) pull with one collimator, and the (S,) places of the second's unknowns.

    Also by how much the second calibration must move so that both have one collimator, (S,). Own: the information of
    both is added, and what was known of the collimator beforehand is taken off once, with the other unknowns eliminated
    from it (Schur complement).
    """
    k, shared = len(first.names), [name for name in CENTRE if name in first.names and name in other.names]
    own = iter(range(k, k + len(other.names)))
    places = np.array([first.names.index(name) if name in shared else next(own) for name in other.names])
    size = max(k, int(places.max()) + 1)
    information, pull, shift = np.zeros((size, size)), np.zeros(size), np.zeros(len(places))
    information[:k, :k] = np.linalg.inv(first.covariance)
    second = np.linalg.inv(other.covariance)
    information[np.ix_(places, places)] += second
    alike = places < k
    shift[alike] = first.means[places[alike]] - other.means[alike]
    pull[places] -= second @ shift
    if shared:  # both calibrations hold what was known of the collimator
        glass = places[alike]
        rest = np.setdiff1d(np.arange(k), glass)
        between, others = first.prior[np.ix_(glass, rest)], first.prior[np.ix_(rest, rest)]
        carry: Array = between @ np.linalg.pinv(others, hermitian=True)
        information[np.ix_(glass, glass)] -= first.prior[np.ix_(glass, glass)] - carry @ between.T
        pull[glass] -= first.prior_pull[glass] - carry @ first.prior_pull[rest]
    return information, pull, places, shift


def stated_cameras(
    first: CameraModel, second: CameraModel, covariances: Sequence[Array | None] = (None, None)
) -> Rig:
    """Return cameras with known intrinsics and an unknown rig, to start from; covariance None holds the values."""
    blocks = [
        _exact(camera.values) if covariance is None else covariance
        for camera, covariance in zip((first, second), covariances, strict=True)
    ]
    return Rig(first, second, np.eye(3), None, linalg.block_diag(*blocks))
