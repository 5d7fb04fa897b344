"""Starts of the search: a scan of focal lengths, and small bundles whose glass distorts about the foot that moves.

A homography from the target to the image is K s R M, M = [[1, 0, -x], [0, 1, -y], [0, 0, r]] the same in all views. So
for a focal length, (K^-1 H)^T (K^-1 H) is s^2 M^T M: its mean gives M by Cholesky, and how far the views differ says
how good it is. Own procedure.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.arrays import RAYLEIGH_MEDIAN, Array, Ints
from calib.model.homography import fit_homography, view_homography
from calib.model.rotation import exp_map, nearest_rotation, skew
from calib.view import View

from .camera import Camera
from .fields import square
from .knowledge import Known
from .problem import Start

#: Focal lengths of the scan, as shares of the diagonal: steps of a tenth, from a wide-angle lens to a telephoto lens.
_SCANNED = np.geomspace(0.45, 12.0, 34)
#: Starts if nothing states the radius, beside the best of the scan: octaves.
_SHARES = (0.5, 1.0, 2.0, 4.0, 8.0)
#: A fisheye lens is scanned as far as its angles have usable tangents, rad.
_STEEPEST = 1.3
#: In a bundle the focal length keeps to its half octave, and the principal point near the middle, over f: where poses
#: turn little, a free step would leave the camera. How far k1 and k2 move the corner there.
_HALF_OCTAVE, _MIDDLE, _LENS = 0.35, 0.01, 0.1
#: Steps of the foot and of log r have this size in the bundle; they are free.
_TENTH = 0.1
#: So many stars a view tell starts apart.
_FEW = 40
#: A start counts if its misfit is within this factor of the best one's, and is another one if its foot is so far away,
#: over r. Glass may distort by so much: a single lens has up to 1.4.
_AS_WELL, _ELSEWHERE, _GLASS = 1.5, 0.02, (1.0, -1.0)
#: A certificate is another collimator's if a free length differs so much, as a share, and fits better by that factor.
_OTHER_RADIUS = 0.1
#: Rounds of a bundle: in each, errors of the start count less.
_ROUNDS, _STEPS, _ENOUGH = 3, 12, 1e-3
_SHARED = 9  # Its shared unknowns: log f, cx, cy, k1, k2, x, y, log r, glass


@dataclass(frozen=True)
class _Scanned:
    """What the homographies say for one focal length."""

    spread: float  # How far the views differ
    start: Start


def first_starts(views: Sequence[View], lens: tuple[str, ...], known: Known) -> list[Start]:
    """Return starts after a small bundle, the best first.

    With a stated radius those that have it, else octaves of f; then the best with bent glass. Those that fit about as
    well as the best, but have the foot elsewhere, are others.
    """
    scanned = _scan(views, lens)
    diagonal = float(np.hypot(*views[0].image_size))
    if known.r_mm is not None:
        r_mm = known.r_mm
        tried = [scanned[0], min(scanned, key=lambda one: abs(np.log(one.start.centre[2] / r_mm)))]
    else:
        octaves = [
            min(scanned, key=lambda one, f=share * diagonal: abs(np.log(one.start.f_px / f)))  # type: ignore[misc]
            for share in _SHARES
        ]
        tried = [scanned[0], *octaves]
    few = [_thinned(view) for view in views]
    begins = {id(one): one.start for one in tried}.values()
    ends = [(_bundle(few, begin, lens, known), begin) for begin in begins]
    best = min(ends, key=lambda end: end[0][0])[1]
    if known.passport is None:
        ends += [(_bundle(few, replace(best, glass=glass), lens, known), best) for glass in _GLASS]
    ordered = sorted((end for end, _ in ends), key=lambda end: end[0])
    if known.certificate is not None:
        free, start = _bundle(few, ordered[0][1], lens, replace(known, certificate=None))
        away = abs(float(np.log(start.centre[2] / known.certificate.r_mm)))
        if away > _OTHER_RADIUS and free * _AS_WELL < ordered[0][0]:
            return [replace(start, another=True)]
    chosen: list[Start] = []
    for misfit, start in ordered:
        x, y, r = start.centre
        apart = [np.hypot(x - o.centre[0], y - o.centre[1]) > _ELSEWHERE * r for o in chosen]
        if misfit < _AS_WELL * ordered[0][0] and all(apart):
            chosen.append(start)
    return chosen


def _thinned(view: View) -> View:
    return view.part(np.arange(len(view)) % max(1, len(view) // _FEW) == 0)


def _scan(views: Sequence[View], lens: tuple[str, ...]) -> list[_Scanned]:
    """Return what the homographies say for the focal lengths of the scan, the best first."""
    size = views[0].image_size
    diagonal, ends = float(np.hypot(*size)), list[_Scanned]()
    middle = 0.5 * (np.array(size) - 1.0)
    homographies = np.array([view_homography(view) for view in views])
    stars = np.concatenate([view.target_mm for view in views])
    scale = float(stars.std())
    unit = np.array([[scale, 0, stars[:, 0].mean()], [0, scale, stars[:, 1].mean()], [0, 0, 1]])
    is_fisheye = Camera(size, diagonal, lens).is_fisheye
    for f in (_SCANNED * diagonal).tolist():
        flat = _flattened(views, f, middle) if is_fisheye else homographies
        if flat is None:
            continue
        k = np.array([[f, 0.0, middle[0]], [0.0, f, middle[1]], [0.0, 0.0, 1.0]])
        end = _at_focal_length(np.linalg.solve(k, flat), unit)
        if end is not None:
            spread, centre, rotations = end
            camera = np.zeros(len(Camera(size, f, lens).names))
            ends.append(_Scanned(spread, Start(f, centre, rotations, camera)))
    return sorted(ends, key=lambda one: one.spread)


def _flattened(views: Sequence[View], f: float, middle: Array) -> Array | None:
    """Return the homographies to the tangents of a fisheye's directions; None if these are too steep."""
    flat = []
    for view in views:
        off = view.points_px - middle
        theta = np.hypot(*off.T) / f
        if theta.max() > _STEEPEST:
            return None
        tangents = off * (np.tan(theta) / np.maximum(theta, 1e-9))[:, None]
        h = fit_homography(view.target_mm, middle + tangents)
        flat.append(h)
    return np.array(flat)


def _at_focal_length(n: Array, unit: Array) -> tuple[float, tuple[float, float, float], Array] | None:
    """Return spread, centre and rotations by (m, 3, 3) K^-1 H; ``unit`` makes the stars' places numbers of size 1."""
    gram = np.swapaxes(n @ unit, 1, 2) @ (n @ unit)
    gram /= np.cbrt(np.linalg.det(gram))[:, None, None]
    upper = np.linalg.cholesky(gram.mean(axis=0)).T
    inverse = np.linalg.inv(upper)
    spread = float(np.sqrt(((inverse.T @ gram @ inverse - np.eye(3)) ** 2).mean()))
    m = upper @ np.linalg.inv(unit)
    m = m / m[0, 0]
    x, y, r = -float(m[0, 2]), -float(m[1, 2]), float(m[2, 2])
    turned = n @ np.linalg.inv(np.array([[1.0, 0.0, -x], [0.0, 1.0, -y], [0.0, 0.0, r]]))
    turned *= np.sign(np.linalg.det(turned))[:, None, None]
    if not (np.isfinite(turned).all() and r > 0.0):
        return None
    return spread, (x, y, r), nearest_rotation(turned)


class _Bundle:
    """A small robust bundle: camera, foot, rotations and radial distortion of the glass about the foot.

    Distortion must follow the foot here: where it is of a fixed place, foot and principal point go aside for it.
    """

    def __init__(self, views: Sequence[View], begin: Start, lens: tuple[str, ...], known: Known) -> None:
        self.begin, self.camera = begin, Camera(views[0].image_size, begin.f_px, lens)
        self.mm = np.concatenate([view.target_mm for view in views])
        self.px = np.concatenate([view.points_px for view in views])
        covariances = np.concatenate([view.covariances_px2 for view in views])
        self.sigma = np.linalg.det(covariances) ** 0.25
        counts = [len(view) for view in views]
        self.of_views: Ints = np.repeat(np.arange(len(views)), counts)
        self.ends = 2 * np.cumsum(counts)[:-1]  # Of their rows
        corner = self.camera.corner
        lens_sizes = (_LENS * corner**-2, _LENS * corner**-4)
        self.scale = np.array([_HALF_OCTAVE, _MIDDLE, _MIDDLE, *lens_sizes, _TENTH, _TENTH, _TENTH, 1.0])
        self.r_mm, self.r_sigma = known.r_mm, np.inf
        if known.certificate:
            self.r_sigma = known.certificate.sigma
        elif known.r_mm is not None:
            self.r_sigma = _TENTH**2
        self.radial = [4, 5] if self.camera.is_fisheye else [4, 4 + lens.index("k2")]
        self.places = [0, 2, 3, *self.radial]

    def camera_of(self, u: Array) -> Array:
        """Return (C,) the unknowns of the camera."""
        c = self.begin.camera.copy()
        c[self.places] += u[:5] * self.scale[:5]
        return c

    def centre_of(self, u: Array) -> tuple[Array, float]:
        """Return foot and length of the perpendicular, mm."""
        x, y, r = self.begin.centre
        return np.array([x, y]) + r * _TENTH * u[5:7], float(r * np.exp(_TENTH * u[7]))

    def linearised(self, u: Array, rotations: Array) -> tuple[Array, Array, Array]:
        """Return (N, 2) residuals, and derivatives by (N, 2, 9) shared unknowns and (N, 2, 3) turns, over sigma."""
        foot, length = self.centre_of(u)
        h = (self.mm - foot) / length
        q = square(h)
        points = np.column_stack([h * (1.0 + u[8] * q), np.ones(len(h))])
        turned = rotations[self.of_views]
        seen = (turned @ points[:, :, None])[:, :, 0]
        px, by_point, by_camera = self.camera.linearised(self.camera_of(u), seen)
        by_h = (by_point @ turned)[:, :, :2]
        bent = np.eye(2) * (1.0 + u[8] * q)[:, :, None] + 2.0 * u[8] * h[:, :, None] * h[:, None, :]
        by_foot = by_h @ bent
        columns = np.empty((len(px), 2, _SHARED))
        columns[:, :, :5] = by_camera[:, :, self.places] * self.scale[:5]
        columns[:, :, 5:7] = -by_foot * (_TENTH * self.begin.centre[2] / length)
        columns[:, :, 7] = -_TENTH * (by_foot @ h[:, :, None])[:, :, 0]
        columns[:, :, 8] = (by_h @ (q * h)[:, :, None])[:, :, 0]
        sigma = self.sigma[:, None]
        return (self.px - px) / sigma, columns / sigma[:, :, None], -by_point @ skew(seen) / sigma[:, :, None]

    def misfit(self, off: Array) -> float:
        """Return the robust sigma of (N, 2) residuals."""
        lengths = np.hypot(*off.T)
        return float(np.median(np.where(np.isfinite(lengths), lengths, 1e9))) / RAYLEIGH_MEDIAN

    def cost(self, u: Array, off: Array, level: float) -> float:
        """Return what a step must lower: a loss that grows as the length far out, and what is known."""
        if not np.isfinite(off).all():
            return np.inf
        stars = 2.0 * (np.sqrt(1.0 + (off / level) ** 2) - 1.0).sum()
        return float(stars + (u[:5] ** 2).sum() + self.away(u) ** 2)

    def away(self, u: Array) -> float:
        """Return how far the length is from a stated one, in sigmas."""
        return 0.0 if self.r_mm is None else float(np.log(self.centre_of(u)[1] / self.r_mm) / self.r_sigma)

    def step(
        self, u: Array, linearised: tuple[Array, Array, Array], level: float, damping: float
    ) -> tuple[Array, Array]:
        """Return a damped step of the shared unknowns and of the rotations."""
        off, shared, turns = linearised
        root = (1.0 + (off / level) ** 2) ** -0.25 / level
        columns = np.concatenate([turns, shared, off[:, :, None]], axis=2) * root[:, :, None]
        of_views = np.array([rows.T @ rows for rows in np.split(columns.reshape(-1, 4 + _SHARED), self.ends)])
        alone = of_views[:, :3, :3] * (1.0 + damping * np.eye(3))
        between, whole = of_views[:, :3, 3:], of_views[:, 3:, 3:].sum(axis=0)
        h, rhs = whole[:-1, :-1], whole[:-1, -1]
        h[range(5), range(5)] += 1.0
        rhs[:5] -= u[:5]
        if self.r_mm is not None:
            slope = _TENTH / self.r_sigma
            h[7, 7] += slope**2
            rhs[7] -= slope * self.away(u)
        h *= 1.0 + damping * np.eye(_SHARED)
        follow = np.linalg.solve(alone, between)
        whole -= np.tensordot(between, follow, ((0, 1), (0, 1)))
        step = np.linalg.lstsq(h, rhs, rcond=1e-12)[0]
        return step, follow[:, :, -1] - follow[:, :, :-1] @ step


def _bundle(views: Sequence[View], begin: Start, lens: tuple[str, ...], known: Known) -> tuple[float, Start]:
    """Return the misfit of a start after a bundle, in sigmas of the stars, and that start."""
    bundle = _Bundle(views, begin, lens, known)
    u, rotations = np.zeros(_SHARED), begin.rotations
    u[8] = begin.glass
    here = bundle.linearised(u, rotations)
    for _ in range(_ROUNDS):
        level, damping = bundle.misfit(here[0]), _ENOUGH
        before = bundle.cost(u, here[0], level)
        for _ in range(_STEPS):
            try:
                step, turns = bundle.step(u, here, level, damping)
            except np.linalg.LinAlgError:
                break
            there, turned = u + step, exp_map(turns) @ rotations
            linearised = bundle.linearised(there, turned)
            after = bundle.cost(there, linearised[0], level)
            if not after < before:
                damping *= 10.0
                continue
            u, rotations, here, damping = there, turned, linearised, max(0.1 * damping, 1e-9)
            if before - after < _ENOUGH * before:
                break
            before = after
    foot, r = bundle.centre_of(u)
    c = bundle.camera_of(u)
    f = begin.f_px * float(np.exp(c[0]))
    c[2:4] *= np.exp(-c[0])
    c[0] = 0.0
    return bundle.misfit(here[0]), Start(f, (float(foot[0]), float(foot[1]), r), rotations, c, float(u[8]))
