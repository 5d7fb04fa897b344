"""World 1: a collimator whose errors are polynomials of field and pupil, with a smooth irregular glass.

Sizes are those of a real collimator (distortion .11, coma .08, field curvature .06, defocus .07 times .2 to 1.2), each
with a random sign. Target frame in mm: a star at P is seen in the direction (P + d(P) - c, r), where d are the errors.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .bench import Bench, Camera, Pose, Stated, named_poses, noisy_view, pose_key
from .geometry import COLUMNS, DEG, PITCH_MM, ROWS, SIZE, printed_stars, turn

Array = NDArray[np.float64]

#: Sizes of the errors of a real collimator, as shares of r at a tangent of 1.
LEVELS = {
    "defocus": 0.066,
    "coma": 0.084,
    "astigmatism": 0.0105,
    "curvature": 0.062,
    "distortion": 0.1085,
    "fifth": 0.4,
}
HALF_ANGLE_DEG = 12.5
BOW_RADIUS_MM = 40.0
#: How far the pupil of a camera that nobody moved to the pivot is from it.
FAR_MM = (20.0, 50.0)
FAMILIES = ("k1k2", "p1p2k3", "k1k2", "p1p2k3", "fisheye")
SEEDS = [seed for seed in range(100) if FAMILIES[seed % len(FAMILIES)] == "k1k2"]
"""Seeds whose lens needs k1 and k2 only."""


@dataclass(frozen=True)
class Waves:
    """A smooth random field: a sum of plane waves over tangents, with unit mean square along each axis."""

    numbers: Array  # (M, 2) cycles per unit tangent
    phases: Array  # (M, 2) of each wave along each axis
    sizes: Array  # (M, 2)

    @classmethod
    def draw(cls, rng: np.random.Generator, count: int, across: tuple[float, float]) -> Waves:
        """Draw waves with so many cycles across the beam."""
        width = 2 * np.tan(HALF_ANGLE_DEG * DEG)
        lengths, angle = rng.uniform(*across, count) / width, rng.uniform(0, 2 * np.pi, count)
        numbers = lengths[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        phases, sizes = rng.uniform(0, 2 * np.pi, (count, 2)), rng.normal(size=(count, 2))
        return cls(numbers, phases, sizes / np.sqrt(count / 2))

    def at(self, tangents: Array) -> Array:
        """The field (N, 2) at tangents (N, 2)."""
        angle = 2 * np.pi * tangents @ self.numbers.T
        return np.sum(self.sizes * np.sin(angle[:, :, None] + self.phases), axis=1)


@dataclass(frozen=True)
class Glass:
    """A collimator and the print in it."""

    r: float
    foot_mm: Array  # where the axis meets the print
    terms: Mapping[str, float]  # by the names of LEVELS
    decentring: Array  # (2,) tangential distortion, as p2 and p1 of a lens
    roll_off_mm: float  # at the rim of the beam
    waves: Waves
    waves_mm: float
    bow_mm: float  # height at BOW_RADIUS_MM
    print_scale: Array  # (2,) relative, along each axis

    def seen_mm(self, nominal_mm: Array, pupil: Array, along: float = 0.0) -> tuple[Array, Array]:
        """Where the stars appear (N, 2) on the nominal plane, and their distance (N,) from the disc in its radii.

        pupil: (2,) middle of the visible disc from the foot of the axis, as a share of r; ``along``: how far the pupil
        has moved along the axis, too: a ray then meets the glass elsewhere, in proportion to its tangent.
        """
        print_mm = nominal_mm * (1 + self.print_scale)
        h = (print_mm - self.foot_mm) / self.r
        place = pupil + along * h
        pairs = ((h, h), (h, place), (place, place))
        hh, hb, bb = ((first * other).sum(axis=1, keepdims=True) for first, other in pairs)
        t = self.terms
        by_pupil = (t["defocus"] + 2 * t["coma"] * hb + 2 * t["curvature"] * hh) * place
        by_field = (
            t["coma"] * bb + 2 * t["astigmatism"] * hb + t["distortion"] * hh + t["fifth"] * hh**2
        ) * h
        decentred = hh * self.decentring + 2 * (h @ self.decentring)[:, None] * h
        bow = self.bow_mm * (self.r / BOW_RADIUS_MM) ** 2 / self.r * hh * h
        rim = np.tan(HALF_ANGLE_DEG * DEG)
        in_rims = (h - pupil) / rim
        rho = np.linalg.norm(in_rims, axis=1, keepdims=True)
        roll = self.roll_off_mm * np.minimum(rho, 1.2) ** 3 * in_rims
        field = self.r * (by_pupil + by_field + decentred + bow) + roll
        # The glass is a lens: where a ray meets it depends on its direction and on the pupil's place.
        return print_mm + field + self.waves_mm * self.waves.at(h - place), rho[:, 0]


@dataclass(frozen=True)
class Gimbal:
    """Errors of a gimbal that turns the camera by pan, then tilt."""

    camera: Array  # (3, 3) camera <- head
    base: Array  # (3, 3) base <- target
    scales: Array  # (2,) true angle over reading
    squareness: float  # rad
    eccentricity_deg: float
    phases: Array  # (6,) of eccentricities and wobbles
    wobble_deg: float

    def rotation(self, reading_deg: Array, noise_deg: Array) -> Array:
        """Return the (3, 3) rotation, camera <- target, when the axes read these angles (2,)."""
        a = reading_deg * DEG
        pan, tilt = (
            self.scales * reading_deg + noise_deg + self.eccentricity_deg * self._swing(a, self.phases[:2])
        )
        lean_pan, lean_tilt = self.wobble_deg * self._swing(a, self.phases[2:4])
        roll_pan, roll_tilt = self.wobble_deg * self._swing(2 * a, self.phases[4:])
        about_x = np.array([np.cos(self.squareness), -np.sin(self.squareness), 0.0])
        by_tilt = turn(DEG * np.array([0.0, lean_tilt, roll_tilt])) @ turn(DEG * tilt * about_x)
        by_pan = turn(DEG * np.array([lean_pan, 0.0, roll_pan])) @ turn(DEG * np.array([0.0, pan, 0.0]))
        return np.asarray(self.camera @ by_tilt @ by_pan @ self.base)

    @staticmethod
    def _swing(angles: Array, phases: Array) -> Array:
        return np.sin(angles + phases) - np.sin(phases)


@dataclass(frozen=True)
class Mount:
    """Where the entrance pupil looks through the beam."""

    off_pivot_mm: float
    aside_mm: Array  # (2,) of the disc with the camera straight
    beside_mm: Array  # (2,) of the pupil from the axes that turn it: when they turn, it moves along the axis
    wander_mm: float = 0.0  # of the pupil from pose to pose, along each axis; a mount moved by hand


@dataclass(frozen=True)
class World:
    """All that a seed draws before poses are taken."""

    camera: Camera
    glass: Glass
    gimbal: Gimbal
    mount: Mount
    stated: Stated
    star_px: float
    stated_px: float
    pose_field_px: float
    bad_share: float
    facts: dict[str, Any]


def draw_world(seed: int, kind: str = "real", other_camera: int = 0) -> World:
    """Draw a bench before its poses.

    kind: ``real``; ``far`` has a pupil far off the pivot; ``ideal`` has no errors but noise, readings and a certificate;
      ``S1`` and ``S2`` have a mount that is moved by hand.
    other_camera: Another number draws another camera and mounting before the same glass.
    """
    rng = np.random.default_rng((seed, 1))
    drawn = rng.uniform(0.2, 1.2)
    size = {"real": drawn, "far": drawn, "ideal": 0.0}.get(kind, 1.0)
    stated, draws = _stated(rng, kind)
    glass = _glass(rng, size, kind, draws)
    own = np.random.default_rng((seed, 2, other_camera))
    family = "k1k2" if kind == "ideal" else FAMILIES[(seed + other_camera) % len(FAMILIES)]
    camera = draw_camera(own, family)
    gimbal = _gimbal(own, draws)
    mount = _mount(own, kind, np.random.default_rng((seed, 5, other_camera)).normal(0, 2, 2))
    star = float(own.uniform(0.01, 0.02))
    sigma_defocus = 0.002 if kind == "ideal" else max(0.002, 0.15 * LEVELS["defocus"] * size)
    stated = replace(
        stated,
        r_mm=float(glass.r + stated.r_sigma_mm * draws["certificate"]),
        defocus=(float(glass.terms["defocus"] + sigma_defocus * draws["defocus"]), float(sigma_defocus)),
        off_pivot_mm=(float(mount.off_pivot_mm + 0.5 * draws["pupil"]), 0.5),
    )
    pose_px = 0.0 if kind == "ideal" else float(np.exp(own.uniform(np.log(0.003), np.log(0.05))))
    facts = {"f": camera.values["fx"], "size": float(size), "star_px": star, "pose_px": pose_px, "r": glass.r}
    stated_px = star if kind == "ideal" else float(star * np.exp(0.1 * own.normal()))
    bad = 0.0 if kind == "ideal" else 0.005
    return World(camera, glass, gimbal, mount, stated, star, stated_px, pose_px, bad, facts)


def _stated(rng: np.random.Generator, kind: str) -> tuple[Stated, dict[str, Any]]:
    """Draw how certain the statements are, and by how many sigmas the truth differs from each."""
    by_hand = kind in ("S1", "S2")
    stated = Stated(
        0.0,
        float(rng.uniform(0.03, 0.1)),
        (0.0, 0.0),
        (0.0, 0.0),
        bounded=not by_hand,
        print_bow_mm=float(np.exp(rng.uniform(np.log(0.005), np.log(0.02)))),
    )
    names = ("certificate", "defocus", "pupil", "thermal", "skew")
    draws: dict[str, Any] = dict(zip(names, rng.normal(size=len(names)).tolist(), strict=True))
    draws["scales"] = rng.normal(size=2)
    draws["print"] = stated.print_scale * rng.uniform(-1, 1) + stated.thermal * draws["thermal"]
    draws["bow"] = stated.print_bow_mm * rng.uniform(-1, 1)
    return stated, draws


def _glass(rng: np.random.Generator, size: float, kind: str, draws: Mapping[str, Any]) -> Glass:
    r = float(rng.uniform(250, 260))
    signs, shares = rng.choice([-1.0, 1.0], len(LEVELS) + 1), rng.uniform(0.5, 1.5, len(LEVELS))
    drawn = zip(LEVELS, signs[:-1], shares, strict=True)
    terms = {name: float(size * LEVELS[name] * s * a) for name, s, a in drawn}
    middle = np.array([(COLUMNS - 1) / 2, (ROWS - 1) / 2]) * PITCH_MM
    angle, strength = rng.uniform(0, 2 * np.pi), np.exp(rng.uniform(np.log(1e-4), np.log(1e-3)))
    real = kind != "ideal"
    return Glass(
        r,
        middle + rng.normal(0, 0.5, 2),
        terms,
        real * strength * np.array([np.cos(angle), np.sin(angle)]),
        float(size * 0.415 * signs[-1] * rng.uniform(0.3, 1.2)),
        Waves.draw(rng, 12, (0.4, 2.5)),
        float(size * 0.0077 * rng.uniform(0.5, 1.5)),
        real * draws["bow"],
        np.full(2, draws["print"]),
    )


def draw_camera(rng: np.random.Generator, family: str) -> Camera:
    """Draw a camera with a lens of a family: the same distortion at the corner, in px, for all focal lengths."""
    f = float(rng.uniform(2150, 4800))
    wide = f / 3345.0
    values = {
        "fx": f,
        "fy": f * (1 + 1e-4 * float(rng.normal())),
        "cx": float(rng.normal((SIZE[0] - 1) / 2, 8)),
        "cy": float(rng.normal((SIZE[1] - 1) / 2, 8)),
    }
    first, second, third, p1, p2 = rng.normal(size=5).tolist()
    if family == "fisheye":
        kb = (0.08 * wide**2 * first, 0.6 * wide**4 * second, 2.0 * wide**6 * third, 0.0)
        values |= dict(zip(("kb1", "kb2", "kb3", "kb4"), kb, strict=True))
    else:
        values |= {"k1": 0.08 * wide**2 * first, "k2": 0.6 * wide**4 * second}
    if family == "p1p2k3":
        values |= {"p1": 5e-4 * p1, "p2": 5e-4 * p2, "k3": 3.0 * wide**6 * third}
    return Camera(values, family)


def _gimbal(rng: np.random.Generator, draws: Mapping[str, Any]) -> Gimbal:
    return Gimbal(
        turn(DEG * rng.normal(0, 1, 3)),
        turn(DEG * rng.normal((0, 0, 10.0), 0.3)),
        1 + 2e-4 * draws["scales"],
        0.02 * DEG * draws["skew"],
        0.001,
        rng.uniform(0, 2 * np.pi, 6),
        0.0014,
    )


def _mount(rng: np.random.Generator, kind: str, beside_mm: Array) -> Mount:
    off, aside = float(rng.normal(0, 3)), rng.normal(0, 4, 2)
    if kind == "far":
        off = float(rng.choice([-1, 1]) * rng.uniform(*FAR_MM))
    if kind in ("S1", "S2"):
        return Mount(float(44 * rng.choice([-1, 1])), aside, beside_mm, 8.5 if kind == "S1" else 0.0)
    real = float(kind != "ideal")
    return Mount(real * off, real * aside, real * beside_mm)


def record(
    world: World,
    seed: int,
    poses: Sequence[Pose],
    times: int = 1,
    other_camera: int = 0,
    changed: Callable[[int, World], World] = lambda _, same: same,
) -> Bench:
    """Record poses with a drawn bench; what a pose draws does not depend on the poses beside it.

    changed: The world at a recording, counted from 0, for what drifts or is moved.
    """
    stated, camera, facts = world.stated, world.camera, world.facts
    ids, nominal = printed_stars()
    views, readings = [], []
    for number, (name, pose, again) in enumerate(named_poses(poses, times)):
        now = changed(number, world)
        lasting = np.random.default_rng((seed, 3, other_camera, *pose_key(pose)))
        fresh = np.random.default_rng((seed, 4, other_camera, *pose_key(pose), again))
        rotation = now.gimbal.rotation(np.array(pose, float), 0.002 * lasting.normal(size=2))
        axis = rotation[2, :2]
        wander = now.mount.wander_mm * lasting.normal(size=3)
        pupil = (now.mount.aside_mm + wander[:2] - now.mount.off_pivot_mm * axis) / now.glass.r
        along = wander[2] + now.mount.beside_mm @ axis + now.mount.off_pivot_mm * (rotation[2, 2] - 1.0)
        seen, rho = now.glass.seen_mm(nominal, pupil, along / now.glass.r)
        h = (seen - now.glass.foot_mm) / now.glass.r
        own = Waves.draw(lasting, 6, (0.2, 1.2)).at(h) * now.pose_field_px / now.camera.values["fx"]
        rays = np.column_stack([h + own, np.ones(len(h))]) @ rotation.T
        lit = (rho < 0.95) & (rays[:, 2] > 0.5)
        stars = ids[lit], nominal[lit], now.camera.project(rays[lit])
        views.append(noisy_view(name, stars, now.star_px, now.stated_px, now.bad_share, fresh))
        readings.append({"pan_deg": float(pose[0]), "tilt_deg": float(pose[1])})
    return Bench("polynomial", views, readings, stated, camera, {**facts, "times": times})
