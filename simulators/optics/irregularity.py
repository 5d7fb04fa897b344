"""Random errors of a collimator that follow no aberration law: displaced points, and a disc that varies with the pose.

The figure of lenses is uneven, and a camera in another pose looks through another part of them. Points are displaced
by a smooth random field over the disc: Zernike polynomials (Noll 1976, normalised as there) of degree 1 to 5 in x and
in y. Their coefficients are smooth random functions of the direction in which the camera looks: nearly equal in nearly
equal poses, different some ten degrees away. At the rim the camera's pupil is only partly filled. Points there are
displaced more, outwards on average, by a second random field. A seed fixes everything, as a collimator is one piece of
glass.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

DEGREE: Final = 5
MONOMIALS: Final = (DEGREE + 1) * (DEGREE + 2) // 2
POWER: Final = (0.17, 0.12, 0.24, 0.20, 0.27)
"""Share of each degree, 1 to `DEGREE`, in the mean square: taken from recordings of a real collimator."""
WAVES: Final = 3
"""Sinusoids summed in a random function of the pose."""
WAVELENGTH: Final = 0.2
"""Mean wavelength of these sinusoids, in tangents of the camera's turn."""
EDGE: Final = 1.2
"""Distance from the disc's centre, in radii, beyond which the field is constant."""
RIM_FROM: Final = 0.86
"""Distance from the disc's centre, in radii, at which the rim's field begins; it is full at the disc's edge."""
RIM_POWER: Final = 1.6
RIM_HARMONICS: Final = 3
"""Largest number of periods of the rim's field around the disc."""
RIM_OUTWARDS: Final = 1.6
"""Mean outward displacement, in units of the rim's rms."""


def field_coefficients(axis: tuple[float, float], rms: float, rim_rms: float, seed: int) -> FloatArray:
    """Return the coefficients of the displacement field in a pose.

    Zernike polynomials: Noll (1976). Random functions: Shinozuka and Deodatis (1991). The field at the rim is this
    project's own.

    axis: Tangents of the camera's turn.
    rms: Root mean square displacement over the disc and over poses, mm.
    rim_rms: Root mean square displacement of the rim's field at the disc's edge, in x and in y, mm.
    Returns: Coefficients in mm, for ``displacement_field``. First those of u^p v^q, p outermost, with
      coordinates from the disc's centre in its radii. Then those of the rim: 1, cos phi, sin phi, cos 2 phi,
      ...
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

    axis: Tangents of the camera's turn.
    """
    waves, phases = _waves(count, seed)
    return np.asarray(math.sqrt(2.0 / WAVES) * np.sin(waves @ np.array(axis) + phases).sum(axis=1))


@lru_cache(maxsize=16)
def _waves(count: int, seed: int) -> tuple[FloatArray, FloatArray]:
    """Return wave vectors (count, WAVES, 2), and phases (count, WAVES).

    Wave vectors of random direction, with lengths spread about 2 pi / `WAVELENGTH`: this project's own choice.
    """
    rng = np.random.default_rng((seed, count))
    lengths = 2.0 * math.pi / WAVELENGTH * rng.uniform(0.6, 1.4, (count, WAVES))
    directions = rng.uniform(0.0, 2.0 * math.pi, (count, WAVES))
    vectors = lengths[..., None] * np.stack([np.cos(directions), np.sin(directions)], axis=-1)
    return vectors, rng.uniform(0.0, 2.0 * math.pi, (count, WAVES))


@lru_cache(maxsize=1)
def _zernike() -> tuple[FloatArray, FloatArray]:
    """Return Zernike polynomials of mean square 1 over the disc, (N, MONOMIALS), and the rms of their coefficients.

    Normalisation: Noll (1976). The order is by degree n and then by m, not Noll's.
    """
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
    """Return rho^power cos(m phi), or sin(|m| phi) if m < 0, as monomials (p, q, weight) of u^p v^q.

    Own derivation: binomial series of (u + iv)^|m| and of (u^2 + v^2)^((power - |m|) / 2).
    """
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


@njit(cache=True, nogil=True)
def displacement_field(u: float, v: float, coefficients: FloatArray) -> tuple[float, float]:
    """Return the displacement at a point of the disc.

    Own model: sum c_pq u^p v^q, and beyond rho = `RIM_FROM` also ((rho - `RIM_FROM`) / (1 - `RIM_FROM`))^`RIM_POWER`
    times a Fourier series of the angle.

    u, v: Point relative to the disc's centre, in its radii.
    coefficients: (MONOMIALS + 2 RIM_HARMONICS + 1, 2) float64, or (0, 2) for no displacement.
    """
    x, y = 0.0, 0.0
    if coefficients.shape[0] == 0:
        return x, y
    rho = math.sqrt(u * u + v * v)
    if rho > EDGE:
        u, v = u * EDGE / rho, v * EDGE / rho
        rho = EDGE
    k, power_u = 0, 1.0
    for p in range(DEGREE + 1):
        power = power_u
        for _ in range(DEGREE + 1 - p):
            x += power * coefficients[k, 0]
            y += power * coefficients[k, 1]
            power *= v
            k += 1
        power_u *= u
    if rho > RIM_FROM:
        rim_x, rim_y = _rim_field(u / rho, v / rho, coefficients[MONOMIALS:])
        growth = ((rho - RIM_FROM) / (1.0 - RIM_FROM)) ** RIM_POWER
        x, y = x + growth * rim_x, y + growth * rim_y
    return x, y


@njit(cache=True, nogil=True)
def _rim_field(cosine: float, sine: float, coefficients: FloatArray) -> tuple[float, float]:
    """Return the rim's field at the disc's edge, in the direction of that cosine and sine.

    Own model: the Fourier series c_0 + sum over m of c_m cos(m phi) + s_m sin(m phi).
    """
    x, y = coefficients[0]
    c, s = 1.0, 0.0
    for m in range(1, RIM_HARMONICS + 1):
        c, s = c * cosine - s * sine, c * sine + s * cosine
        x += c * coefficients[2 * m - 1, 0] + s * coefficients[2 * m, 0]
        y += c * coefficients[2 * m - 1, 1] + s * coefficients[2 * m, 1]
    return x, y
