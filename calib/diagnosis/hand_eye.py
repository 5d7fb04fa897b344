"""Hand-eye check: the gimbal's readings compared with the rotations that the camera saw.

The check is a witness: the readings do not enter the calibration here. It estimates how the camera is mounted, how the
gimbal stands, and a scale of each axis that moved (`calib.diagnosis.gimbal_model`). It searches for faults
(`calib.diagnosis.gimbal_faults`), and the verdict names whose error it is.

A wrong focal length changes all seen angles by the same ratio, along all axes and in all pairs of poses. So a common
ratio within the uncertainty of the focal length belongs to the calibration (camera or collimator), not to the gimbal.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from calib.arrays import Array
from calib.diagnosis.gimbal_faults import Explanation, SeenRotations, search_faults
from calib.diagnosis.gimbal_model import (
    GimbalFit,
    GimbalModel,
    first_scales,
    global_fit,
    pair_ratios,
    scales_near,
)
from calib.diagnosis.hand_eye_verdict import HandEyeCheck
from calib.errors import DegenerateViews, InputMismatch
from calib.model.gimbal_readings import AXES, ENCODER_SHARE, MIN_VIEWS, MOVED_DEG, alike_errors, angles_of
from calib.model.likelihood_ratio import DECISIVE
from calib.model.rotation import ARCSEC, log_map
from calib.one_thread import on_one_thread

#: A scale with a larger 1-sigma is not determined.
_UNDETERMINED = 0.25
#: Minima differ if their scales or mountings differ by this many sigmas.
_DIFFERENT = 5.0


@on_one_thread
def check_hand_eye(
    rotations: Array,
    covariance: Array,
    readings_deg: Sequence[Mapping[str, float]],
    *,
    reading_sigma_deg: float = 0.0,
    scale_sigma: float = 0.0,
    focal_uncertainty: float | None = None,
    birge_ratio: float = 1.0,
    names: Sequence[str] = (),
) -> HandEyeCheck:
    """Compare the readings of a gimbal, in the order in which they were taken, with the rotations of a calibration.

    The unknown rotations and scales are estimated by generalised least squares. Robot-world and hand-eye equation:
    Zhuang, Roth and Sudhakar (1994). Least squares with a covariance matrix: Aitken (1936). Scatter beyond the stated
    covariance: Paule and Mandel (1982). Rotations, covariance (of `Calibration.rotation_covariance`) and Birge ratio
    are those of a `Calibration`. ``reading_sigma_deg`` is what is stated of each reading, 1 sigma: scatter below it is
    no fault. ``scale_sigma`` is what is stated of the scale of each axis, 1 sigma: a ratio within it is none either.
    ``focal_uncertainty`` is U of its focal length as a share of it; None for twice the 1-sigma of the scales.
    Raises InputMismatch: If the numbers of views differ, or an axis is unknown.
    Raises DegenerateViews: If there are fewer than 3 views, or no axis moved.
    """
    angles = angles_of(readings_deg)
    if not len(angles) == len(rotations) == len(covariance) // 3:
        raise InputMismatch(f"{len(rotations)} rotations, but {len(angles)} readings.")
    moved = np.ptp(angles, axis=0) > MOVED_DEG
    if len(angles) < MIN_VIEWS or not moved.any():
        raise DegenerateViews(
            f"Cannot check the gimbal: {len(angles)} views, {moved.sum()} axes moved; "
            f"at least {MIN_VIEWS} views and 1 moved axis are needed."
        )
    given = tuple(i for i, axis in enumerate(AXES) if any(axis in reading for reading in readings_deg))
    enough = 3 * len(angles) > 6 + moved.sum()
    free = tuple(int(i) for i in np.flatnonzero(moved)) if enough else ()
    model = GimbalModel(angles, free)
    values = first_scales(rotations, model)
    equal = np.eye(len(covariance))
    start = global_fit(rotations, model, equal, values)[0]
    of_readings = _covariance_of(np.deg2rad(reading_sigma_deg) * start.motors[:, :, moved], angles[:, moved])
    seen = SeenRotations(rotations, covariance + of_readings, start)
    first = seen.explain(model, start)
    mirrored = False
    if 2 in free and len(free) > 1:
        model = replace(model, angles=angles * (1.0, 1.0, -1.0))
        other = seen.explain(model, global_fit(rotations, model, equal, values)[0])
        better = other.likelihood > first.likelihood + DECISIVE or not scales_near(first.fit, values)
        mirrored = better and scales_near(other.fit, values)
        first = other if mirrored else first
    last, faults = search_faults(seen, first, given)
    return replace(
        _compared(seen, first, last, mirrored, scale_sigma),
        names=names,
        faults=faults,
        focal_uncertainty=focal_uncertainty,
        birge_ratio=birge_ratio,
    )


def _covariance_of(axes_rad: Array, angles_deg: Array) -> Array:
    """Return the (3 n, 3 n) covariance of readings, from (n, 3, k) axes times 1 sigma, and (n, k) angles.

    Readings of neighbouring angles share errors. Without these, the last row of a raster looks like a slip.
    """
    alike = np.moveaxis(alike_errors(angles_deg), 0, 2)
    shares = np.eye(len(angles_deg))[:, :, None] + ENCODER_SHARE**2 * alike
    both = np.einsum("nik,nmk,mjk->nimj", axes_rad, shares, axes_rad)
    return np.asarray(both.reshape(3 * len(angles_deg), -1))


def _compared(
    seen: SeenRotations, first: Explanation, last: Explanation, mirrored: bool, scale_sigma: float
) -> HandEyeCheck:
    """Return what the rotations show, without faults and with them, before anything is said of the calibration."""
    fit, free = last.fit, last.fit.model.free
    scales = slice(6, 6 + len(free))
    spread = last.covariance[scales, scales]
    sigma = np.sqrt(np.diag(spread))
    freedom, whole = fit.degrees_of_freedom, not fit.open_directions.size
    # Shared errors have few, large eigenvalues; the median is the variance that is a rotation's own.
    own = float(np.median(np.linalg.eigvalsh(last.scatter.covariance)))
    scatter = max(float(fit.off @ fit.off) / max(freedom, 1), own)
    alone = scatter * np.diag(fit.covariance(np.eye(len(fit.off))))[scales]
    values, each = fit.values[: len(free)], np.eye(len(free))
    apart = each[values.argmax()] - each[values.argmin()] if free else np.zeros(0)
    ambiguous = bool(free) and (
        fit.undetermined_scales or bool(sigma.max() > _UNDETERMINED) or _ambiguous(seen, last, sigma)
    )
    known = [] if ambiguous else [AXES[axis] for axis in free]
    return HandEyeCheck(
        dict(zip(known, values.tolist(), strict=False)),
        dict(zip(known, sigma.tolist(), strict=False)),
        np.sqrt(alone + scale_sigma**2),
        float(np.sqrt(np.maximum(apart @ spread @ apart, 0.0) + 2.0 * scale_sigma**2)),
        pair_ratios(seen.rotations, fit.model, fit.values),
        ambiguous,
        _reversed_axes(set(free), bool(whole and fit.camera_from_head[2, 2] < -0.5), mirrored),
        ARCSEC * last.excess_rad,
        freedom,
        ARCSEC * first.fit.off.reshape(-1, 3),
    )


def _reversed_axes(free: set[int], backwards: bool, mirrored: bool) -> tuple[str, ...]:
    """Return the axes of which the sign of one is reversed, each in words; empty if no sign is.

    Half a turn of the mounting about x reverses pan and roll, about y tilt and roll, about z pan and tilt. So a wrong
    sign shows as a camera that looks backwards, or, with three axes, as readings that fit only if roll is mirrored.
    """
    if free >= {0, 1} and backwards != mirrored and not mirrored:
        return ("pan", "tilt") if 2 not in free else ("roll and of one other axis",)
    if mirrored and free == {0, 1, 2}:
        return ("pan", "tilt") if backwards else ("roll",)
    return ("roll",) if backwards and 2 in free and len(free) == 2 else ()


def _ambiguous(seen: SeenRotations, last: Explanation, sigma: Array) -> bool:
    """Return whether another minimum with other scales, or another mounting, fits nearly as well."""
    fit, count = last.fit, len(last.fit.model.free)
    minima = global_fit(seen.rotations, fit.model, last.scatter.whitening, fit.values)
    mounting = float(np.sqrt(np.trace(last.covariance[:3, :3])))

    def differs(other: GimbalFit) -> bool:
        if not scales_near(other, fit.values) or other.chi_square > fit.chi_square + DECISIVE:
            return False
        if (np.abs(other.values[:count] - fit.values[:count]) > _DIFFERENT * sigma + 1e-6).any():
            return True
        turned = float(np.linalg.norm(log_map(other.camera_from_head @ fit.camera_from_head.T)))
        return not fit.open_directions.size and turned > _DIFFERENT * mounting + 1e-4

    return any(differs(other) for other in minima)
