"""The world of strangers: collimators of `stranger_glass`, lenses of 8 to 85 mm and fisheyes, a gimbal with a worm.

A seed decides everything: the glass and its tolerances, the lens, how many poses and which, how many stars, the noise, and
whether a hand moves the camera. What the station states is drawn from the truth with the stated uncertainty; a certificate
states the focal length, as makers do (three of five), or the length that the camera sees. Half of them say which.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .bench import Bench, Camera, Seen, Stated
from .geometry import DEG, FISHEYE, SIZE, fisheye, turn
from .stranger_glass import DESIGNS, Collimator, Tolerances, collimator

Array = NDArray[np.float64]

PIXEL_MM = 0.00486
#: Focal length of the lens, mm; that of the collimator; the share of benches.
LENSES = ((8.0, 240.0, 0.2), (16.0, 250.0, 0.4), (35.0, 580.0, 0.25), (85.0, 1250.0, 0.15))
KINDS = ("grid", "grid", "grid", "clustered", "half filled", "rolled", "by hand")
POSES = (3, 3, 4, 6, 9, 9, 12, 15, 25)
#: Stars in view of a well filled image: few, as usual, many.
STARS = (45, 60, 250, 600)
_RING = np.array([[np.cos(a), np.sin(a)] for a in np.arange(6) * np.pi / 3]) / np.sqrt(2)


@dataclass(frozen=True)
class Lens:
    """A lens with Brown's terms to the eighth power and thin prisms, or a fisheye; its pupil moves with the field."""

    values: Mapping[str, float]
    pupil_radius_mm: float
    pupil_walk_mm: float  # along the axis, for each squared tangent of the field

    def image_of(self, rays: Array) -> Array:
        """Image points (N, 2) px of rays (N, 3)."""
        if "kb1" in self.values:
            return fisheye(self.values, rays)
        v = self.values
        x, y = (rays[:, :2] / rays[:, 2:]).T
        r2 = x * x + y * y
        radial = 1 + r2 * (v["k1"] + r2 * (v["k2"] + r2 * (v["k3"] + r2 * v["k4"])))
        u = x * radial + 2 * v["p1"] * x * y + v["p2"] * (r2 + 2 * x * x) + v["s1"] * r2
        w = y * radial + v["p1"] * (r2 + 2 * y * y) + 2 * v["p2"] * x * y + v["s3"] * r2
        return np.stack([v["fx"] * u + v["cx"], v["fy"] * w + v["cy"]], axis=1)


@dataclass(frozen=True)
class Gimbal:
    """Two axes with worms: scale, eccentricity, a wave of the worm, backlash, and noise."""

    scales: Array  # (2,)
    eccentric_deg: Array  # (2, 2) amplitudes and phases, rad
    worm_deg: Array  # (2, 2) amplitudes and phases, rad
    backlash_deg: Array  # (2,)
    noise_deg: float
    square_rad: float  # by which the axes are not perpendicular
    camera: Array  # (3, 3) camera <- body
    base: Array  # (3, 3) base <- collimator
    lever_mm: Array  # (3,) from the pivot to the pupil, body
    worm_period_deg: float = 2.0

    def pose(self, reading_deg: Array, came_from: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """The rotation (3, 3), camera <- collimator, and how far (3,) mm the pupil moved, collimator."""
        at = reading_deg * DEG
        true = self.scales * reading_deg + self.eccentric_deg[0] * np.sin(at + self.eccentric_deg[1])
        true += self.worm_deg[0] * np.sin(2 * np.pi * reading_deg / self.worm_period_deg + self.worm_deg[1])
        true += 0.5 * self.backlash_deg * came_from + self.noise_deg * rng.normal(size=2)
        pan = turn(np.array([0, -true[0] * DEG, 0]))
        tilt = turn(-true[1] * DEG * np.array([1, self.square_rad, 0]))
        body = pan @ tilt
        return self.camera @ body.T @ self.base, self.base.T @ (body @ self.lever_mm - self.lever_mm)


@dataclass(frozen=True)
class World:
    """What a seed draws before poses are taken."""

    glass: Collimator
    design: str
    lens: Lens
    gimbal: Gimbal
    pupil_mm: Array  # (3,) with both axes at 0, from the plane of the nominal pupil
    pitch_mm: float
    widest: float  # tangent at which the beam ends
    foot_mm: Array
    print_scale: Array
    kind: str
    noise: str
    star_px: float
    stated: Stated
    facts: dict[str, Any]


@lru_cache(maxsize=1)  # a bench is judged with several kinds of knowledge, one after the other
def draw(seed: int, poses: int = 0, times: int = 1, camera: int = 0) -> Bench:
    """Draw and record a bench; 0 poses: the seed decides how many."""
    world = _world(seed, camera)
    rng = np.random.default_rng((seed, 43, camera, poses, times))
    count = poses or int(rng.choice(POSES))
    ids, nominal = _print(world)
    on_axis = (nominal - world.foot_mm) * (1 + world.print_scale)
    views, readings = [], []
    came = np.zeros(2)
    for number, angles in enumerate(_angles(world, count, rng)):
        came = np.where(angles != came, np.sign(angles - came), 1.0)
        rotation, pupil = _placed(world, angles, came, rng)
        px, shown = _image(world, on_axis, rotation, pupil)
        views.append(_seen(world, f"pose {number + 1}", (ids[shown], nominal[shown], px), rng))
        readings.append({"pan_deg": float(angles[0]), "tilt_deg": float(angles[1])})
        came = angles
    fewest = min(len(view.ids) for view in views)
    facts = {**world.facts, "fewest": fewest, "count": count}
    values = world.lens.values
    true = Camera(values, "fisheye" if "kb1" in values else "p1p2k3", world.lens.image_of, exact=True)
    return Bench("stranger", views, readings, world.stated, true, facts)


def _world(seed: int, camera: int) -> World:
    rng, own = np.random.default_rng((seed, 41)), np.random.default_rng((seed, 42, camera))
    focal, efl, _ = LENSES[rng.choice(len(LENSES), p=[share for *_, share in LENSES])]
    design = str(rng.choice(list(DESIGNS)))
    kind, noise = str(rng.choice(KINDS)), str(own.choice(["equal", "unequal", "correlated"]))
    efl *= rng.uniform(0.96, 1.04)
    share = rng.normal(0, float(rng.choice([0.004, 0.03])))  # the target out of focus, of the focal length
    bow_mm = float(
        np.exp(rng.uniform(np.log(0.003), np.log(0.02)))
    )  # half width at 40 mm of a print for 250 mm
    bow = (
        bow_mm * rng.uniform(-1, 1) / 40.0**2 * (1 + rng.uniform(-0.4, 0.4) * np.array([1, -1])) / (efl / 250)
    )
    loose = Tolerances(slope_rad=float(np.exp(rng.uniform(np.log(2e-6), np.log(2e-5)))))
    glass = collimator(design, efl, rng, loose, (float(share), bow))
    lens = _lens(own, focal, bool(own.random() < (0.4 if focal == 8.0 else 0.1)))
    hand = kind in ("rolled", "by hand")
    lever = np.array([*own.normal(0, 1.0, 2), float(own.choice([0.0, 0.0, 3.0, -5.0, 10.0])) + own.normal()])
    gimbal = _gimbal(own, lever)
    pupil = np.array([*own.normal(0, 1.5, 2), own.normal(0, 5.0)])
    widest = DESIGNS[design][2]
    half = np.array(SIZE) / 2 * PIXEL_MM / focal
    area = 4 * np.minimum(half, widest).prod() * efl**2 * 0.9
    r, defocus = glass.radius_and_defocus(pupil[2])
    sigma = 2e-4 * efl
    certifies = str(rng.choice(["focal length"] * 3 + ["radius"] * 2))
    is_true = glass.efl_mm if certifies == "focal length" else r
    print_scale = 2e-5 * rng.uniform(-1, 1, 2) + 9e-6 * rng.normal()
    to_focus = float(glass.pupil_to_focus_mm - pupil[2])
    stated = Stated(
        float(is_true + sigma * rng.normal()),
        sigma,
        (float(defocus + 0.01 * rng.normal()), 0.01),
        (float(lever[2] + 0.5 * own.normal()), 0.5),
        reading_sigma_deg=0.002,
        bounded=not hand,
        print_bow_mm=bow_mm / (efl / 250),
        certifies=certifies,
        says_length=bool(np.random.default_rng((seed, 44)).random() < 0.5),
        pupil_to_focus_mm=(to_focus + 3.0 * float(rng.normal()), 3.0),
    )
    facts = {
        "f": lens.values["fx"],
        "design": design,
        "kind": kind,
        "by_hand": hand,
        "focal_mm": focal,
        "noise": noise,
        "certifies": certifies,
        "r": r,
        "efl": float(glass.efl_mm),
        "defocus": defocus,
        "pupil_to_focus_mm": to_focus,
    }
    star = float(np.exp(own.uniform(np.log(0.008), np.log(0.03))))
    pitch = float(np.sqrt(area / own.choice(STARS)))
    foot = rng.normal(0, 0.5, 2)
    return World(
        glass, design, lens, gimbal, pupil, pitch, widest, foot, print_scale, kind, noise, star, stated, facts
    )


def _lens(rng: np.random.Generator, focal: float, is_fisheye: bool) -> Lens:
    corner = float(np.hypot(*SIZE)) / 2 * PIXEL_MM / focal
    f = focal / PIXEL_MM * rng.uniform(0.985, 1.015)
    values = {
        "fx": f,
        "fy": f * (1 + 1e-4 * float(rng.normal())),
        "cx": float(rng.normal((SIZE[0] - 1) / 2, 8)),
        "cy": float(rng.normal((SIZE[1] - 1) / 2, 8)),
    }
    # Distortion at the corner: some per cent of a wide lens, a few thousandths of a long one; a third in each next power.
    size = {8.0: 0.06, 16.0: 0.02, 35.0: 0.008, 85.0: 0.004}[focal]
    parts = size * rng.normal(size=4) * np.array([1, 0.3, 0.1, 0.04])
    powers = parts / corner ** (2 * np.arange(1, 5))
    if is_fisheye:
        values |= dict(zip(FISHEYE, (powers * [1, 0.3, 0.3, 0.3]).tolist(), strict=True))
    else:
        names = ("k1", "k2", "k3", "k4")
        values |= dict(zip(names, powers.tolist(), strict=True))
        p1, p2, s1, s3 = (
            3e-4 * rng.normal(size=4) * np.array([1, 1, 0.3, 0.3]) * (16 / focal) ** 0.5
        ).tolist()
        values |= {"p1": p1, "p2": p2, "s1": s1, "s3": s3}
    return Lens(values, focal / float(rng.choice([4.0, 5.6, 8.0])) / 2, float(rng.normal(0, 0.15)) * focal)


def _gimbal(rng: np.random.Generator, lever: Array) -> Gimbal:
    """Errors of a reading add up to .002 degrees (rms), as the station states."""
    roll = float(rng.choice([0.0, 0.0, 8.0, 35.0, 90.0]))
    phases = rng.uniform(0, 2 * np.pi, (2, 2))
    return Gimbal(
        1 + 2e-4 * rng.normal(size=2),
        np.stack([0.001 * rng.normal(size=2), phases[0]]),
        np.stack([0.0016 * np.ones(2), phases[1]]),
        np.full(2, 0.0018),
        0.0013,
        2e-4 * float(rng.normal()),
        turn(DEG * rng.normal((0, 0, roll), 0.5)),
        turn(DEG * rng.normal((0, 0, float(rng.choice([0.0, 5.0, -10.0]))), 0.5)),
        lever,
    )


def _angles(world: World, count: int, rng: np.random.Generator) -> Array:
    """Pan and tilt (count, 2) deg; the disc moves over the image, and never leaves it."""
    half = np.array(SIZE) / 2 * PIXEL_MM / float(world.facts["focal_mm"])
    span = np.degrees(np.arctan(np.minimum(0.55 * half, 0.75 * world.widest + 0.1 * half)))
    columns = int(np.ceil(np.sqrt(count * 1.3)))
    rows = int(np.ceil(count / columns))
    columns_at, rows_at = np.linspace(-1, 1, max(columns, 2)), np.linspace(-1, 1, max(rows, 2))
    grid = np.array([(p, t) for t in rows_at for p in columns_at])
    chosen = grid[rng.permutation(len(grid))[:count]] if count < len(grid) else grid[:count]
    if count == 3:
        chosen = np.array([(-1.0, 0.6), (1.0, 0.6), (0.0, -1.0)])
    if world.kind == "clustered":
        chosen = chosen * 0.2
    if world.kind == "half filled":
        chosen = np.column_stack([0.35 * chosen[:, 0] + 1.0 * rng.choice([-1, 1]), chosen[:, 1]])
    return np.asarray(np.round((chosen + 0.04 * rng.normal(size=chosen.shape)) * span, 2))


def _placed(world: World, angles: Array, came: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """The rotation (3, 3), camera <- collimator, and the pupil (3,) mm of a pose."""
    rotation, moved = world.gimbal.pose(angles, came, rng)
    if world.kind == "rolled":
        rotation = turn(np.array([0, 0, rng.uniform(0, 2 * np.pi)])) @ rotation
    if world.kind in ("rolled", "by hand"):
        rotation = turn(DEG * rng.normal(0, 0.3, 3)) @ rotation
        moved = rng.normal(0, 3.0 if world.kind == "rolled" else 5.0, 3).clip(-9, 9)
    return rotation, world.pupil_mm + moved


def _print(world: World) -> tuple[NDArray[np.int64], Array]:
    """Ids and nominal places (N, 2) mm of all stars that the beam may show."""
    reach = int(np.ceil(1.15 * world.widest * world.glass.efl_mm / world.pitch_mm))
    steps = np.arange(-reach, reach + 1) * world.pitch_mm
    x, y = np.meshgrid(steps, steps)
    return np.arange(x.size), np.stack([x.ravel(), y.ravel()], axis=1)


def _image(world: World, print_mm: Array, rotation: Array, pupil: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Image points (M, 2) px, the middle of the rays that the pupil admits, and which stars (N,) are lit and in view."""
    glass, axis = world.glass, rotation[2]
    rough = np.column_stack([print_mm / glass.efl_mm, np.ones(len(print_mm))])
    field = rough @ rotation.T
    # Far outside of the image, the polynomials of a lens fold back into it.
    corner = 0.5 * np.hypot(*SIZE) * PIXEL_MM / float(world.facts["focal_mm"])
    seen = (field[:, 2] > 0.5) & (np.hypot(*field[:, :2].T) < 1.2 * corner * np.abs(field[:, 2]))
    lit = seen & (np.hypot(*rough[:, :2].T) < world.widest)
    near = np.zeros(len(lit), np.bool_)
    near[lit] = _inside(world.lens.image_of(field[lit]), -60.0)
    square = (field[near, :2] ** 2).sum(axis=1) / field[near, 2] ** 2
    places = pupil + world.lens.pupil_walk_mm * square[:, None] * axis
    chief = glass.tangents(places, print_mm[near])
    px = np.zeros((len(chief), 2))
    across = rotation[:2]
    for ring in _RING * world.lens.pupil_radius_mm:
        tangents = glass.tangents(places + ring @ across, print_mm[near], chief)
        px += world.lens.image_of(np.column_stack([tangents, np.ones(len(px))]) @ rotation.T) / len(_RING)
    shown = near.copy()
    inside = _inside(px, 12.0)
    shown[near] = inside
    return px[inside], shown


def _inside(px: Array, border: float) -> NDArray[np.bool_]:
    return np.asarray(((px > border) & (px < np.array(SIZE) - 1 - border)).all(axis=1))


def _seen(
    world: World, name: str, stars: tuple[NDArray[np.int64], Array, Array], rng: np.random.Generator
) -> Seen:
    """The stars with noise; stated is what a detector would state, right to a tenth."""
    ids, mm, px = stars
    sigma = np.full(len(ids), world.star_px)
    if world.noise == "unequal":
        sigma = sigma * np.exp(0.5 * rng.normal(size=len(ids)))
    noise = rng.normal(size=px.shape)
    if world.noise == "correlated":
        # waves of some hundred pixels carry a third of the variance
        waves = rng.normal(0, 1 / 120.0, (24, 2, 2))
        phases = rng.uniform(0, 2 * np.pi, (24, 2))
        smooth = np.sqrt(2 / 24) * np.cos(np.einsum("ni,wij->nwj", px, waves) + phases).sum(axis=1)
        noise = np.sqrt(2 / 3) * noise + np.sqrt(1 / 3) * smooth
    stated = sigma * np.exp(0.1 * rng.normal())
    return Seen(name, ids, px + sigma[:, None] * noise, mm, stated)
