"""Errors of a real collimator: where a point of its reticle appears to lie.

An ideal collimator sends the light of a reticle point P out in the direction P - c, through every part of its pupil.
A real one bends the light. The amount depends on the place in the field, h = (P - (x, y)) / r, and on the place of the
camera's pupil in the collimator's pupil. The disc of light shows the latter: b = (disc centre - (x, y)) / r. The
apparent displacement of P, in units of r, is that of the third-order aberrations (Seidel; the gradient of the wave
aberration along b; Born and Wolf, Principles of Optics, section 5.3):

    defocus b + spherical |b|^2 b + coma (|b|^2 h + 2 (h.b) b)
    + astigmatism 2 (h.b) h + field_curvature 2 |h|^2 b + distortion |h|^2 h

Defocus is finite collimation: all points move together, as if c moved with the disc. A bowed reticle acts as
distortion: where it stands z nearer to the camera, a point moves outwards by z h. With z = bow (|P - (x, y)| / R)^2 the
coefficient is bow r / R^2. A print of another size moves points in proportion to h.

Two effects are added. Towards the disc's edge the camera's pupil is only partly filled, and points move outwards (or
inwards) with the fourth power of their distance from the disc's centre. And the figure of lenses is uneven, and a
camera in another pose looks through another part of them: points are displaced by a smooth random field over the disc,
Zernike polynomials (Noll 1976, normalised as there) of degree 1 to 5 in x and in y. Their coefficients are smooth
random functions of the direction in which the camera looks. At the rim points are displaced more, outwards on average,
by a second random field. A seed fixes everything, as a collimator is one piece of glass.

This module works in the target plane only; it uses no camera and no image. `Aberrations` holds all coefficients of a
pose; positions of single points follow from it alone.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from simulators.world.truth import CollimatorTruth, ReticleTruth

FloatArray = NDArray[np.float64]

DEGREE: Final = 5  # The residuals of a real collimator have shares up to this degree; see `POWER`
MONOMIALS: Final = (DEGREE + 1) * (DEGREE + 2) // 2
POWER: Final = (0.17, 0.12, 0.24, 0.20, 0.27)
"""Share of each degree, 1 to `DEGREE`, in the mean square: taken from recordings of a real collimator."""
WAVES: Final = 3
"""Sinusoids summed in a random function of the pose: three look irregular; each more costs time."""
WAVELENGTH: Final = 0.2
"""Mean wavelength of these sinusoids, in tangents of the camera's turn."""
EDGE: Final = 1.2
"""Distance from the disc's centre, in radii, beyond which the field is constant."""
RIM_FROM: Final = 0.86
"""Distance from the disc's centre, in radii, at which the rim's field begins; it is full at the disc's edge."""
RIM_POWER: Final = 1.6  # With the other numbers of the rim, "like-real" has the residuals of a real one
RIM_HARMONICS: Final = 3
"""Largest number of periods of the rim's field around the disc."""
RIM_OUTWARDS: Final = 1.6
"""Mean outward displacement, in units of the rim's rms."""
ROLL_TO = 1.2
"""Distance from the disc's centre, in radii, beyond which the rim's displacement grows only in proportion to it."""

CIRCLE: Final = np.zeros(0)
EDGE_TERMS: Final = 8  # Cosine and sine of 2 to 5 periods around the disc

PERFECT_PRINT: Final = ReticleTruth()

_NOTHING: Final = np.zeros((0, 2))


def field_coefficients(axis: tuple[float, float], rms: float, rim_rms: float, seed: int) -> FloatArray:
    """Return the coefficients, mm, of the displacement field in a pose, for ``displacement_field``.

    First those of u^p v^q, p outermost, with coordinates from the disc's centre in its radii. Then those of the rim: 1,
    cos phi, sin phi, cos 2 phi, ... ``rms`` is the root mean square displacement over the disc and over poses, mm,
    ``rim_rms`` that of the rim's field at the disc's edge, in x and in y. Zernike polynomials: Noll (1976). Random
    functions: Shinozuka and Deodatis (1991). The field at the rim is this project's own.
    """
    polynomials, sigmas = _zernike()
    around = 2 * RIM_HARMONICS + 1
    drawn = random_functions(axis, 2 * (len(sigmas) + around), seed).reshape(-1, 2)
    inside = rms * polynomials.T @ (sigmas[:, None] * drawn[around:])
    rim = rim_rms / math.sqrt(RIM_HARMONICS + 1.0) * drawn[:around]
    rim[1, 0] += RIM_OUTWARDS * rim_rms
    rim[2, 1] += RIM_OUTWARDS * rim_rms
    return np.concatenate([inside, rim])


def random_functions(axis: tuple[float, float], count: int, seed: int) -> FloatArray:
    """Return smooth random functions of the pose, each of mean 0 and variance 1 over all poses.

    Each is a sum of sinusoids with random wave vectors and phases (spectral representation; Shinozuka and Deodatis
    1991).
    """
    waves, phases = _waves(count, seed)
    return np.asarray(math.sqrt(2.0 / WAVES) * np.sin(waves @ np.array(axis) + phases).sum(axis=1))


@lru_cache(maxsize=16)
def _waves(count: int, seed: int) -> tuple[FloatArray, FloatArray]:
    """Return wave vectors (count, WAVES, 2), of lengths about 2 pi / `WAVELENGTH` (own choice), and phases."""
    rng = np.random.default_rng((seed, count))
    lengths = 2.0 * math.pi / WAVELENGTH * rng.uniform(0.6, 1.4, (count, WAVES))
    directions = rng.uniform(0.0, 2.0 * math.pi, (count, WAVES))
    vectors = lengths[..., None] * np.stack([np.cos(directions), np.sin(directions)], axis=-1)
    return vectors, rng.uniform(0.0, 2.0 * math.pi, (count, WAVES))


@lru_cache(maxsize=1)
def _zernike() -> tuple[FloatArray, FloatArray]:
    """Return Zernike polynomials (Noll 1976; by degree n, then m) over the disc, (N, MONOMIALS), and their rms."""
    place = {pq: k for k, pq in enumerate((p, q) for p in range(DEGREE + 1) for q in range(DEGREE + 1 - p))}
    rows, sigmas = [], []
    for n in range(1, DEGREE + 1):
        for m in range(-n, n + 1, 2):
            row = np.zeros(MONOMIALS)
            for power, weight in _radial(n, abs(m)).items():
                for p, q, share in _angular_terms(m, power):
                    row[place[p, q]] += weight * share
            rows.append(math.sqrt((n + 1) * (2 if m else 1)) * row)
            sigmas.append(math.sqrt(POWER[n - 1] / (2 * (n + 1) * sum(POWER))))
    return np.array(rows), np.array(sigmas)


def _radial(n: int, m: int) -> dict[int, float]:
    """Return the radial Zernike polynomial: weight by power (Noll 1976)."""
    f = math.factorial
    return {
        n - 2 * k: (-1) ** k * f(n - k) / (f(k) * f((n + m) // 2 - k) * f((n - m) // 2 - k))
        for k in range((n - m) // 2 + 1)
    }


def _angular_terms(m: int, power: int) -> list[tuple[int, int, float]]:
    """Return rho^power cos(m phi), sin(|m| phi) if m < 0, as (p, q, weight) of u^p v^q, by binomial series."""
    angular, rest = abs(m), (power - abs(m)) // 2
    terms = []
    for k in range(angular + 1):  # (u + iv)^|m|
        if (k % 2 == 1) != (m < 0):
            continue
        weight = math.comb(angular, k) * (-1.0) ** (k // 2)
        terms += [
            (angular - k + 2 * (rest - j), k + 2 * j, weight * math.comb(rest, j)) for j in range(rest + 1)
        ]
    return terms


def displacement_field(u: FloatArray, v: FloatArray, coefficients: FloatArray) -> tuple[Any, Any]:
    """Return the displacement at points of the disc, two arrays of one shape (...,) from its centre in its radii.

    Own model: sum c_pq u^p v^q, and beyond rho = `RIM_FROM` also ((rho - `RIM_FROM`) / (1 - `RIM_FROM`))^`RIM_POWER`
    times a Fourier series of the angle. Coefficients: (MONOMIALS + 2 RIM_HARMONICS + 1, 2) float64, or (0, 2) for no
    displacement.
    """
    if coefficients.shape[0] == 0:
        return 0.0, 0.0
    rho = np.sqrt(u * u + v * v)
    beyond, rho_beyond = rho > EDGE, np.maximum(rho, EDGE)
    u, v = np.where(beyond, u * EDGE / rho_beyond, u), np.where(beyond, v * EDGE / rho_beyond, v)
    rho = np.minimum(rho, EDGE)
    x, y = np.zeros_like(rho), np.zeros_like(rho)
    k, power_u = 0, np.ones_like(rho)
    for p in range(DEGREE + 1):
        power = power_u
        for _ in range(DEGREE + 1 - p):
            x += power * coefficients[k, 0]
            y += power * coefficients[k, 1]
            power = power * v
            k += 1
        power_u = power_u * u
    length = np.maximum(rho, RIM_FROM)
    rim_x, rim_y = _rim_field(u / length, v / length, coefficients[MONOMIALS:])
    growth = ((length - RIM_FROM) / (1.0 - RIM_FROM)) ** RIM_POWER
    return x + growth * rim_x, y + growth * rim_y


def _rim_field(cosine: FloatArray, sine: FloatArray, coefficients: FloatArray) -> tuple[Any, Any]:
    """Return the rim's field in those directions: the Fourier series of the angle, c_0, c_1, s_1, ..."""
    x, y = coefficients[0]
    c, s = np.ones_like(cosine), np.zeros_like(sine)
    for m in range(1, RIM_HARMONICS + 1):
        c, s = c * cosine - s * sine, c * sine + s * cosine
        x = x + c * coefficients[2 * m - 1, 0] + s * coefficients[2 * m, 0]
        y = y + c * coefficients[2 * m - 1, 1] + s * coefficients[2 * m, 1]
    return x, y


class Disc(NamedTuple):
    """Disc of light in one pose."""

    x: float  # x of the centre on the target plane, mm
    y: float  # y of the centre on the target plane, mm
    radius: float  # Mean radius, mm
    # (EDGE_TERMS,) float64: relative change of the radius in direction phi, as coefficients of cos 2 phi, sin
    # 2 phi, cos 3 phi, ...; (0,) for a circle.
    edge: FloatArray


class Aberrations(NamedTuple):
    """Errors of the collimator and of the reticle in one pose."""

    collimator: CollimatorTruth
    reticle: ReticleTruth
    disc: Disc
    irregular: FloatArray  # (K, 2) mm, coefficients of `displacement_field`; (0, 2) for none

    @property
    def distortion(self) -> float:
        """Coefficient of the third order, dimensionless; the reticle's bow is part of it."""
        c, reticle = self.collimator, self.reticle
        return c.distortion + reticle.bow_mm * c.r / reticle.bow_radius_mm**2


def disc_of(collimator: CollimatorTruth, rotation: FloatArray) -> Disc:
    """Return the disc of light in a pose: centre, mean radius and edge, mm.

    The disc moves in proportion to the camera's turn, unless the camera's pupil stands on the turning point. A random
    part is added, as on a mount that is moved by hand. The edge departs from a circle by the rms of the truth, with 2
    to 5 periods around it. Own model: the centre lies at (x, y) + offset + walk * tangents + wander * random function,
    and the radius is r tan(half angle) (1 + breathing * random function).
    """
    along = _axis(rotation)
    x, y = collimator.x + collimator.disc_x, collimator.y + collimator.disc_y
    radius = collimator.r * math.tan(math.radians(collimator.half_angle_deg))
    edge = CIRCLE
    if collimator.disc_unevenness != 0.0:
        scale = collimator.disc_unevenness * math.sqrt(2.0 / EDGE_TERMS)
        edge = scale * random_functions(_glass(collimator, along), EDGE_TERMS, collimator.glass_seed)
    wander = random_functions(along, 3, collimator.glass_seed)
    x += collimator.disc_wander_mm * float(wander[0])
    y += collimator.disc_wander_mm * float(wander[1])
    radius *= 1.0 + collimator.disc_breathing * float(wander[2])
    return Disc(
        x + collimator.disc_walk[0] * along[0],
        y + collimator.disc_walk[1] * along[1],
        radius,
        edge,
    )


def relative_radius(cosine: FloatArray, sine: FloatArray, edge: FloatArray) -> FloatArray:
    """Return the radius of the disc in some directions from X, relative to the mean radius; at least 0.1.

    Own model: the Fourier series 1 + sum over m >= 2 of a_m cos(m phi) + b_m sin(m phi). ``edge`` is (2 M,), as in
    ``Disc``.
    """
    wide, c, s = np.ones_like(cosine), cosine, sine
    for m in range(edge.size // 2):
        c, s = c * cosine - s * sine, c * sine + s * cosine
        wide += edge[2 * m] * c + edge[2 * m + 1] * s
    return np.maximum(wide, 0.1)


def radius_fraction(x_mm: FloatArray, y_mm: FloatArray, disc: Disc) -> FloatArray:
    """Return the distances of target points from the disc's centre, as fractions of the radius in that direction."""
    x, y = x_mm - disc.x, y_mm - disc.y
    distance = np.sqrt(x * x + y * y)
    if disc.edge.size == 0:
        return distance / disc.radius
    length = np.maximum(distance, np.finfo(float).tiny)
    return distance / (disc.radius * relative_radius(x / length, y / length, disc.edge))


def _glass(collimator: CollimatorTruth, along: tuple[float, float]) -> tuple[float, float]:
    """Return the place in the glass through which the camera looks, as the random functions take it."""
    return collimator.glass_change * along[0], collimator.glass_change * along[1]


def _axis(rotation: FloatArray) -> tuple[float, float]:
    """Return the tangents of the camera's turn: where its optical axis points in the target's frame."""
    axis = rotation[2]
    return float(axis[0] / axis[2]), float(axis[1] / axis[2])


def aberrations_of(
    collimator: CollimatorTruth, rotation: FloatArray, reticle: ReticleTruth = PERFECT_PRINT
) -> Aberrations:
    """Return a pose's errors of collimator and reticle."""
    return Aberrations(collimator, reticle, disc_of(collimator, rotation), _irregular(collimator, rotation))


def _irregular(collimator: CollimatorTruth, rotation: FloatArray) -> FloatArray:
    """Return the coefficients of the irregular displacements; none if there are none."""
    c = collimator
    if c.irregularity_mm == 0.0 and c.rim_irregularity_mm == 0.0:
        return _NOTHING
    place = _glass(c, _axis(rotation))
    return field_coefficients(place, c.irregularity_mm, c.rim_irregularity_mm, c.glass_seed)


def displacement(x_mm: FloatArray, y_mm: FloatArray, e: Aberrations) -> tuple[FloatArray, FloatArray]:
    """Return displacements of reticle points, (...,) mm; third order, equation in the head (Born and Wolf, 5.3)."""
    c, disc = e.collimator, e.disc
    larger_x, larger_y = e.reticle.print_scale * (x_mm - c.x), e.reticle.print_scale * (y_mm - c.y)
    x_mm, y_mm = x_mm + larger_x, y_mm + larger_y
    h_x, h_y = (x_mm - c.x) / c.r, (y_mm - c.y) / c.r
    b_x, b_y = (disc.x - c.x) / c.r, (disc.y - c.y) / c.r
    hh, bb, hb = h_x * h_x + h_y * h_y, b_x * b_x + b_y * b_y, h_x * b_x + h_y * b_y
    along_b = c.defocus + c.spherical * bb + 2.0 * c.coma * hb + 2.0 * c.field_curvature * hh
    along_h = c.coma * bb + 2.0 * c.astigmatism * hb + e.distortion * hh
    dx, dy = c.r * (along_b * b_x + along_h * h_x), c.r * (along_b * b_y + along_h * h_y)
    from_x, from_y = x_mm - disc.x, y_mm - disc.y
    own_x, own_y = displacement_field(from_x / disc.radius, from_y / disc.radius, e.irregular)
    dx, dy = dx + own_x + larger_x, dy + own_y + larger_y
    rho = np.sqrt(from_x * from_x + from_y * from_y)
    near = np.minimum(rho / disc.radius, ROLL_TO)
    roll = c.rim_roll_mm * (near * near * near) / disc.radius
    return dx + roll * from_x, dy + roll * from_y


def reticle_point(x_mm: FloatArray, y_mm: FloatArray, e: Aberrations) -> tuple[FloatArray, FloatArray]:
    """Return the reticle points that appear at (x, y), to about 1e-6 mm, by the inverse of `displacement`."""
    p_x, p_y = x_mm, y_mm
    for _ in range(6):
        dx, dy = displacement(p_x, p_y, e)
        p_x, p_y = x_mm - dx, y_mm - dy
    return p_x, p_y
