"""The bound of Cramér and Rao for the spherical model of a bench with all that its station states.

Own derivation, by numerical derivatives: the unknowns are the camera, the collimator's centre and radius, and for each
pose a rotation; bow and scale of the print if anything is stated; mounting, standing, squareness and scales of the
gimbal if readings are given.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from .bench import Bench
from .geometry import DEG, by_names, turn
from .judge import CENTRE
from .polynomial import BOW_RADIUS_MM, World

Array = NDArray[np.float64]
_STEP = 1e-6
#: Inverse variance of what is known exactly.
_EXACT = 1e18


def bound_px(
    world: World, bench: Bench, known: str, lens: Mapping[str, float] = MappingProxyType({})
) -> dict[str, float]:
    """Twice the smallest standard uncertainty of fx, fy, cx, cy that any unbiased estimate can have.

    ``known`` is one of `KNOWN`; with an ``x`` in it, collimator and print are known exactly. ``lens``: standard
    uncertainties of further coefficients, whose true value is 0.
    """
    coefficients = {**bench.camera.values, **dict.fromkeys(lens, 0.0)}
    names = list(coefficients)
    start = np.array([*coefficients.values(), *world.glass.foot_mm, world.glass.r, 0.0, 0.0])
    steps = np.array([*(1e-3 if name in CENTRE else 1e-6 for name in names), 1e-4, 1e-4, 1e-4, 1e-3, 1e-6])
    shared, gimbal = len(start), 9 if "r" in known else 0
    count = shared + gimbal
    normal = np.zeros((count, count))
    normal[range(shared - 2, shared), range(shared - 2, shared)] = _print_information(bench, known)
    for name, sigma in lens.items():
        normal[names.index(name), names.index(name)] += sigma**-2
    if "x" in known:
        normal[range(shared - 5, shared), range(shared - 5, shared)] = _EXACT
    if "c" in known:
        normal[shared - 3, shared - 3] += bench.stated.r_sigma_mm**-2
    if gimbal:
        _add_gimbal_priors(normal[shared:, shared:], bench)
    for view, reading in zip(bench.views, bench.readings_deg, strict=True):
        rotation = world.gimbal.rotation(np.array(list(reading.values())), np.zeros(2))

        def seen(values: Array, by: Array, rotation: Array = rotation, mm: Array = view.mm) -> Array:
            lens = dict(zip(names, values[:-5].tolist(), strict=True))
            x, y, r, bow_mm, scale = values[-5:]
            h = (mm * (1 + scale) - [x, y]) / r
            bow = bow_mm * r / BOW_RADIUS_MM**2 * (h * h).sum(axis=1, keepdims=True) * h
            rays = np.column_stack([h + bow, np.ones(len(mm))])
            return by_names(lens, rays @ (turn(by) @ rotation).T).ravel()

        columns = [_slope(lambda at: seen(at, np.zeros(3)), start, i, steps[i]) for i in range(shared)]
        columns += [_slope(lambda by: seen(start, by), np.zeros(3), i, _STEP) for i in range(3)]
        jacobian = np.array(columns).T / np.repeat(view.sigma_px, 2)[:, None]
        own = np.zeros((count + 3, count + 3))
        at = np.r_[:shared, count : count + 3]
        own[np.ix_(at, at)] = jacobian.T @ jacobian
        if gimbal:
            own[shared:, shared:] += _reading_information(world, reading, bench.stated.reading_sigma_deg)
        normal += own[:count, :count] - own[:count, count:] @ np.linalg.solve(
            own[count:, count:], own[count:, :count]
        )
    size = 1 / np.sqrt(np.diag(normal))
    covariance = np.linalg.inv(normal * np.outer(size, size)) * np.outer(size, size)
    return {name: 2 * float(np.sqrt(covariance[names.index(name), names.index(name)])) for name in CENTRE}


def _slope(of: object, at: Array, i: int, step: float) -> Array:
    assert callable(of)
    more, less = at.copy(), at.copy()
    more[i] += step
    less[i] -= step
    return np.asarray((of(more) - of(less)) / (2 * step))


def _print_information(bench: Bench, known: str) -> Array:
    """What is stated about bow, mm, and scale of the print: two inverse variances; exact if nothing is stated."""
    if known == "0":
        return np.full(2, _EXACT)
    stated = bench.stated
    return np.array([3 / stated.print_bow_mm**2, 1 / (stated.print_scale**2 / 3 + stated.thermal**2)])


def _add_gimbal_priors(normal: Array, bench: Bench) -> None:
    """Add what is stated about scales (with the encoder's eccentricity) and squareness, and weakly on all others."""
    scale = np.hypot(bench.stated.scale_sigma, DEG * bench.stated.eccentricity_deg)
    normal[np.diag_indices(9)] += np.array([1.0] * 6 + [scale**-2] * 2 + [(0.5 * DEG) ** -2])


def _reading_information(world: World, reading: dict[str, float], sigma_deg: float) -> Array:
    """Information (12, 12) of a reading on mounting, standing, two scales, squareness and the pose's rotation."""
    pan, tilt = (DEG * angle for angle in reading.values())
    a, b = world.gimbal.camera, world.gimbal.base

    def read(values: Array) -> Array:
        head = turn(np.array([tilt * (1 + values[7]), 0, 0])) @ turn(np.array([0, 0, values[8]]))
        return np.asarray(
            turn(values[:3])
            @ a
            @ head
            @ turn(np.array([0, pan * (1 + values[6]), 0]))
            @ turn(values[3:6])
            @ b
        )

    still = read(np.zeros(9))

    def off(values: Array) -> Array:
        rest = turn(values[9:]) @ still @ read(values[:9]).T
        return 0.5 * np.array([rest[2, 1] - rest[1, 2], rest[0, 2] - rest[2, 0], rest[1, 0] - rest[0, 1]])

    jacobian = np.array([_slope(off, np.zeros(12), i, _STEP) for i in range(12)]).T / (DEG * sigma_deg)
    return np.asarray(jacobian.T @ jacobian)
