"""Hand-eye check: the gimbal's readings compared with the rotations that the camera saw.

The check is a witness: the readings do not enter the calibration here. It estimates how the camera is mounted, how the
gimbal stands, and a scale of each axis that moved (`calib.diagnosis.gimbal_model`). It weighs what may be wrong with
the rotations (`calib.diagnosis.weighed_suspects`) and with the list of readings: signs, axes, order.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.arrays import Array
from calib.diagnosis.gimbal_model import (
    GimbalFit,
    GimbalModel,
    first_scales,
    global_fit,
    pair_ratios,
)
from calib.diagnosis.hand_eye_result import HandEyeCheck, OtherReadings
from calib.diagnosis.suspects import FEWEST, ODDS, Suspect
from calib.diagnosis.weighed_suspects import Explanation, Found, SeenRotations, none_fits, search
from calib.errors import DegenerateViews, InputMismatch
from calib.model import cause as kinds
from calib.model.gimbal_readings import AXES, ENCODER_SHARE, MIN_VIEWS, MOVED_DEG, alike_errors, angles_of
from calib.model.likelihood_ratio import ALONE
from calib.model.rotation import ARCSEC
from calib.one_thread import on_one_thread

#: Parallax before a real collimator imitates a scale of this 1-sigma.
PARALLAX = 0.005
#: A scale with a larger 1-sigma is not determined: it could not even tell gon from degrees.
_UNDETERMINED = 0.25
#: 2 log of the odds of a camera that looks backwards, and so does not see the target: as large as any evidence
#: (`calib.model.cause.LARGEST_EVIDENCE`); of other readings than stated.
_BACKWARDS, _OTHER = -100.0, 2.0 * math.log(ODDS)
#: A camera looks backwards if the z component of its axis is below this, 120 degrees from forwards.
_BACK = -0.5


@on_one_thread
def check_hand_eye(
    rotations: Array,
    covariance: Array,
    readings_deg: Sequence[Mapping[str, float]],
    *,
    reading_sigma_deg: float = 0.0,
    scale_sigma: float = 0.0,
    parallax_sigma: float = PARALLAX,
    birge_ratio: float = 1.0,
    names: Sequence[str] = (),
    times: Array | None = None,
) -> HandEyeCheck:
    """Compare the readings of a gimbal, in the order in which they were taken, with the rotations of a calibration.

    The unknown rotations and scales are estimated by generalised least squares. Robot-world and hand-eye equation:
    Zhuang, Roth and Sudhakar (1994). Least squares with a covariance matrix: Aitken (1936). Scatter beyond the stated
    covariance: Paule and Mandel (1982). Rotations, covariance (of `Calibration.rotation_covariance`) and Birge ratio
    are those of a `Calibration`. ``reading_sigma_deg`` is what is stated of each reading, 1 sigma: scatter below it is
    no fault. ``scale_sigma`` is what is stated of the scale of each axis, 1 sigma: a ratio within it is none either;
    ``parallax_sigma`` what parallax may do to all of them. ``times`` are (n,) of `calib.view.times_of`; None: poses
    at equal times.
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
    stated = _Stated(rotations, covariance, float(np.deg2rad(reading_sigma_deg)), given)
    times = np.linspace(0.0, 1.0, len(angles)) if times is None else times
    first = stated.weighed(GimbalModel(angles, times, free))
    best, other, beside = first, None, tuple[str, ...]()
    if enough and (first.last.scattered or _looks_back(first.last.fit)):  # others fit no better
        tried = [
            (each, stated.weighed(GimbalModel(own, times, free, more)))
            for each, own, more in _other_readings(angles, free)
        ]
        tried.sort(key=lambda pair: -pair[1].worth)
        if tried and tried[0][1].worth > first.worth - _OTHER:
            other, best = tried[0]
            near = [each.kind for each, weighed in tried[1:] if weighed.worth > best.worth - ALONE]
            beside = tuple(kind for kind in near if kind != other.kind)
    check = _compared(best, scale_sigma, parallax_sigma)
    return replace(check, other=other, beside=beside, names=names, birge_ratio=birge_ratio)


@dataclass(frozen=True, eq=False)
class _Weighed:
    """What explains the rotations by a list of readings."""

    seen: SeenRotations
    first: Explanation  # Without suspects
    last: Explanation
    found: tuple[Found, ...]
    worth: float  # 2 log of the likelihood times the odds


@dataclass(frozen=True, eq=False)
class _Stated:
    """Rotations, their covariance, 1-sigma of a reading, and the axes that are read."""

    rotations: Array
    covariance: Array
    sigma_rad: float
    axes: tuple[int, ...]

    def weighed(self, model: GimbalModel) -> _Weighed:
        """Return what explains the rotations, beginning with a model."""
        values = np.append(first_scales(self.rotations, model), model.start[len(model.free) :])
        start = global_fit(self.rotations, model, np.eye(len(self.covariance)), values)[0]
        moved = np.ptp(model.angles, axis=0) > MOVED_DEG
        axes_rad = self.sigma_rad * start.frames.motors[:, :, moved]
        covariance = self.covariance + _covariance_of(axes_rad, model.angles[:, moved])
        seen = SeenRotations(self.rotations, covariance, start)
        first = seen.explain(model, start)
        last, found, worth = search(seen, first, self.axes)
        found = tuple(each for each in found if each.suspect not in model.suspects)
        return _Weighed(seen, first, last, found, worth + _BACKWARDS * _looks_back(last.fit))


def _looks_back(fit: GimbalFit) -> bool:
    """Return whether the camera would look backwards, or an axis turn backwards, as with a wrong sign.

    Half a turn of the mounting about x reverses pan and roll, about y tilt and roll, about z pan and tilt.
    """
    backwards = fit.camera_from_head[2, 2] < _BACK or (fit.values[: len(fit.model.free)] < 0.0).any()
    return bool(not fit.open_directions.size and backwards)


def _other_readings(
    angles: Array, free: tuple[int, ...]
) -> Iterator[tuple[OtherReadings, Array, tuple[Suspect, ...]]]:
    """Yield what else (n, 3) angles may be, and poses whose reading is then unknown."""
    moved, last = set(free), len(angles) - 1
    if {0, 1} <= moved:
        yield OtherReadings(kinds.REVERSED, "pan or of tilt"), angles * (-1.0, 1.0, 1.0), ()
        yield OtherReadings(kinds.EXCHANGED), angles[:, [1, 0, 2]], ()
    if 2 in moved and len(moved) > 1:
        yield OtherReadings(kinds.REVERSED, "roll"), angles * (1.0, 1.0, -1.0), ()
    if len(moved) == 3:
        yield OtherReadings(kinds.REVERSED, "roll and of one other axis"), angles * (-1.0, 1.0, -1.0), ()
    if len(angles) >= FEWEST:
        for by, unknown in ((1, last), (-1, 0)):
            yield (
                OtherReadings(kinds.LATE, value=float(by)),
                np.roll(angles, -by, axis=0),
                (Suspect(kinds.ONE_POSE, pose=unknown),),
            )


def _covariance_of(axes_rad: Array, angles_deg: Array) -> Array:
    """Return the (3 n, 3 n) covariance of readings, from (n, 3, k) axes times 1 sigma, and (n, k) angles.

    Readings of neighbouring angles share errors. Without these, the last row of a raster looks like a slip.
    """
    alike = np.moveaxis(alike_errors(angles_deg), 0, 2)
    shares = np.eye(len(angles_deg))[:, :, None] + ENCODER_SHARE**2 * alike
    both = np.einsum("nik,nmk,mjk->nimj", axes_rad, shares, axes_rad)
    return np.asarray(both.reshape(3 * len(angles_deg), -1))


def _compared(weighed: _Weighed, stated_scale_sigma: float, parallax_sigma: float) -> HandEyeCheck:
    """Return what the rotations show, by the readings that explain them best."""
    last, seen = weighed.last, weighed.seen
    fit, free = last.fit, last.fit.model.free
    scales = slice(6, 6 + len(free))
    sigma = np.sqrt(np.diag(last.covariance[scales, scales]))
    ambiguous = bool(free) and (fit.undetermined_scales or bool(sigma.max() > _UNDETERMINED))
    known = [] if ambiguous else [AXES[axis] for axis in free]
    return HandEyeCheck(
        dict(zip(known, fit.values.tolist(), strict=False)),
        dict(zip(known, sigma.tolist(), strict=False)),
        stated_scale_sigma,
        parallax_sigma,
        pair_ratios(np.swapaxes(fit.errors, 1, 2) @ seen.rotations, fit.model.angles),
        ambiguous,
        ARCSEC * last.excess_rad,
        last.scatters,
        ARCSEC * weighed.first.fit.off.reshape(-1, 3),
        none_fits(seen, last),
        weighed.found,
    )
