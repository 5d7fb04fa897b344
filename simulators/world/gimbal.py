"""Errors of the gimbal: where the camera really points when the axes read certain angles.

With the reading a of an axis, the true angle is

    a' = (1 + scale) a + eccentricity (sin(a + phase) - sin(phase)) + noise(a)

The axis itself tilts by a small angle that depends on a (wobble), and the tilt axis is not square to the pan axis. The
rotation camera <- target is

    R = M Rz(roll') Wroll Ru(tilt') Wtilt Ry(pan') Wpan R0

with u = (cos n, -sin n, 0), n the non-orthogonality, and M the camera on its head. Apart from the noise, all errors are
zero at the readings 0. Errors of an encoder and of bearings are described so in ISO 230-7 and by Slocum, Precision
Machine Design (1992); their size and random numbers are this project's own.

The backlash acts in the gear, before these errors; see `Gears`. This module uses no devices and no optics.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator

from simulators.reading import Count, NotNegative, Number, Section, Vector, Wrong, number

FloatArray = NDArray[np.float64]

AXES: Final = ("pan", "tilt", "roll")

LAW: Final[Mapping[str, str]] = {
    "true angle": "(1 + scale) a + eccentricity_deg (sin(a + phase) - sin(phase)) + noise(a), a the load's angle",
    "load's angle": "reading -+ backlash_deg / 2, behind the motor on the side that the load came from",
    "wobble": "each of two tilts: w(a) - w(0), w = sqrt(2) wobble_deg (first sin(a + first phase) "
    "+ second sin(2 a + second phase))",
    "rotation": "camera <- target = M Rz(roll) Wroll Ru(tilt) Wtilt Ry(pan) Wpan R0, "
    "u = (cos n, -sin n, 0), n = nonorthogonality_deg, M = camera_on_head_deg, R0 = optics.mounting_deg",
}
"""Equations of the gimbal's errors, as ``truth.json`` holds them."""

NOISE_STEP_DEG: Final = 0.02
"""Distance of readings beyond which their errors are independent."""
_STREAM: Final = 2  # Of random numbers, apart from those of other parts of the world

_LARGEST_SCALE: Final = 0.2
"""Largest relative error of an axis's scale; larger numbers are factors that were given by mistake."""
_TILTED_ABOUT: Final = ((0, 2), (1, 2), (0, 1))
"""For pan (y), tilt (x) and roll (z): the two other directions."""


def _by_axis(value: object) -> tuple[float, ...]:
    """Return three numbers, for pan, tilt and roll, from one number or from a mapping by axis."""
    if not isinstance(value, Mapping):
        return (number(value),) * len(AXES)
    for name in value:
        if name not in AXES:
            raise Wrong("Unknown axis.", f"Known are: {', '.join(AXES)}.", f".{name}")
    return tuple(number(value.get(name, 0.0), f".{name}") for name in AXES)


def _backlash(value: object) -> tuple[float, ...]:
    plays = _by_axis(value)
    for name, play in zip(AXES, plays, strict=True):
        if play < 0.0:
            raise Wrong(f"{play!r} is negative.", "Give a number of at least 0.", f".{name}")
    return plays


def _scale(value: object) -> tuple[float, ...]:
    scales = _by_axis(value)
    for name, scale in zip(AXES, scales, strict=True):
        if abs(scale) > _LARGEST_SCALE:
            remedy = "Give the relative error: 0.001 turns 6 degrees into 6.006."
            raise Wrong(f"{scale!r} is no small error of a scale.", remedy, f".{name}")
    return scales


@dataclass(frozen=True)
class GimbalTruth(Section):
    """Errors between the readings of the axes and the direction in which the camera points."""

    # Tilt of each axis about each of the two other directions, root mean square over a turn, degrees.
    wobble_deg: NotNegative = 0.0
    eccentricity_deg: NotNegative = 0.0  # Amplitude of each encoder's error of one period a turn, degrees
    # Relative errors of the scales of pan, tilt and roll: the true angle is (1 + scale) times the reading.
    scale: Annotated[Vector, BeforeValidator(_scale)] = (0.0, 0.0, 0.0)
    # Play of the gears of pan, tilt and roll, degrees.
    backlash_deg: Annotated[Vector, BeforeValidator(_backlash)] = (0.0, 0.0, 0.0)
    nonorthogonality_deg: Number = 0.0  # Angle between tilt axis and pan axis, minus 90 degrees
    # Standard deviation of the readings' errors, degrees. The same reading always has the same error.
    reading_sigma_deg: NotNegative = 0.0
    # Rotation vector of the camera on the last axis (M), degrees.
    camera_on_head_deg: Vector = (0.0, 0.0, 0.0)
    seed: Count = 0  # Seed of the phases, the wobble and the readings' errors; 0: the bench's seed

    def to_dict(self) -> dict[str, Any]:
        """Return errors by name (``scale``, ``backlash_deg`` by axis), random numbers and law, for ``truth.json``."""
        return {
            **vars(self),
            "scale": dict(zip(AXES, self.scale, strict=True)),
            "backlash_deg": dict(zip(AXES, self.backlash_deg, strict=True)),
            "drawn": {
                name: {
                    "phase_deg": math.degrees(drawn.phase),
                    "wobble": [
                        {
                            "first": first,
                            "first_phase_deg": math.degrees(first_phase),
                            "second": second,
                            "second_phase_deg": math.degrees(second_phase),
                        }
                        for first, first_phase, second, second_phase in drawn.wobble
                    ],
                }
                for name, drawn in zip(AXES, drawn_errors(self.seed), strict=True)
            },
            "law": dict(LAW),
        }


class DrawnErrors(NamedTuple):
    """Random numbers of one axis."""

    phase: float  # Phase of the encoder's error of one period a turn, radians
    # For each of the two tilts of the axis: share and phase (radians) of one period a turn, then of two
    # periods. The squares of the two shares add up to 1.
    wobble: tuple[tuple[float, float, float, float], ...]


@lru_cache(maxsize=64)
def drawn_errors(seed: int) -> tuple[DrawnErrors, DrawnErrors, DrawnErrors]:
    """Return the random numbers of pan, tilt and roll."""
    rng = np.random.default_rng((seed, _STREAM))

    def drawn_axis() -> DrawnErrors:
        phase, *rest = rng.uniform(0.0, 2.0 * math.pi, 7).tolist()
        wobble = tuple(
            (math.cos(mix), first, math.sin(mix), second) for mix, first, second in (rest[:3], rest[3:])
        )
        return DrawnErrors(phase, wobble)

    return drawn_axis(), drawn_axis(), drawn_axis()


def true_angles_deg(angles_deg: Mapping[Any, float], gimbal: GimbalTruth) -> tuple[float, float, float]:
    """Return the true pan, tilt and roll, degrees, of loads that are read at these angles; missing = 0.

    Own model; the head of the module has the equation.

    >>> round(true_angles_deg({"pan": 6.0}, GimbalTruth(scale=(0.001, 0.0, 0.0)))[0], 9)
    6.006
    """
    pan, tilt, roll = (_true_angle_deg(angles_deg.get(name, 0.0), k, gimbal) for k, name in enumerate(AXES))
    return pan, tilt, roll


def _true_angle_deg(angle_deg: float, axis: int, gimbal: GimbalTruth) -> float:
    """Return the true angle of one axis, by its index.

    Own model: (1 + scale) a + eccentricity (sin(a + phase) - sin(phase)) + noise, for a reading a.
    """
    phase = drawn_errors(gimbal.seed)[axis].phase
    turned = math.sin(math.radians(angle_deg) + phase) - math.sin(phase)
    noise = (
        gimbal.reading_sigma_deg * _noise(angle_deg, axis, gimbal.seed) if gimbal.reading_sigma_deg else 0.0
    )
    return (1.0 + gimbal.scale[axis]) * angle_deg + gimbal.eccentricity_deg * turned + noise


def _noise(angle_deg: float, axis: int, seed: int) -> float:
    """Return a continuous random function of an angle, of variance 1 everywhere.

    Own model: independent normal numbers at multiples of `NOISE_STEP_DEG`; between two of them, both with weights
    whose squares add up to 1.
    """
    place = angle_deg / NOISE_STEP_DEG
    knot = math.floor(place)
    between = 0.5 * math.pi * (place - knot)
    return math.cos(between) * _knot(seed, axis, knot) + math.sin(between) * _knot(seed, axis, knot + 1)


@lru_cache(maxsize=4096)
def _knot(seed: int, axis: int, knot: int) -> float:
    """Return the normal number of a knot; seeds must not be negative, so knots are counted from far below."""
    return float(np.random.default_rng((seed, _STREAM, axis, knot + 2**40)).standard_normal())


def gimbal_rotation(angles_deg: Mapping[Any, float], gimbal: GimbalTruth) -> FloatArray:
    """Return the rotation of the camera by the gimbal: R R0^T of the head; Rz(roll) Rx(tilt) Ry(pan) without errors.

    Angles of the loads as read: "pan" about y, "tilt" about x and "roll" about z; missing = 0. Rotations about the
    axes: Diebel (2006). Errors: own model.
    """
    pan, tilt, roll = (math.radians(angle) for angle in true_angles_deg(angles_deg, gimbal))
    skew = math.radians(gimbal.nonorthogonality_deg)
    rotation = rotation_matrix((0.0, 0.0, roll)) @ _wobble(angles_deg, 2, gimbal)
    rotation = rotation @ rotation_matrix((tilt * math.cos(skew), -tilt * math.sin(skew), 0.0))
    rotation = rotation @ _wobble(angles_deg, 1, gimbal)
    rotation = rotation @ rotation_matrix((0.0, pan, 0.0)) @ _wobble(angles_deg, 0, gimbal)
    return rotation_matrix(np.radians(gimbal.camera_on_head_deg)) @ rotation


def _wobble(angles_deg: Mapping[Any, float], axis: int, gimbal: GimbalTruth) -> FloatArray:
    """Return the rotation by which an axis tilts at its reading: own model of one and two periods a turn, 0 at 0."""
    tilt = [0.0, 0.0, 0.0]
    a = math.radians(angles_deg.get(AXES[axis], 0.0))
    size = math.sqrt(2.0) * math.radians(gimbal.wobble_deg)
    for direction, (first, phase, second, other) in zip(
        _TILTED_ABOUT[axis], drawn_errors(gimbal.seed)[axis].wobble, strict=True
    ):
        tilt[direction] = size * (
            first * (math.sin(a + phase) - math.sin(phase))
            + second * (math.sin(2.0 * a + other) - math.sin(other))
        )
    return rotation_matrix(tilt)


def rotation_matrix(rotation_vector: FloatArray | tuple[float, float, float] | list[float]) -> FloatArray:
    """Return the rotation matrix of a rotation vector, (3,) radians (Rodrigues' formula; Diebel 2006)."""
    x, y, z = (float(v) for v in rotation_vector)
    angle = math.sqrt(x * x + y * y + z * z)
    if angle == 0.0:
        return np.eye(3)
    k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]) / angle
    return np.eye(3) + math.sin(angle) * k + (1.0 - math.cos(angle)) * (k @ k)


class Gears:
    """Gears with play. Own rule: a load stands half of the play behind its motor, on the side that it came from."""

    def __init__(self, gimbal: GimbalTruth) -> None:
        self._play_deg = dict(zip(AXES, gimbal.backlash_deg, strict=True))
        self._read_deg: dict[str, float] = {}
        self._sides: dict[str, float] = {}  # Direction of each axis's last motion: +1 or -1

    def load_angles_deg(self, angles_deg: Mapping[str, float]) -> dict[str, float]:
        """Return the angles of the loads by axis, which came from the angles given before; at first from 0."""
        for name, angle in angles_deg.items():
            if way := angle - self._read_deg.get(name, 0.0):
                self._sides[name] = math.copysign(1.0, way)
        self._read_deg = dict(angles_deg)
        return {
            name: angle - 0.5 * self._play_deg.get(name, 0.0) * self._sides.get(name, 0.0)
            for name, angle in angles_deg.items()
        }
