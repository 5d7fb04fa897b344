"""Predicted views: the stars that a pose will show according to the model, without noise.

The joint adjustment describes errors of the collimator by amplitudes (`calib.joint.amplitudes`). `CollimatorErrors`
says how many times larger these are than those of a good collimator.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from calib.arrays import Array, Bools
from calib.errors import InputMismatch, TooFewStars
from calib.model.camera import CameraModel
from calib.model.collimator import Collimator
from calib.model.gimbal_readings import AXES, GimbalReadings
from calib.model.passport import Passport
from calib.model.rotation import euler_zxy
from calib.model.type_b_terms import TypeBTerm
from calib.target import StarTarget
from calib.view import View

#: Stars closer than this to the border of the image are not detected.
_BORDER_PX = 10.0
_MIN_STARS = 20  # More than detection needs (12): a pose is not planned at its limit
_RIM_POINTS = 72  # Every 5 degrees
#: `CollimatorErrors.rms_px` of a typical real collimator before a gimbal, px.
TYPICAL_RMS_PX = 0.12
#: Defocus of a collimator whose defocus is not stated.
TYPICAL_DEFOCUS = 0.066
#: RMS error of a good collimator per axis, rad: what all views share, and what differs from pose to pose. They follow
#: from the medians of the amplitudes: a degree each, added in squares.
GOOD_RAD, GOOD_POSE_RAD = 1.9e-5, 4e-6
#: An ideal collimator is found to be this many times better than a good one: the views do not show more.
_IDEAL = 0.05
#: What differs from pose to pose if a gimbal holds the camera, over what is expected of a good collimator beforehand.
_STEADY = 0.3
#: Share of what differs from pose to pose that follows the turn, so that it does not average out over poses.
_FOLLOWS = 1.0 / 3.0
#: Own field of a view over the displacement of the pupil, as a share of the squared tangent of the field's edge: what
#: remains when its place is found.
_KEYSTONE = 0.03


@dataclass(frozen=True)
class CollimatorErrors:
    """Size of the errors of a collimator, finite and not negative.

    Root mean square lengths, px, star noise included, of errors that follow the collimator (0 for an ideal one), and of
    those that differ from pose to pose (0 if as small as those of a good collimator). The wander is a random
    displacement of the entrance pupil across the beam from pose to pose, 1 sigma per axis, mm (0 if a gimbal holds the
    camera). Defocus as in `calib.model.gimbal_readings.ParallaxBound`.
    """

    rms_px: float = 0.0
    pupil_wander_mm: float = 0.0
    defocus: float = TYPICAL_DEFOCUS
    pose_rms_px: float = 0.0

    def __post_init__(self) -> None:
        for name in ("rms_px", "pupil_wander_mm", "pose_rms_px"):
            if not 0 <= getattr(self, name) < np.inf:
                raise InputMismatch(f"{name} is {getattr(self, name)}; it must not be negative.")
        if not np.isfinite(self.defocus):
            raise InputMismatch(f"defocus is {self.defocus}; it must be a number.")

    def times_good(
        self, focal_px: float, star_sigma_px: float, r_mm: float, edge: float
    ) -> tuple[float, float, float]:
        """Return three ratios: errors over those of a good collimator.

        The first is for errors that all poses share, the second for those that follow the turn, the third for those
        that differ from pose to pose. ``edge`` is the tangent of the half angle.
        """
        own = _per_axis(self.pose_rms_px, star_sigma_px) / focal_px
        common = max(_per_axis(self.rms_px, star_sigma_px) / focal_px / GOOD_RAD, _IDEAL)
        turn = max(_FOLLOWS * own / GOOD_POSE_RAD, common)
        own = float(np.hypot(own, _KEYSTONE * edge**2 * self.pupil_wander_mm / r_mm))
        return common, turn, max(own / GOOD_POSE_RAD, _STEADY * common, _IDEAL)


def _per_axis(rms_px: float, star_sigma_px: float) -> float:
    """Return the part of an RMS length that is not star noise, 1-sigma per axis, px; 0 if star noise explains it.

    The mean square of a length in a plane is twice the variance per axis.
    """
    return float(np.sqrt(max(0.5 * rms_px**2 - star_sigma_px**2, 0.0)))


@dataclass(frozen=True)
class ExpectedBench:
    """The expected bench.

    Parameters
    ----------
    camera
        Approximate intrinsics, with the distortion coefficients to be estimated.
    collimator
        Approximate centre of the collimator.
    half_angle_deg
        Half angle of the beam's disc, degrees.
    star_sigma_px
        1-sigma of a star per axis, px.
    target
        The printed target.
    passport
        Passport of the collimator, if one will be used.
    needs_tag
        Whether a pose must show the whole tag.
    errors
        Errors of the collimator.
    readings
        Uncertainty of the gimbal's readings and the bound of their parallax, if they will be recorded; its
        angles do not matter.
    terms
        Type B terms of the uncertainty budget.
    radial_sigma
        Prior 1-sigma of the radial term, if the bench states it.
    amplitudes
        Sizes of the errors by name, if a run is under way (`calib.joint.amplitudes`); None for those that `errors`
        says.
    """

    camera: CameraModel
    collimator: Collimator
    half_angle_deg: float
    star_sigma_px: float = 0.02
    target: StarTarget = field(default_factory=StarTarget)
    passport: Passport | None = None
    needs_tag: bool = True
    errors: CollimatorErrors = field(default_factory=CollimatorErrors)
    readings: GimbalReadings | None = None
    terms: tuple[TypeBTerm, ...] = ()
    radial_sigma: float | None = None
    amplitudes: Mapping[str, float] | None = None


def predicted_view(bench: ExpectedBench, pose: Mapping[str, float], name: str) -> tuple[View, Array]:
    """Return the stars that a pose will show, without noise, and its rotation.

    Spherical motion: arXiv:2512.16092, eq. 2.

    Parameters
    ----------
    bench
        The expected bench.
    pose
        ``pan_deg``, ``tilt_deg``, ``roll_deg``, degrees; missing angles are zero.
    name
        Name of the view.

    Returns
    -------
    tuple of View and Array
        The view, and the (3, 3) rotation, camera <- target.

    Raises
    ------
    TooFewStars
        If the pose shows fewer than 20 stars, or not the whole tag if it is needed.
    """
    rotation = euler_zxy(*(pose.get(axis, 0.0) for axis in AXES))
    return view_at(bench, rotation, name), rotation


def view_at(bench: ExpectedBench, rotation: Array, name: str) -> View:
    """Return the stars that a camera shows at a rotation, camera <- target, as `predicted_view`."""
    ids = bench.target.ids
    stars = bench.target.positions_mm(ids)
    pixels, shown = _visible(bench, stars, rotation)
    if bench.needs_tag and not _visible(bench, bench.target.tag_corners_mm, rotation)[1].all():
        raise TooFewStars(
            "The tag will not be completely in the image.", where=name, remedy="Use smaller angles."
        )
    if shown.sum() < _MIN_STARS:
        raise TooFewStars(
            f"Only {shown.sum()} stars will be visible; at least {_MIN_STARS} are needed.",
            where=name,
            remedy="Use smaller angles.",
        )
    covariances = np.tile(np.eye(2) * bench.star_sigma_px**2, (int(shown.sum()), 1, 1))
    return View(name, bench.camera.image_size, ids[shown], pixels[shown], stars[shown], covariances)


def rim_share(bench: ExpectedBench, rotation: Array) -> float:
    """Return the share, 0 to 1, of the circumference of the beam's disc that is in view at a rotation."""
    angles = np.linspace(0.0, 2.0 * np.pi, _RIM_POINTS, endpoint=False)
    radius = bench.collimator.r * np.tan(np.deg2rad(bench.half_angle_deg))
    # The rim as seen from the collimator's centre (x, y, -r).
    across = radius * np.array([np.cos(angles), np.sin(angles)])
    rim = np.column_stack([*across, np.full(len(angles), bench.collimator.r)])
    return float(_framed(bench.camera, bench.camera.project(rim @ rotation.T), 0.0).mean())


def _visible(bench: ExpectedBench, points_mm: Array, rotation: Array) -> tuple[Array, Bools]:
    """Return the image points of target points, (N, 2) px, and which are visible, (N,) bool.

    Image point of R (P - c) (arXiv:2512.16092, eq. 2). Own model of the beam: a disc of radius r tan(half angle).
    """
    centre = bench.collimator.centre
    off = np.column_stack([points_mm, np.zeros(len(points_mm))]) - centre
    pixels = bench.camera.project(off @ rotation.T)
    radius = bench.collimator.r * np.tan(np.deg2rad(bench.half_angle_deg))
    inside = np.linalg.norm(off[:, :2], axis=1) < radius
    return pixels, _framed(bench.camera, pixels, _BORDER_PX) & inside


def _framed(camera: CameraModel, pixels: Array, border_px: float) -> Bools:
    """Return (N,) which image points lie farther inside of the image than its border; NaN does not."""
    limit = np.array(camera.image_size) - 1.0 - border_px
    with np.errstate(invalid="ignore"):
        return np.asarray(((pixels > border_px) & (pixels < limit)).all(axis=1))
