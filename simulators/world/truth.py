"""True parameters of the simulated world: those that a calibration shall find, and those that disturb it.

A dataclass a section of the configuration: its fields are the keys, with their ranges and defaults. Those of the gimbal
are in ``gimbal``. This module computes nothing with them; ``optics``, ``pixels``, ``drift`` and ``placing`` do.
"""

from __future__ import annotations

import dataclasses
import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, Final

from pydantic import BeforeValidator

from calib.target import StarTarget
from simulators.reading import (
    Count,
    NotNegative,
    Number,
    Pair,
    Positive,
    Section,
    Vector,
    Wrong,
    one_of,
    refused,
)
from simulators.world.gimbal import GimbalTruth

PITCH_MM: Final = StarTarget.pitch_mm
"""Side of a square of the printed target, mm."""

_FocalLength = Annotated[
    Positive,
    refused(lambda px: not 1.0 <= px <= 1e6, "{!r} px is no focal length.", "Give a number from 1 to 1e+06."),
]
POLARITIES: Final = ("positive", "negative")

REFERENCE_C: Final = 41.5
"""Temperature of the camera at which its focal lengths have the values of the truth."""

LAW: Final[Mapping[str, str]] = {
    "temperature_c": "room_c + room_c_per_h t / 3600 s + self_heating_c (1 - exp(-t / (60 s warm_up_min)))",
    "t": "seconds since the bench was switched on",
    "fx, fy": f"times 1 + 1e-6 focal_ppm_per_c (temperature_c - {REFERENCE_C})",
}
"""Equations of the quantities that depend on `ThermalTruth`."""

DELIVERED_F_NUMBER: Final = 2.8
"""f-number at which the light on the sensor has its nominal brightness."""

CLOSEST_M: Final = 0.2
"""Focus distance at the ring's near stop."""

BEYOND_M: Final = -3.3
"""Focus distance at the other stop, a little beyond infinity: rays that meet 3.3 m behind the lens are in focus."""

RING_SPAN_DEG: Final = 180.0
"""Turn of the focus ring from infinity (0) to the near stop."""

F_NUMBERS: Final = (1.0, 32.0)
"""Smallest and largest f-number."""

LARGEST_FOCAL_MM: Final = 100.0
"""Longest focal length for which the ring's travel is meant."""

LENS_LAW: Final[Mapping[str, str]] = {
    "focal length": "1 / f = 1 / v0 + V, v0 = pixel_um (fx + fy) / 2 of section camera as configured",
    "vergence of the pattern": "V = defocus / r of the collimator",
    "image distance": "1 / v = 1 / f - 1 / focus_distance",
    "fx, fy": "times v / v0: a lens that is focused nearer sees a narrower angle (breathing)",
    "blur_px": "diameter of the disc of light of a point: f / f_number v |1 / focus_distance - V| / pixel_um",
    "light": f"times (v0 / v)^2 ({DELIVERED_F_NUMBER} / f_number)^2",
}
"""Equations of focus and aperture, as ``truth.json`` holds them."""

FNumber = Annotated[
    Positive,
    refused(
        lambda f: not F_NUMBERS[0] <= f <= F_NUMBERS[1],
        "The aperture does not go to f/{:g}.",
        "Give an f-number from {:g} to {:g}.".format(*F_NUMBERS),
    ),
]


@dataclass(frozen=True)
class CameraTruth(Section):
    """The camera's lens in OpenCV's conventions, pixel centres at integers."""

    fx: _FocalLength = 3345.06  # Focal length along x, px
    fy: _FocalLength = 3345.27  # Focal length along y, px
    cx: Number = 642.10  # x of the principal point, px
    cy: Number = 363.32  # y of the principal point, px
    k1: Number = 0.06  # Radial distortion, r^2 on normalised coordinates (Brown 1966, 1971)
    k2: Number = -0.90  # Radial distortion, r^4
    p1: Number = 0.0  # Tangential distortion, its axis along y
    p2: Number = 0.0  # Tangential distortion, its axis along x
    k3: Number = 0.0  # Radial distortion, r^6
    # With k1, k2 and k3 the polynomial of a fisheye's angle (Kannala and Brandt 2006); 0 for a pinhole.
    k4: Number = 0.0
    projection: str = "pinhole"  # "pinhole" or "fisheye"
    width: Count = 1280
    height: Count = 720


@dataclass(frozen=True)
class CollimatorTruth(Section):
    """Position of the camera's centre in the target's frame, the disc of light, and the collimator's errors."""

    x: Number = 24.0 * PITCH_MM + 0.7  # The camera's centre is (x, y, -r), mm of the target plane
    y: Number = 35.0 * PITCH_MM - 0.4  # See ``x``
    r: Positive = 255.0  # Distance of the camera's centre from the target plane, mm
    half_angle_deg: Positive = 12.0
    disc_x: Number = 0.0  # x of the disc's centre on the target, mm, from ``x``
    disc_y: Number = 0.0  # y of the disc's centre on the target, mm, from ``y``
    # Width of the vignetted rim, as a share of the disc's radius; brightness falls smoothly from 1 to 0 over
    # it.
    rim: NotNegative = 0.08
    # Displacement of the disc on the target along x and y, mm, per unit of the tangent of the camera's turn.
    disc_walk: Pair = (0.0, 0.0)
    defocus: Number = 0.0  # Defocus of the target, dimensionless as all five below; see ``collimator_errors``
    spherical: Number = 0.0  # Spherical aberration
    coma: Number = 0.0  # Coma
    astigmatism: Number = 0.0  # Astigmatism
    field_curvature: Number = 0.0  # Field curvature
    distortion: Number = 0.0  # Distortion
    # Outward displacement of points at the disc's edge, where the camera's pupil is partly filled; it grows
    # with the fourth power of the distance from the disc's centre.
    rim_roll_mm: Number = 0.0
    # Random displacement of the disc, in addition to that by the turn, 1 sigma in x and in y.
    disc_wander_mm: NotNegative = 0.0
    disc_breathing: NotNegative = 0.0  # Random change of the disc's radius, as a share of it, 1 sigma
    # Root mean square deviation of the disc's edge from a circle, as a share of its radius.
    disc_unevenness: NotNegative = 0.0
    irregularity_mm: NotNegative = 0.0  # Root mean square of the random displacements; see ``irregularity``
    # Root mean square, in x and in y, of the random displacements that are added at the disc's edge.
    rim_irregularity_mm: NotNegative = 0.0
    # How much edge and random displacements differ between poses: they are functions of this share of the
    # tangents of the camera's turn. 0: they are the same in every pose.
    glass_change: NotNegative = 1.0
    glass_seed: Count = 1


@dataclass(frozen=True)
class ReticleTruth(Section):
    """Errors of the printed target."""

    # Distance by which the target stands towards the camera at ``bow_radius_mm`` from (x, y), compared with
    # (x, y). It grows with the square of the distance. Negative: away from the camera.
    bow_mm: Number = 0.0
    bow_radius_mm: Positive = 40.0  # Radius at which the bow is stated, mm
    # Relative error of the printed lengths: a printed length is (1 + print_scale) times the nominal one.
    print_scale: Number = 0.0
    # "positive": what is black on the print blocks the light; "negative": what is white does.
    polarity: Annotated[str, one_of(POLARITIES, "polarity")] = "positive"


@dataclass(frozen=True)
class OpticsTruth(Section):
    """Blur and illumination of the image, and the mounting of the camera on the gimbal."""

    psf_px: NotNegative = 0.7
    gradient_x: Number = 0.08  # Relative change of illumination over the disc's radius, along the target's x
    gradient_y: Number = -0.05  # The same along the target's y
    black: NotNegative = 0.01  # Light that passes the reticle's black segments, as a share of the white ones'
    stray: NotNegative = 0.0
    # Light of the room on the whole sensor, which does not flicker, nominal brightness = 1
    room: NotNegative = 0.0
    # Rotation vector of the camera on the gimbal at zero angles (R0 of the pose), degrees.
    mounting_deg: Vector = (0.31, -0.22, 0.45)


@dataclass(frozen=True)
class NoiseTruth(Section):
    """Fixed pattern and temporal noise of the pixels; what causes them: Hu, Liu and Delbruck (2021), v2e."""

    # Relative standard deviation of a pixel's contrast thresholds (fixed pattern)
    mismatch: NotNegative = 0.12
    background_hz: NotNegative = 1.0  # Mean rate of background events of a pixel
    hot_share: NotNegative = 2e-5  # Share of pixels that are hot
    hot_hz: NotNegative = 2000.0  # Rate of the events of a hot pixel
    # Standard deviation of the reference level after a reset, in units of log intensity.
    reset_noise: NotNegative = 0.01
    dead_share: NotNegative = 0.0  # Share of pixels that never fire


@dataclass(frozen=True)
class ThermalTruth(Section):
    """Temperature of the camera, and what depends on it by the `LAW`."""

    room_c: Number = 23.5  # Temperature of the room when the bench is switched on
    room_c_per_h: Number = 0.0  # Rate of change of the room's temperature
    self_heating_c: Number = 18.0  # Final temperature of the camera above the room
    warm_up_min: NotNegative = 0.0  # Time constant of its rise; 0: it is warm at once
    focal_ppm_per_c: Number = 0.0  # Relative change of the focal lengths, 1e-6 per degree


@dataclass(frozen=True)
class MountTruth(Section):
    """Place and motion of the camera's mount; see ``mount``."""

    vibration_arcsec: NotNegative = 0.0
    vibration_hz: NotNegative = 30.0
    drift_arcsec_per_min: Pair = (0.0, 0.0)
    # Displacement of the camera's entrance pupil across the beam, along the target's X and Y, mm; the disc of
    # light moves by the opposite amount.
    shift_mm: Pair = (0.0, 0.0)
    # How far the camera is turned in its mount, after the gimbal's axes: pan, tilt and roll, each in the
    # direction of the axis of that name.
    turn_deg: Vector = (0.0, 0.0, 0.0)


def _focus_distance(value: object) -> float:
    """Check a focus distance, m: infinite for parallel light, negative beyond infinity."""
    word = isinstance(value, str) and value.strip().lower() in {"infinity", "inf", ".inf"}
    metres = math.inf if word else value
    if isinstance(metres, bool) or not isinstance(metres, (int, float)):
        raise Wrong(f"A distance is expected, not {value!r}.", "Give metres, or the word infinity.")
    if metres == -math.inf or metres > sys.float_info.max:
        metres = math.inf  # the same focus
    if not (metres >= CLOSEST_M or metres <= BEYOND_M):
        raise Wrong(
            f"The focus ring does not reach {value!r} m.",
            f"Give at least {CLOSEST_M}, or infinity. Beyond infinity the ring goes to {BEYOND_M}.",
        )
    return float(metres)


def _delivered(value: object) -> object:
    return None if value == "pattern" else _focus_distance(value)


FocusDistance = Annotated[float, BeforeValidator(_focus_distance)]


@dataclass(frozen=True)
class LensTruth(Section):
    """Focus and aperture of the camera's lens."""

    # Distance of the plane in focus from the lens; infinite for parallel light; negative: beyond infinity.
    # None: as the bench is delivered. The lens is then focused on the pattern, and the focal lengths are
    # those of section ``camera``.
    focus_distance_m: Annotated[FocusDistance | None, BeforeValidator(_delivered)] = None
    f_number: FNumber = DELIVERED_F_NUMBER
    pixel_um: Positive = 4.86  # Side of a pixel


CAMERAS: Final[Mapping[str, CameraTruth]] = {
    "pinhole": CameraTruth(),
    "fisheye": CameraTruth(fx=1900.0, fy=1900.4, k1=-0.04, k2=0.012, k3=-0.003, projection="fisheye"),
}
"""Cameras by the projection of their lens."""

_LIKE_REAL: Final = CollimatorTruth(
    half_angle_deg=12.5,
    disc_y=5.0,
    disc_walk=(-44.0, -18.0),
    disc_wander_mm=8.5,
    disc_breathing=0.06,
    disc_unevenness=0.07,
    defocus=0.066,
    coma=0.084,
    astigmatism=-0.0105,
    field_curvature=-0.062,
    distortion=0.1085,
    rim_roll_mm=-0.415,
    irregularity_mm=0.0077,
    rim_irregularity_mm=0.032,
)

_STEADY_DISC: Final = replace(_LIKE_REAL, disc_wander_mm=0.0, disc_breathing=0.0)

COLLIMATORS: Final[Mapping[str, CollimatorTruth]] = {
    "ideal": CollimatorTruth(),
    "like-real": _LIKE_REAL,
    "like-bench": replace(
        _LIKE_REAL, disc_walk=(-2.0, -2.0), disc_wander_mm=0.05, disc_breathing=0.0, glass_change=0.0
    ),
    "S1": _LIKE_REAL,
    "S2": _STEADY_DISC,
    "S3": replace(_STEADY_DISC, disc_walk=(0.0, 0.0)),
}
"""Collimators by the name of their profile.

"like-real" has errors of the same size as the published recordings of a real collimator (camera of f = 2412 px,
20 views, 9000 stars), with the same discs and the same turns of the camera:

======================================  ===========  ============================
                                        recordings   profile (mean, 8 drawn)
======================================  ===========  ============================
rms, spherical model                    0.400 px     0.402 +- 0.010
rms, spherical model and field terms    0.209 px     0.227 +- 0.016
rms, a free centre for each view        0.227 px     0.234 +- 0.009
a view left out, the same three models  0.436 px,    0.442 +- 0.010,
                                        0.230,       0.264 +- 0.019,
                                        0.621        0.591 +- 0.038
free centres wander, x, y, z            0.64, 0.50,  0.67 +- 0.09, 0.49 +- 0.03,
                                        0.09 % of r  0.09 +- 0.01
... correlated with the disc's, x, y    0.96, 0.85   0.92 +- 0.06, 0.87 +- 0.04
squared error in the outer tenth        51 %         53 +- 2 %
f by free centres, by spherical model,  -2.0 %,      -2.0 +- 0.3,
against the field model's               +0.4 %       +0.1 +- 0.1
======================================  ===========  ============================

"S1" is "like-real" by another name. "S2" is the same with a disc that neither wanders nor breathes, and "S3" is "S2"
with the entrance pupil on the pivot. "like-bench" is the glass of "like-real" before a gimbal: the entrance pupil is
2 mm in front of the pivot and always looks through the same glass. ``docs/simulated-bench.md`` explains each parameter.
"""

NOISE_LEVELS: Final[Mapping[str, NoiseTruth]] = {
    "none": NoiseTruth(mismatch=0.0, background_hz=0.0, hot_share=0.0, hot_hz=0.0, reset_noise=0.0),
    "clean": NoiseTruth(mismatch=0.03, background_hz=0.1, hot_share=0.0, hot_hz=0.0, reset_noise=0.01),
    "typical": NoiseTruth(),
    "heavy": NoiseTruth(mismatch=0.25, background_hz=20.0, hot_share=5e-4, hot_hz=2000.0, reset_noise=0.03),
}
"""Noise levels by name; "typical" is the default."""


@dataclass(frozen=True)
class Truth:
    """All true parameters of the simulated world."""

    camera: CameraTruth = field(default_factory=CameraTruth)
    collimator: CollimatorTruth = field(default_factory=CollimatorTruth)
    optics: OpticsTruth = field(default_factory=OpticsTruth)
    noise: NoiseTruth = field(default_factory=NoiseTruth)
    thermal: ThermalTruth = field(default_factory=ThermalTruth)
    mount: MountTruth = field(default_factory=MountTruth)
    reticle: ReticleTruth = field(default_factory=ReticleTruth)
    gimbal: GimbalTruth = field(default_factory=GimbalTruth)  # Errors between readings and pointing
    target: StarTarget = field(default_factory=StarTarget)
    lens: LensTruth = field(default_factory=LensTruth)  # Focus and aperture of the camera's lens

    def to_dict(self) -> dict[str, Any]:
        """Return ``truth.json``'s content, by section, a fisheye's coefficients as kb1 to kb4."""
        values = dataclasses.asdict(self)
        values["thermal"]["law"] = dict(LAW)
        values["gimbal"] = self.gimbal.to_dict()
        if self.camera.projection == "fisheye":
            renamed = {"k1": "kb1", "k2": "kb2", "k3": "kb3", "k4": "kb4"}
            values["camera"] = {
                renamed.get(k, k): v for k, v in values["camera"].items() if k not in ("p1", "p2")
            }
        return values
