"""Centres of printed circles, from the profile of brightness across their edge.

Point symmetry is not exact for a circle on a tilted board: blur has the same width in the image everywhere, so the near
edge is sharper on the board than the far one, and the slopes of the light that `calib.stars.centring` fits with the
centre take up the difference. A circle of radius R px was then off by about 3 B s^2 / (a R) px, with a blur of s px, a
pitch of a px and a curvature of the map of B px per pitch^2, enough for 0.03 % of the focal length.

So the profile is fitted. With the distance d of a pixel from the edge, px, outside positive, and s its place on the
board relative to the centre, pitches, the brightness is

    I = p0 + p1 F + p2 F (1 - F) + s.(q0 + q1 F),      F = Phi((d + s_b^2 / 2R) / s_b) .

The width s_b is that of the blur; s_b^2 / 2R is how far blur moves the middle of a curved edge; p2 is a response that
is not linear, such as a gamma; q0 and q1 are slopes of the light on either side. Distances follow the local map, with
the curvature of perspective and distortion. The model and its solution are this project's own.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.special import ndtr

from calib.arrays import Array, Array32, Bools
from calib.stars.centring import LAST_STEP_PX, centre_information, solve_steps
from calib.stars.grid_map import LocalMap

#: Unknowns: centre x, y; radius, pitches; width of the blur, px; then the seven linear ones of the head.
_UNKNOWNS = 11
#: First guesses of the width of the blur, px, and least and largest width.
_WIDTH_PX, _NARROWEST_PX, _WIDEST_PX = 1.0, 0.4, 6.0
#: At most: it ends when no centre moves farther than `LAST_STEP_PX`.
_MAX_STEPS = 25
#: Pixels within this number of pixels of the edge, and this share of the radius, are used: others say nothing of the
#: edge.
_BAND_PX, _BAND_SHARE = 6.0, 0.3
#: A step changes the radius by this share at most, and the centre by this number of pixels: the model is linear no
#: farther.
_MOST_SHARE, _MOST_PX = 0.2, 1.5
#: Circles fitted at the same time; more would need much memory.
_AT_ONCE = 128


class DiscFit(NamedTuple):
    """Centres of N circles; nan where not converged."""

    centres: Array  # (N, 2) px
    information: Array  # (N, 2, 2) (brightness / px)^2, of the centre without the other unknowns
    mean_square: Array  # (N,) brightness^2, of the residuals
    converged: Bools  # (N,)


def fit_discs(image: Array32, guesses: Array, local_map: LocalMap, cell: float, reach_px: float) -> DiscFit:
    """Find the centres of circles by Gauss-Newton steps (own model), from (N, 2) px guesses in a smoothed image.

    ``cell`` is how far from its centre a circle's surroundings are used, pitches. A centre that moves further than
    ``reach_px`` from its guess is not converged.
    """
    parts = []
    for start in range(0, len(guesses), _AT_ONCE):
        some = slice(start, start + _AT_ONCE)
        maps = LocalMap(local_map.linear[some], local_map.quadratic[some])
        parts.append(_fit(image, guesses[some], maps, cell, reach_px))
    return DiscFit(*map(np.concatenate, zip(*parts, strict=True)))


def _fit(image: Array32, guesses: Array, local_map: LocalMap, cell: float, reach_px: float) -> DiscFit:
    pixels, radius = _surroundings(image, guesses, local_map, cell)
    centres, width, n = guesses.astype(float), np.full(len(guesses), _WIDTH_PX), len(guesses)
    for _ in range(_MAX_STEPS):
        columns, off = _columns(pixels, (centres, radius, width), local_map)
        turned = np.swapaxes(columns, 1, 2)
        normal = turned @ columns
        regular, step = solve_steps(normal, (turned @ off[..., None])[..., 0])
        length = np.where(regular, np.hypot(step[:, 0], step[:, 1]), 0.0)
        centres += step[:, :2] * np.minimum(1.0, _MOST_PX / np.maximum(length, _MOST_PX))[:, None]
        radius += np.clip(step[:, 2], -_MOST_SHARE * radius, _MOST_SHARE * radius)
        width = np.clip(width + step[:, 3], width / 2, 2 * width).clip(_NARROWEST_PX, _WIDEST_PX)
        if (length < LAST_STEP_PX).all():
            break
    freedom = np.maximum(pixels.used.sum(axis=1) - _UNKNOWNS, 1)
    near = np.hypot(*(centres - guesses).T) <= reach_px
    converged = np.asarray(regular & near & (length < LAST_STEP_PX))
    information = np.full((n, 2, 2), np.nan)
    information[converged] = centre_information(normal[converged])
    centres[~converged] = np.nan
    return DiscFit(centres, information, (off * off).sum(axis=1) / freedom, converged)


class _Pixels(NamedTuple):
    """Pixels around N circles, P of each; some of them are not used."""

    at: Array  # (N, P, 2) px
    values: Array  # (N, P) brightness
    used: Bools  # (N, P)


def _surroundings(image: Array32, guesses: Array, local_map: LocalMap, cell: float) -> tuple[_Pixels, Array]:
    """Return the pixels around the edge of each circle, and a first radius, (N,) pitches.

    The radius is that of a disc that is as bright as the middle, and whose share of the cell is that of the light.
    """
    far = int(np.ceil(cell * np.linalg.norm(local_map.linear, axis=(1, 2)).max())) + 2
    v, u = np.mgrid[-far : far + 1, -far : far + 1].reshape(2, 1, -1)
    at = np.stack([u, v], axis=-1) + np.round(guesses).astype(np.int64)[:, None]
    height, width = image.shape
    inside = (at >= 0).all(axis=2) & (at[..., 0] < width) & (at[..., 1] < height)
    values = image[at[..., 1].clip(0, height - 1), at[..., 0].clip(0, width - 1)].astype(float)
    distance = np.linalg.norm(_places(at.astype(float), guesses, local_map), axis=2)
    cells = inside & (distance <= cell)
    middle = inside & ((distance < 0.1 * cell) | (distance == distance.min(axis=1, keepdims=True)))
    level, ground, mean = (
        np.sum(values * part, axis=1) / np.maximum(part.sum(axis=1), 1)
        for part in (middle, cells & (distance > 0.9 * cell), cells)
    )
    share = np.divide(mean - ground, level - ground, out=np.full(len(mean), 0.3), where=level != ground)
    radius, pitch = cell * np.sqrt(share.clip(0.02, 0.9)), _pitches(local_map)
    band = _BAND_PX / pitch + _BAND_SHARE * radius
    used = cells & (np.abs(distance - radius[:, None]) <= band[:, None])
    order = np.argsort(~used, axis=1, kind="stable")[:, : used.sum(axis=1).max()]
    rows = np.arange(len(order))[:, None]
    return _Pixels(at[rows, order].astype(float), values[rows, order], used[rows, order]), radius


def _places(at: Array, centres: Array, local_map: LocalMap) -> Array:
    """Return where (N, P, 2) pixels lie on the board relative to the centres, (N, P, 2) pitches.

    Own iteration s <- A^-1 (q - c - B(s, s)) of the local map q = c + A s + B(s, s).
    """
    inverse, b = np.linalg.inv(local_map.linear).swapaxes(1, 2), local_map.quadratic.swapaxes(1, 2)
    off = at - centres[:, None]
    s = off @ inverse
    for _ in range(3):  # each step leaves a few hundredths of the error
        terms = np.stack([s[..., 0] ** 2, s[..., 0] * s[..., 1], s[..., 1] ** 2], axis=-1)
        s = (off - terms @ b) @ inverse
    return s


def _pitches(local_map: LocalMap) -> Array:
    """Return the (N,) px of a pitch at each circle."""
    return np.asarray(np.sqrt(np.abs(np.linalg.det(local_map.linear))))


def _columns(pixels: _Pixels, disc: tuple[Array, Array, Array], local_map: LocalMap) -> tuple[Array, Array]:
    """Return the derivatives of the model, (N, P, 11), and brightness minus model, (N, P); 0 where not used.

    disc: centres, radius and width. The linear unknowns are solved for on the way.
    """
    centres, radius, width = disc
    s = _places(pixels.at, centres, local_map)
    x, y, distance_pitches = s[..., 0], s[..., 1], np.linalg.norm(s, axis=2)
    outwards = _gradient(s, distance_pitches, local_map)  # of the distance from the centre, pitches per px
    steep = np.linalg.norm(outwards, axis=2)
    distance = (distance_pitches - radius[:, None]) / steep
    wide, curved = width[:, None], 0.5 / (radius * _pitches(local_map))[:, None]
    z = distance / wide + wide * curved
    share, density = ndtr(z), np.exp(-0.5 * z * z) / np.sqrt(2 * np.pi)
    linear = np.stack([np.ones_like(z), share, share * (1 - share), x, y, x * share, y * share], axis=-1)
    linear *= pixels.used[..., None]
    turned = np.swapaxes(linear, 1, 2)
    solved = solve_steps(turned @ linear, (turned @ pixels.values[..., None])[..., 0])[1]
    off = pixels.values * pixels.used - (linear @ solved[..., None])[..., 0]
    _, p1, p2, _, _, qx, qy = solved.T[..., None]
    by_z = (p1 + p2 * (1 - 2 * share) + qx * x + qy * y) * density * pixels.used
    moved = -outwards * (by_z / (steep * wide))[..., None]
    others = np.stack([-by_z / (steep * wide), by_z * (curved - distance / wide**2)], axis=-1)
    return np.concatenate([moved, others, linear], axis=-1), off


def _gradient(s: Array, distance: Array, local_map: LocalMap) -> Array:
    """Return the gradient in the image, (N, P, 2) pitches per px, of the distance from the centre on the board.

    Own derivation, by the chain rule: J^-T s / |s|, with J = dq/ds = A + dB(s, s)/ds of the local map.
    """
    a, b = local_map.linear[:, None], local_map.quadratic[:, None]
    x, y = s[..., 0], s[..., 1]
    xx, xy = (a[..., i, 0] + 2 * b[..., i, 0] * x + b[..., i, 1] * y for i in (0, 1))
    yx, yy = (a[..., i, 1] + b[..., i, 1] * x + 2 * b[..., i, 2] * y for i in (0, 1))
    scale = 1.0 / (np.maximum(distance, 1e-12) * (xx * yy - yx * xy))
    return np.stack([(yy * x - xy * y) * scale, (xx * y - yx * x) * scale], axis=-1)
