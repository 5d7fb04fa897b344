"""Collimators of published prescriptions, traced by Optiland (MIT, ``pip install optiland``), a ray tracer of strangers.

A camera looks through its entrance pupil along tangents h, at a place x of the plane z = 0 before the first surface. Where
such a ray meets the target's plane, and with which slope, is one smooth function of x and h. It is traced at some
thousand rays and fitted by polynomials once for a collimator, so that a bench takes no longer than its arithmetic.

Prescriptions: those of Optiland's own samples (Erfle, US 1,479,229; Tessar, Petzval lens and Cooke triplet of
Laikin, Lens Design, 4th edition), Thorlabs' achromat AC254-100-A (catalogue: f 100.1 mm; 62.8, -45.7, -128.2 mm; 4.0 and 2.5
mm; N-BK7 and SF5), two of them as a Ploessl eyepiece has them, a concentric and a parabolic mirror. All are scaled.
"""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

WAVE_UM = 0.55
MISSING = "The worlds of strangers need a ray tracer: pip install optiland (benchmarks only)."
#: Degrees of the polynomials of place and slope, together in all four variables.
DEGREE = 9
RAYS = 3500


class Face(NamedTuple):
    """A surface of a prescription, mm."""

    radius: float
    z: float
    index: float  # behind it; 0 for a mirror
    conic: float = 0.0


@dataclass(frozen=True)
class Tolerances:
    """Standard deviations of what a workshop leaves, of each element."""

    aside_mm: float = 0.02
    tilt_rad: float = 3e-4
    spacing_mm: float = 0.03
    index: float = 2e-4
    slope_rad: float = 1.5e-5  # figure of the first surface, as the deflection of a ray


def _optiland() -> Any:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            import optiland.optic
            import optiland.samples.eyepieces
            import optiland.samples.objectives
        import optiland
    except ImportError as error:
        raise SystemExit(MISSING) from error
    return optiland


def _index(name: str) -> float:
    _optiland()
    from optiland.materials import Material

    return float(np.ravel(Material(name, "schott").n(WAVE_UM))[0])


def _doublet() -> list[Face]:
    return [Face(62.8, 0.0, _index("N-BK7")), Face(-45.7, 4.0, _index("N-SF5")), Face(-128.2, 6.5, 1.0)]


def _ploessl() -> list[Face]:
    """Two achromats, crown to crown, a millimetre apart."""
    first = _doublet()
    turned = [
        Face(-f.radius, 6.5 - f.z, before)
        for f, before in zip(first[::-1], (first[1].index, first[0].index, 1.0), strict=True)
    ]
    return turned + [Face(f.radius, f.z + 7.5, f.index) for f in first]


def _sample(module: str, name: str) -> list[Face]:
    """A prescription of Optiland, from its first glass on; flat stops of air are left out."""
    lens = getattr(getattr(_optiland().samples, module), name)()
    faces = [
        Face(
            float(s.geometry.radius),
            float(np.ravel(s.geometry.cs.z)[0]),
            float(np.ravel(s.material_post.n(WAVE_UM))[0]),
        )
        for s in lens.surfaces[1:-1]
    ]
    glass = [
        f
        for i, f in enumerate(faces)
        if not (np.isinf(f.radius) and f.index == (faces[i - 1].index if i else 1.0))
    ]
    return [f._replace(z=f.z - glass[0].z) for f in glass]


#: The faces; the distance of the camera's pupil from the first vertex over the focal length; the largest tangent.
DESIGNS: dict[str, tuple[Callable[[], list[Face]], float, float]] = {
    "doublet": (_doublet, 0.2, 0.10),
    "ploessl": (_ploessl, 0.35, 0.17),
    "erfle": (partial(_sample, "eyepieces", "EyepieceErfle"), 0.2, 0.17),
    "tessar": (partial(_sample, "objectives", "TessarLens"), 0.15, 0.17),
    "petzval": (partial(_sample, "objectives", "PetzvalLens"), 0.15, 0.10),
    "triplet": (partial(_sample, "objectives", "CookeTriplet"), 0.15, 0.17),
    "concentric mirror": (lambda: [Face(-200.0, 0.0, 0.0)], 2.0, 0.15),
    "parabolic mirror": (lambda: [Face(-200.0, 0.0, 0.0, -1.0)], 1.7, 0.06),
}


def focal_mm(faces: Sequence[Face]) -> tuple[float, float]:
    """Focal length, and place of the focus from the first vertex, by paraxial refraction (own sums, no ray tracer)."""
    if not faces[0].index:
        return abs(faces[0].radius) / 2, faces[0].radius / 2
    height, slope, n, z = 1.0, 0.0, 1.0, 0.0
    for face in faces:
        height += slope * (face.z - z)
        slope = (n * slope - height * (face.index - n) / face.radius) / face.index
        n, z = face.index, face.z
    return -1.0 / slope, z - height / slope


def scaled(name: str, focal: float) -> list[Face]:
    """The faces of a design with another focal length, mm."""
    faces = DESIGNS[name][0]()
    by = focal / focal_mm(faces)[0]
    return [f._replace(radius=f.radius * by, z=f.z * by) for f in faces]


def _system(faces: Sequence[Face], loose: Tolerances, rng: np.random.Generator) -> Any:
    """The lens as a workshop makes it: each element (cemented glass is one) aside, tilted and shifted, indices off."""
    _optiland()
    from optiland.materials import IdealMaterial
    from optiland.optic import Optic

    lens = Optic()
    lens.surfaces.add(index=0, radius=np.inf, thickness=np.inf)
    start, aside, tilt, along = 0.0, np.zeros(2), np.zeros(2), 0.0
    for i, face in enumerate(faces):
        if i == 0 or faces[i - 1].index == 1.0:  # a new element begins
            aside, tilt = loose.aside_mm * rng.normal(size=2), loose.tilt_rad * rng.normal(size=2)
            along, start = loose.spacing_mm * rng.normal() * (i > 0), face.z
        glass: Any = "mirror" if not face.index else "air"
        if face.index > 1:
            glass = IdealMaterial(n=face.index + loose.index * rng.normal())
        x, y = aside + (face.z - start) * tilt
        form = {"radius": face.radius, "conic": face.conic, "material": glass, "is_stop": i == 0}
        place = {"x": float(x), "y": float(y), "z": face.z + along}
        lens.surfaces.add(index=i + 1, **form, **place, rx=-float(tilt[1]), ry=float(tilt[0]))
    lens.surfaces.add(index=len(faces) + 1, z=focal_mm(faces)[1])
    return lens


def _traced(lens: Any, places: Array, tangents: Array, plane_z: float) -> tuple[Array, Array]:
    """Points (N, 2) mm on the nominal focal plane, and slopes (N, 2) there, of rays from a plane in front."""
    from optiland.rays import RealRays

    along = 1 / np.sqrt(1 + (tangents**2).sum(axis=1))
    ones = np.ones(len(places))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        towards = tangents[:, 0] * along, tangents[:, 1] * along, along
        rays = RealRays(*places.T, plane_z * ones, *towards, ones, WAVE_UM * ones)
        lens.surfaces.trace(rays, skip=1, record=False)
    at = np.stack([rays.x, rays.y], axis=1)
    to = np.stack([rays.L, rays.M], axis=1) / np.asarray(rays.N)[:, None]
    if not np.isfinite(at).all():
        raise ArithmeticError("A ray does not get through the glass.")
    return np.asarray(at, float), np.asarray(to, float)


def _powers(variables: Array, degree: int) -> Array:
    """All products of (N, 4) variables up to a degree, (N, terms)."""
    by_degree = [variables[:, i : i + 1] ** np.arange(degree + 1) for i in range(4)]
    a, b, c, d = _exponents(degree)
    return np.asarray(by_degree[0][:, a] * by_degree[1][:, b] * by_degree[2][:, c] * by_degree[3][:, d])


@lru_cache
def _exponents(degree: int) -> NDArray[np.int64]:
    every = np.stack(np.meshgrid(*[np.arange(degree + 1)] * 4, indexing="ij")).reshape(4, -1)
    return np.asarray(every[:, every.sum(axis=0) <= degree])


@dataclass(frozen=True)
class Collimator:
    """A collimator with its target: where on the print a ray ends that enters at a place and with a tangent."""

    efl_mm: float  # of the glass as it is, on the axis
    pupil_to_focus_mm: float  # from the plane of the pupil to the front focal plane
    error_mm: float  # largest error of the polynomials at rays that took no part
    half_width: tuple[float, float]  # of places, mm, and of tangents
    terms: Array  # (terms, 4) of point and slope
    stop_mm: float  # from the pupil's plane to the first vertex
    bumps: tuple[
        Array, Array, Array
    ]  # of the first surface: middles (B, 2), widths (B,), deflections (B,) rad
    out_of_focus_mm: float  # of the print, along the light
    sag: Array  # (2,) 1/mm, bow of the print along its axes

    def print_mm(self, places: Array, tangents: Array) -> Array:
        """Points (N, 2) mm at which rays meet the print."""
        scale = np.array(self.half_width).repeat(2)
        powers = _powers(np.hstack([places, tangents]) / scale, DEGREE)
        point, slope = np.split(powers @ self.terms, 2, axis=1)
        start = point = point + self.efl_mm * self._figure(places + self.stop_mm * tangents)
        for _ in range(2):
            point = start + (self.out_of_focus_mm + (self.sag * point**2).sum(axis=1, keepdims=True)) * slope
        return np.asarray(point)

    def _figure(self, at: Array) -> Array:
        middles, widths, heights = self.bumps
        off = (at[:, None] - middles) / widths[:, None]
        return np.asarray(-(heights * np.exp(0.5 - 0.5 * (off**2).sum(axis=2)))[..., None] * off).sum(axis=1)

    def tangents(self, pupils: Array, print_mm: Array, first: Array | None = None) -> Array:
        """Tangents (N, 2) under which points of the print appear from pupils (N, 3) mm; z towards the glass."""
        h = print_mm / self.efl_mm if first is None else first
        step = 1e-5
        for _ in range(4 if first is None else 2):
            base = self.print_mm(pupils[:, :2] - h * pupils[:, 2:], h)
            columns = []
            for axis in np.eye(2) * step:
                moved = h + axis
                columns.append((self.print_mm(pupils[:, :2] - moved * pupils[:, 2:], moved) - base) / step)
            h = h - np.linalg.solve(np.stack(columns, axis=2), (base - print_mm)[..., None])[..., 0]
        return h

    def radius_and_defocus(self, pupil_z_mm: float) -> tuple[float, float]:
        """What the engine's statements mean: d print / d tangent and d print / d place, on the axis, from a pupil."""
        e, h = 1e-3, 0.02
        angles = np.arange(12) * np.pi / 6
        unit = np.column_stack([np.cos(angles), np.sin(angles)])
        near, far = (  # what distortion adds with the square is taken out
            float((self.print_mm(-pupil_z_mm * k * h * unit, k * h * unit) * unit).mean() * 2 / (k * h))
            for k in (0.5, 1.0)
        )
        rise = float((self.print_mm(e * unit, 0 * unit) * unit).mean() * 2 / e)
        return near + (near - far) / 3, rise


def collimator(
    name: str, focal: float, rng: np.random.Generator, loose: Tolerances, print_: tuple[float, Array]
) -> Collimator:
    """Make a collimator of a design with the tolerances of a workshop.

    print_: How far the print is out of focus, as a share of the focal length, and its bow, 1/mm.
    """
    _, before, widest = DESIGNS[name]
    lens, stop = _system(scaled(name, focal), loose, rng), before * focal
    wide, reach = 16.0, 1.15 * widest
    places, tangents = (_disc(rng, RAYS, size) for size in (wide, reach))
    seen = np.hstack(_traced(lens, places, tangents, -stop))
    scale = np.array([wide, wide, reach, reach])
    fitted, tested = slice(RAYS // 10, None), slice(RAYS // 10)
    powers = _powers(np.hstack([places, tangents]) / scale, DEGREE)
    terms = np.linalg.lstsq(powers[fitted], seen[fitted], rcond=None)[0]
    error = float(np.abs(powers[tested] @ terms - seen[tested])[:, :2].max())
    e = 1e-4
    axis = _traced(
        lens, np.array([[e, 0], [-e, 0], [0, 0], [0, 0]]), np.array([[0, 0], [0, 0], [e, 0], [-e, 0]]), -stop
    )[1]
    by_place, by_tangent = (axis[0, 0] - axis[1, 0]) / (2 * e), (axis[2, 0] - axis[3, 0]) / (2 * e)
    count = 10
    bumps = (
        _disc(rng, count, stop * widest + 10),
        rng.uniform(8, 25, count),
        loose.slope_rad * rng.normal(size=count),
    )
    return Collimator(
        abs(1 / by_place),
        by_tangent / by_place,
        error,
        (wide, reach),
        terms,
        stop,
        bumps,
        print_[0] * focal,
        print_[1],
    )


def _disc(rng: np.random.Generator, count: int, radius: float) -> Array:
    angles, share = rng.uniform(0, 2 * np.pi, count), np.sqrt(rng.uniform(0, 1, count))
    return radius * share[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
