"""Predicted views: the stars that a pose will show according to the model, without noise."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from calib.errors import TooFewStars
from calib.model.camera import CameraModel
from calib.model.collimator import Collimator
from calib.model.gimbal_readings import GimbalReadings
from calib.model.passport import Passport
from calib.model.rotation import euler_zxy
from calib.model.type_b_terms import TypeBTerm
from calib.studies.collimator_errors import CollimatorErrors
from calib.target import StarTarget
from calib.view import View

Array = NDArray[np.float64]

#: Stars closer than this to the border of the image are not detected.
_BORDER_PX = 10.0
_MIN_STARS = 20
_RIM_POINTS = 72


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
    rotation = euler_zxy(pose.get("pan_deg", 0.0), pose.get("tilt_deg", 0.0), pose.get("roll_deg", 0.0))
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
    view = View(name, bench.camera.image_size, ids[shown], pixels[shown], stars[shown], covariances)
    return view, rotation


def rim_share(bench: ExpectedBench, rotation: Array) -> float:
    """Return the share of the rim of the beam's disc that is in view at a pose.

    rotation: (3, 3) rotation of the pose, camera <- target.
    Returns: Share of the circumference, 0 to 1.
    """
    angles = np.linspace(0.0, 2.0 * np.pi, _RIM_POINTS, endpoint=False)
    radius = bench.collimator.r * np.tan(np.deg2rad(bench.half_angle_deg))
    # The rim as seen from the collimator's centre (x, y, -r).
    rim = np.column_stack(
        [radius * np.cos(angles), radius * np.sin(angles), np.full(len(angles), bench.collimator.r)]
    )
    pixels = bench.camera.project(rim @ rotation.T)
    limit = np.array(bench.camera.image_size) - 1.0
    with np.errstate(invalid="ignore"):
        return float(((pixels > 0) & (pixels < limit)).all(axis=1).mean())


def _visible(bench: ExpectedBench, points_mm: Array, rotation: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Return the image points of target points, (N, 2) px, and which are visible, (N,) bool.

    Image point of R (P - c) (arXiv:2512.16092, eq. 2). Own model of the beam: a disc of radius r tan(half angle).
    """
    centre = bench.collimator.centre
    pixels = bench.camera.project(
        (np.column_stack([points_mm, np.zeros(len(points_mm))]) - centre) @ rotation.T
    )
    limit = np.array(bench.camera.image_size) - 1.0 - _BORDER_PX
    with np.errstate(invalid="ignore"):
        framed = ((pixels > _BORDER_PX) & (pixels < limit)).all(axis=1)
    radius = bench.collimator.r * np.tan(np.deg2rad(bench.half_angle_deg))
    return pixels, framed & (np.linalg.norm(points_mm - centre[:2], axis=1) < radius)
