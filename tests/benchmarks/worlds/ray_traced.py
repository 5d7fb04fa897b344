"""World 2: rays through misaligned lenses before a bowed print, a camera with a lens of its own, a gimbal of screws.

No error is a polynomial. Aberrations are those of the glass; the star's image is the middle of the bundle of rays that
the camera's entrance pupil admits; parallax comes from the pupil's real way when the axes turn, which do not meet.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .bench import Bench, Camera, Pose, Stated, named_poses, noisy_view, pose_key
from .geometry import COLUMNS, DEG, PITCH_MM, ROWS, SIZE, printed_stars, turn
from .lens_system import Bumps, LensSystem, Surface, focal_and_back_mm
from .polynomial import FAR_MM

Array = NDArray[np.float64]

HALF_ANGLE_DEG = 12.5
FAMILIES = ("k1k2", "p1p2k3", "p1p2k3", "k1k2", "fisheye")
#: Six rays whose mean and mean square are those of a full pupil of radius 1.
_RING = np.array([[np.cos(a), np.sin(a)] for a in np.arange(6) * np.pi / 3]) / np.sqrt(2)
_RINGS = np.arange(1, 9) / 8.0


@dataclass(frozen=True)
class Screws:
    """A gimbal as two axes in space that need not meet: the body turns about pan, and tilt turns with it."""

    axes: Array  # (2, 3) directions of pan and tilt at rest, base frame
    apart_mm: Array  # (3,) from the pan axis to the tilt axis
    arm_mm: Array  # (3,) from the tilt axis to the entrance pupil
    camera: Array  # (3, 3) camera <- body
    base: Array  # (3, 3) base <- collimator
    scales: Array  # (2,) true angle over reading
    encoder_deg: Array  # (2, 2) amplitudes of one and of two periods a turn, for each axis
    phases: Array  # (2, 2)
    wobble: Array  # (2, 3) rad, how an axis leans as it turns
    pace: Array  # (2,) periods of the wobble a turn

    def pose(self, reading_deg: Array, noise_deg: Array) -> tuple[Array, Array]:
        """The rotation (3, 3), camera <- collimator, and the pupil (3,) mm from where it is with both axes at 0."""
        a = reading_deg * DEG
        waves = [np.sin(n * a + self.phases[:, n - 1]) - np.sin(self.phases[:, n - 1]) for n in (1, 2)]
        true = (
            self.scales * reading_deg
            + noise_deg
            + self.encoder_deg[:, 0] * waves[0]
            + self.encoder_deg[:, 1] * waves[1]
        )
        lean = np.sin(self.pace * a)[:, None] * self.wobble
        screws = zip(true, self.axes + lean, strict=True)
        pan, tilt = (turn(-DEG * angle * axis / np.linalg.norm(axis)) for angle, axis in screws)
        moved = pan @ (self.apart_mm + tilt @ self.arm_mm) - (self.apart_mm + self.arm_mm)
        return self.camera @ (pan @ tilt).T @ self.base, self.base.T @ moved


@dataclass(frozen=True)
class World:
    """All that a seed draws before poses are taken."""

    lens: LensSystem
    pupil_mm: Array  # (3,) with both axes at 0
    pupil_radius_mm: float
    stop_mm: tuple[float, float]  # place and radius of the beam's stop
    foot_mm: Array  # (2,) print's point on the collimator's axis
    print_turn: Array  # (2, 2) from the print to the collimator's axes
    print_scale: Array  # (2,)
    r: float
    camera: Camera
    gimbal: Screws
    stated: Stated
    star_px: float
    stated_px: float
    pose_field_px: float
    facts: dict[str, Any]


def draw_world(seed: int, other_camera: int = 0, kind: str = "real") -> World:
    """Draw a bench before its poses; another number draws another camera and gimbal before the same glass.

    kind: ``real``; ``far`` has a pupil far in front of the pivot.
    """
    rng = np.random.default_rng((seed, 21))
    size = float(rng.uniform(0.2, 1.2))
    bow_mm = float(np.exp(rng.uniform(np.log(0.005), np.log(0.02))))
    stop = float(rng.uniform(20, 90))
    lens = draw_lens(rng, size, bow_mm, *_design(seed, stop))
    pupil = np.array([*rng.normal(0, 1.2, 2), lens.surfaces[0].vertex_mm - stop])
    r, defocus = measured(lens, pupil)
    effective = float(rng.choice([0.0, 2e-4]))
    sigma_r, sigma_defocus = float(rng.uniform(0.03, 0.1)), max(0.002, 0.01 * size)
    z = rng.normal(size=3)
    stated = Stated(
        float(r * (1 + effective * z[0]) + sigma_r * z[1]),
        sigma_r,
        (float(defocus + sigma_defocus * z[2]), float(sigma_defocus)),
        (0.0, 0.5),
        print_bow_mm=bow_mm,
        effective_radius=effective or None,
    )
    print_scale = stated.print_scale * rng.uniform(-1, 1, 2) + stated.thermal * rng.normal()
    own = np.random.default_rng((seed, 22, other_camera))
    camera = draw_camera(own, FAMILIES[(seed + other_camera) % len(FAMILIES)])
    gimbal = _gimbal(own)
    if kind == "far":
        gimbal = replace(gimbal, arm_mm=np.array([*gimbal.arm_mm[:2], own.uniform(*FAR_MM)]))
    stated = replace(stated, off_pivot_mm=(float(gimbal.arm_mm[2] + 0.5 * own.normal()), 0.5))
    star = float(own.uniform(0.01, 0.02))
    pose_px = float(np.exp(own.uniform(np.log(0.003), np.log(0.03))))
    middle = np.array([(COLUMNS - 1) / 2, (ROWS - 1) / 2]) * PITCH_MM
    facts = {"f": camera.values["fx"], "size": size, "star_px": star, "pose_px": pose_px}
    facts |= {"r": r, "defocus": defocus}
    return World(
        lens,
        pupil,
        float(own.uniform(1, 3)),
        (lens.surfaces[0].vertex_mm, float(8 + stop * np.tan(HALF_ANGLE_DEG * DEG))),
        middle + rng.normal(0, 0.5, 2),
        turn(np.array([0.0, 0.0, DEG * rng.normal(0, 1)]))[:2, :2],
        print_scale,
        r,
        camera,
        gimbal,
        stated,
        star,
        float(star * np.exp(0.1 * own.normal())),
        pose_px,
        facts,
    )


def draw_lens(
    rng: np.random.Generator, size: float, bow_mm: float, surfaces: tuple[Surface, ...], focal: float
) -> LensSystem:
    """Draw a collimator of a design, with its lenses aside and the print out of focus."""
    focus = float(size * 0.066 * rng.choice([-1.0, 1.0]) * rng.uniform(0.5, 1.5)) * focal
    aside = 0.12 * size * rng.normal(size=(len(surfaces), 2))
    surfaces = tuple(
        replace(s, vertex_mm=s.vertex_mm - focus, aside_mm=a) for s, a in zip(surfaces, aside, strict=True)
    )
    widths = rng.uniform(8, 25, 12)
    heights = size * rng.uniform(10e-6, 60e-6) * widths * rng.normal(size=12)
    bumps = Bumps(rng.uniform(-30, 30, (12, 2)), widths, heights)
    shares = np.array([1.0, 1.0]) + rng.uniform(-0.5, 0.5) * np.array([1.0, -1.0])
    return LensSystem(surfaces, bumps, bow_mm * rng.uniform(-1, 1) / 1.5 / 40.0**2 * shares)


@lru_cache
def _design(seed: int, stop_mm: float) -> tuple[tuple[Surface, ...], float]:
    """Draw an achromat and a weak lens near the print, bent at random, until their errors are fair."""
    rng = np.random.default_rng((seed, 25))
    while True:
        crown, flint = 1.517, rng.uniform(1.62, 1.68)
        power, bend = rng.uniform(-0.8, 0.8), rng.uniform(-4, 4)
        first, second = 64 / (64 - 34), -34 / (64 - 34)  # shares of the power, by the Abbe numbers
        c1 = rng.uniform(-1.0, 1.9)
        c2 = c1 - first / (crown - 1)
        curvatures = np.array([c1, c2, c2 - second / (flint - 1), power / (crown - 1) + bend, bend]) / 255
        thick = np.array([0.0, 12.0, 18.0, 0.0, 6.0]) + rng.uniform(120, 220) * np.array([0, 0, 0, 1, 1])
        surfaces = _at_focus(curvatures, thick, (1.0, crown, flint, 1.0, crown, 1.0), rng.uniform(250, 260))
        if surfaces is not None and _is_fair(surfaces, stop_mm):
            return surfaces, focal_and_back_mm(surfaces)[0]


def _at_focus(
    curvatures: Array, vertices: Array, media: Sequence[float], focal: float
) -> tuple[Surface, ...] | None:
    """The surfaces, scaled to a focal length, with the print at the focus; None if the last lens is too near to it."""
    made = tuple(
        Surface(z, 1.0 / c, np.zeros(2), before, behind)
        for z, c, before, behind in zip(vertices, curvatures, media[:-1], media[1:], strict=True)
    )
    was, back = focal_and_back_mm(made)
    scale = focal / was
    if was <= 0 or back * scale < 25:
        return None
    surfaces = (replace(s, radius_mm=scale * s.radius_mm) for s in made)
    return tuple(replace(s, vertex_mm=scale * (s.vertex_mm - vertices[-1] - back)) for s in surfaces)


def _is_fair(surfaces: tuple[Surface, ...], stop_mm: float) -> bool:
    """Whether errors at 11 degrees are about those of a real collimator: distortion below .8 %, little field curvature.

    Curvature and astigmatism show as parallax: how far the pattern there moves, with a camera that moves along the field
    and across it.
    """
    plain = LensSystem(surfaces, Bumps(np.zeros((1, 2)), np.ones(1), np.zeros(1)), np.zeros(2))
    h, start = np.array([[0.002, 0.0], [0.2, 0.0]]), np.array([0.0, 0.0, surfaces[0].vertex_mm - stop_mm])
    with np.errstate(invalid="ignore"):
        still, along, across = (plain.print_mm(start + [move] * 2, h) for move in np.eye(3, k=-1))
    moved = np.array([along[1, 0] - still[1, 0], across[1, 1] - still[1, 1]])
    distortion = still[1, 0] / still[0, 0] / 100 - 1
    return bool(abs(distortion) < 0.008 and abs(moved.mean()) < 0.01 and abs(np.diff(moved)[0]) < 0.004)


def measured(lens: LensSystem, pupil_mm: Array, half_angle_deg: float = 4.0) -> tuple[float, float]:
    """What a laboratory measures: the focal length on the axis, mm, and the defocus.

    The focal length is that of the central beam, with its distortion taken out. The defocus is how far the point that is
    seen straight ahead moves on the print, for each mm that the camera moves across the beam.
    """
    angles = np.arange(12) * np.pi / 6
    h = np.concatenate([ring * np.stack([np.cos(angles), np.sin(angles)], axis=1) for ring in _RINGS])
    h = h * np.tan(half_angle_deg * DEG)
    seen = lens.print_mm(np.tile(pupil_mm, (len(h), 1)), h)
    x, y = h.T
    powers = [x**i * y**j for i in range(4) for j in range(4 - i)]
    linear = [(i, j) for i in range(4) for j in range(4 - i)]
    coefficients = np.linalg.lstsq(np.stack(powers, axis=1), seen, rcond=None)[0]
    r = 0.5 * (coefficients[linear.index((1, 0)), 0] + coefficients[linear.index((0, 1)), 1])
    moves = np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
    at = lens.print_mm(pupil_mm + moves, np.zeros((4, 2)))
    return float(r), float(0.25 * (at[0, 0] - at[1, 0] + at[2, 1] - at[3, 1]))


def draw_camera(rng: np.random.Generator, family: str) -> Camera:
    """Draw a camera whose lens has a form of its own; its coefficients are those that come nearest."""
    f = float(rng.uniform(2150, 4800))
    fy = f * (1 + 1e-4 * float(rng.normal()))
    centre = rng.normal((np.array(SIZE) - 1) / 2, 8)
    wide, draws = f / 3345.0, rng.normal(size=4)
    bend, pole = 0.08 * wide**2 * draws[0], 0.4 * wide**2 * rng.uniform(-1, 1)
    p1, p2 = (5e-4 * draws[2:]) if family == "p1p2k3" else (0.0, 0.0)

    def radius(tangent: Array) -> Array:
        angle = np.arctan(tangent)
        if family == "fisheye":
            return np.asarray(2 * np.sin(angle / 2) * (1 + bend * angle**2 / (1 + pole * angle**2)))
        if family == "k1k2":
            return np.asarray(tangent * (1 + (bend + pole) * tangent**2) / (1 + pole * tangent**2))
        return np.asarray(angle + (1 / 3 + bend) * angle**3 + (2 / 15 + 0.6 * wide**4 * draws[1]) * angle**5)

    def image_of(rays: Array) -> Array:
        x, y = (rays[:, :2] / rays[:, 2:]).T
        r2 = x * x + y * y
        share = radius(np.sqrt(r2)) / np.maximum(np.sqrt(r2), 1e-300)
        u = x * share + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        v = y * share + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        return np.stack([f * u + centre[0], fy * v + centre[1]], axis=1)

    reach = np.linspace(0.0, 1.05 * np.hypot(*SIZE) / 2 / f, 200)
    scale, lens = _coefficients(reach, radius(reach), family)
    values = {"fx": f * scale, "fy": fy * scale, "cx": float(centre[0]), "cy": float(centre[1]), **lens}
    if family == "p1p2k3":
        values |= {"p1": float(p1 / scale), "p2": float(p2 / scale)}
    return Camera(values, family, image_of)


def _coefficients(tangent: Array, radius: Array, family: str) -> tuple[float, dict[str, float]]:
    """The scale and coefficients of the lens form that come nearest to a radius over the sensor."""
    names = {"k1k2": ("k1", "k2"), "p1p2k3": ("k1", "k2", "k3"), "fisheye": ("kb1", "kb2", "kb3", "kb4")}[
        family
    ]
    base = np.arctan(tangent) if family == "fisheye" else tangent
    columns = np.stack([base ** (2 * i + 1) for i in range(len(names) + 1)], axis=1)
    sizes = np.abs(columns).max(axis=0)
    area = np.sqrt(tangent + tangent[1])  # a sensor has more points farther out
    fitted = np.linalg.lstsq(columns / sizes * area[:, None], radius * area, rcond=None)[0] / sizes
    return float(fitted[0]), dict(zip(names, (fitted[1:] / fitted[0]).tolist(), strict=True))


def _gimbal(rng: np.random.Generator) -> Screws:
    return Screws(
        np.array([[0.0, 1.0, 0.0], [1.0, -0.02 * DEG * rng.normal(), 0.0]]),
        rng.normal(0, 0.15, 3),
        np.array([*rng.normal(0, 1.0, 2), rng.normal(0, 3.0)]),
        turn(DEG * rng.normal(0, 1, 3)),
        turn(DEG * rng.normal((0, 0, -8.0), 0.3)),
        1 + 2e-4 * rng.normal(size=2),
        np.stack([0.001 * rng.normal(size=2), 0.0003 * rng.normal(size=2)], axis=1),
        rng.uniform(0, 2 * np.pi, (2, 2)),
        0.001 * DEG * rng.normal(size=(2, 3)),
        rng.uniform(1, 3, 2),
    )


def directions(world: World, pupil_mm: Array, print_mm: Array, radius_mm: float) -> Array:
    """Tangents (6, N, 2) of the rays of each star at six places of the entrance pupil."""
    places = pupil_mm + radius_mm * np.column_stack([_RING, np.zeros(len(_RING))])
    from_mm = np.repeat(places, len(print_mm), axis=0)
    tangents = world.lens.tangents(from_mm, np.tile(print_mm, (len(places), 1)), world.r)
    return tangents.reshape(len(places), -1, 2)


def record(world: World, seed: int, poses: Sequence[Pose], times: int = 1, other_camera: int = 0) -> Bench:
    """Record poses with a drawn bench; what a pose draws does not depend on the poses beside it."""
    ids, nominal = printed_stars()
    on_axis = (nominal * (1 + world.print_scale) - world.foot_mm) @ world.print_turn.T
    views, readings = [], []
    for name, pose, again in named_poses(poses, times):
        lasting = np.random.default_rng((seed, 23, other_camera, *pose_key(pose)))
        fresh = np.random.default_rng((seed, 24, other_camera, *pose_key(pose), again))
        rotation, moved = world.gimbal.pose(np.array(pose, float), 0.002 * lasting.normal(size=2))
        pupil = world.pupil_mm + moved
        shown = _shown(world, on_axis, rotation, pupil)
        px = np.zeros((len(shown), 2))
        for tangents in directions(world, pupil, on_axis[shown], world.pupil_radius_mm):
            rays = np.column_stack([tangents, np.ones(len(shown))]) @ rotation.T
            px += world.camera.project(rays) / len(_RING)
        px += world.pose_field_px * _field(lasting, px)
        stars = ids[shown], nominal[shown], px
        views.append(noisy_view(name, stars, world.star_px, world.stated_px, 0.005, fresh))
        readings.append({"pan_deg": float(pose[0]), "tilt_deg": float(pose[1])})
    return Bench("raytraced", views, readings, world.stated, world.camera, {**world.facts, "times": times})


def _shown(world: World, on_axis: Array, rotation: Array, pupil: Array) -> NDArray[np.int64]:
    """Which stars lie about in the image and inside of the beam's stop."""
    h = on_axis / world.r
    rays = np.column_stack([h, np.ones(len(h))]) @ rotation.T
    at_stop = pupil[:2] + h * (world.stop_mm[0] - pupil[2])
    inside = (rays[:, 2] > 0.5) & (np.hypot(*at_stop.T) < 0.95 * world.stop_mm[1])
    px = world.camera.project(np.where(inside[:, None], rays, [0.0, 0.0, 1.0]))
    near = ((px > -60) & (px < np.array(SIZE) + 60)).all(axis=1)
    return np.flatnonzero(inside & near)


def _field(rng: np.random.Generator, px: Array) -> Array:
    """A smooth field (N, 2) over the sensor of about unit mean square: five hills for each axis."""
    middles, widths = rng.uniform((0, 0), SIZE, (5, 2)), rng.uniform(250, 700, 5)
    heights = rng.normal(size=(5, 2))
    squares_px2 = ((px[:, None] - middles) ** 2).sum(axis=2)
    return np.exp(-0.5 * squares_px2 / widths**2) @ heights
