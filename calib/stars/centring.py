"""Centre of a star by point symmetry: half a turn about the centre leaves the printed star unchanged.

The module uses the neighbourhood of a single star. It does not use other stars or ids.

Let q(s) = c + A s + B(s, s) be the local map from the target plane to the image, with s in pitches from the star and
q in px. The centre c minimises

    sum over s of (I(q(s)) - I(q(-s)))^2 .

This is the symmetry cost of Schöps et al. (2020), arXiv:1912.02908, with two additions. Light that falls off across
the star, as at the rim of the disc, is not symmetric. So a relative slope g and an absolute slope b are fitted
together with c:

    I(q(s)) - I(q(-s)) = g.s (I(q(s)) + I(q(-s))) + b.s .

And the curvature B of perspective and distortion, which moves the middle of each pair, is taken from the neighbours.
An error of A moves the two points of a pair in opposite directions and leaves their middle in place.

The scatter of neighbouring stars scales the covariances, which are known up to a factor: neighbours share no pixels but
lie on a smooth map, so the stencil

    e = c(0, 0) - (c(1, 0) + c(-1, 0) + c(0, 1) + c(0, -1)) / 2
        + (c(1, 1) + c(1, -1) + c(-1, 1) + c(-1, -1)) / 4

leaves noise. It is the mask of Immerkær (1996) for images; it cancels every map of degree three or less, x^4 and y^4.

The compiled loops have no branch and no store, so that they run over several samples at once. Samples outside of the
image are left out before.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from calib.arrays import Array, Array32, Bools, Ints, selected
from calib.stars.grid_map import LocalMap
from calib.stars.symmetry_loops import SYMMETRY_UNKNOWNS, normal_equations

#: Half the side of the square in which symmetry is measured, pitches: the star's own cell and no more, so that
#: neighbours share no pixels.
SYMMETRY_REACH = 0.49
#: A step that is shorter is the last one, px. Each step is about a hundredth of the one before.
LAST_STEP_PX = 1e-3
#: A star that needs more steps, which shrink so fast, does not settle.
_MAX_STEPS = 12
#: Normal equations of a larger condition determine no step: of 16 digits, fewer than four are left.
_MAX_CONDITION = 1e12
#: Number of surrounded stars from which their scatter alone is used: it gives variances to about a fifth. Below it, the
#: typical factor is mixed in.
TRUSTED_FROM = 30
#: Largest normalised square that takes part: chi-square of two degrees of freedom exceeds it 1 in 22,000 times.
_MAX_SQUARE = 20.0
#: Neighbours of a star in the stencil, and their weights.
_STENCIL = {
    **dict.fromkeys([(1, 0), (-1, 0), (0, 1), (0, -1)], -0.5),
    **dict.fromkeys([(1, 1), (1, -1), (-1, 1), (-1, -1)], 0.25),
}


class SymmetryFit(NamedTuple):
    """Centres of N stars by symmetry."""

    centres: Array  # (N, 2) float64, px
    # (N, 2, 2) float64, (brightness / px)^2, J^T J of the centre after elimination of the slopes.
    information: Array
    mean_square: Array  # (N,) float64, brightness^2, mean square of the residuals
    # (N,) float64, 1/pitch, length of g: relative slope of the light across the star.
    light_slope: Array
    converged: Bools  # (N,) bool, whether the last step was shorter than `LAST_STEP_PX`


def smooth(image: Array32, sigma_px: float) -> Array32:
    """Blur an image by a Gaussian, against the noise of single pixels and the effect of the pixel grid."""
    return np.ascontiguousarray(cv2.GaussianBlur(image, (0, 0), sigma_px), np.float32)


def symmetry_samples(pitch_px: float) -> Array:
    """Return (M, 2) offsets s from the centre, pitches, one of each pair (s, -s), about a pixel apart."""
    side = int(np.clip(np.ceil(2 * SYMMETRY_REACH * pitch_px), 16, 64))
    steps = (np.arange(side) + 0.5) / side * 2.0 - 1.0
    u, v = np.meshgrid(steps * SYMMETRY_REACH, steps * SYMMETRY_REACH)
    upper = (v > 0) | ((v == 0) & (u > 0))
    return np.column_stack([u[upper], v[upper]])


def solve_steps(normal: Array, right: Array) -> tuple[Bools, Array]:
    """Solve the (N, 6, 6) normal equations of each star by the eigenvalues of its matrix.

    Scaled to a unit diagonal first (van der Sluis, 1969), because the unit of some unknowns is the grey value. Returns
    whether the image determines every unknown, (N,), as a flat one does not; and the (N, 6) steps, 0 where it does not.
    """
    diagonal = np.diagonal(normal, axis1=1, axis2=2)
    lit = np.asarray(np.isfinite(normal).all(axis=(1, 2)) & (diagonal > 0.0).all(axis=1))
    scale = np.sqrt(np.where(lit[:, None], diagonal, 1.0))
    scaled = np.where(lit[:, None, None], normal, 0.0) / scale[:, :, None] / scale[:, None, :]
    values, vectors = np.linalg.eigh(scaled)
    regular = lit & (values[:, 0] * _MAX_CONDITION > values[:, -1])
    along = np.einsum("nki,nk->ni", vectors, right / scale)
    along = np.divide(along, values, out=np.zeros_like(along), where=regular[:, None])
    return regular, np.einsum("nki,ni->nk", vectors, along) / scale


def centre_information(normal: Array) -> Array:
    """Return the (N, 2, 2) information of centres, without the slopes, from regular (N, 6, 6) equations."""
    shares = np.linalg.solve(normal[:, 2:, 2:], normal[:, 2:, :2])
    return normal[:, :2, :2] - normal[:, :2, 2:] @ shares


def refine_by_symmetry(
    image: Array32, guesses: Array, local_map: LocalMap, samples: Array, used_to: Array, reach_px: float
) -> SymmetryFit:
    """Find the centre of each star by symmetry, with Gauss-Newton steps of all stars at the same time.

    The cost is that of Schöps et al. (2020), arXiv:1912.02908, with this project's own additions; the head of the
    module gives the equations. The image is smoothed; ``used_to``, (N, 2) pitches, is how far each star's cell is used
    along columns and rows. A centre that moves further than ``reach_px`` from its guess, px, or whose cell lies too far
    outside of the image, is nan and not converged.
    """
    n, nan = len(guesses), np.full((len(guesses), 2, 2), np.nan)
    fit = SymmetryFit(nan[:, 0].copy(), nan, nan[:, 0, 0].copy(), nan[:, 0, 0].copy(), np.zeros(n, np.bool_))
    places = np.ascontiguousarray(samples.T, np.float32)
    maps = LocalMap(*map(np.ascontiguousarray, local_map))
    stars, centres, slopes = np.arange(n), guesses.astype(float), np.zeros((n, SYMMETRY_UNKNOWNS - 2))
    for _ in range(_MAX_STEPS):
        fixed = selected(maps, stars), places, used_to[stars]
        normal, right, mean_square = normal_equations(image, centres, *fixed, slopes)
        regular, step = solve_steps(normal, right)
        length = np.hypot(step[:, 0], step[:, 1])
        shorter = 1.5 / np.maximum(length, 1.5)
        centres -= shorter[:, None] * step[:, :2]
        slopes -= shorter[:, None] * step[:, 2:]
        kept = regular & (np.hypot(*(centres - guesses[stars]).T) <= reach_px)
        done = kept & (length < LAST_STEP_PX)
        settled = stars[done]
        fit.converged[settled], fit.centres[settled] = True, centres[done]
        fit.information[settled] = centre_information(normal[done])
        fit.mean_square[settled] = mean_square[done]
        fit.light_slope[settled] = np.hypot(slopes[done, 0], slopes[done, 1])
        going = kept & ~done
        stars, centres, slopes = stars[going], centres[going], slopes[going]
    return fit


def stencil_residuals(nodes: Ints, points: Array, nominal: Array) -> tuple[Array, Array]:
    """Compare each star that has all eight neighbours with them: (M, 2) e, px, and (M, 2, 2) covariances, px^2.

    The stencil is the mask of Immerkær (1996). The covariance of e is the sum of w^2 V over the stars, with their
    weights w and covariances V (JCGM 100:2008, section 5.1), known up to a factor.
    """
    low = nodes.min(axis=0, initial=0) - 1
    size = nodes.max(axis=0, initial=0) - low + 2
    star_at = np.full(size, -1)
    star_at[tuple((nodes - low).T)] = np.arange(len(nodes))
    around = star_at[tuple(np.moveaxis((nodes - low)[:, None, :] + np.array(list(_STENCIL)), 2, 0))]
    whole = (around >= 0).all(axis=1)
    around, weights = around[whole], np.array(list(_STENCIL.values()))
    residuals = points[whole] + weights @ points[around]
    return residuals, nominal[whole] + np.einsum("k,mkij->mij", weights**2, nominal[around])


def variance_factor(nodes: Ints, points: Array, nominal: Array, *, typical: float) -> float:
    """Estimate the factor of the (N, 2, 2) covariances from the scatter of neighbouring stars.

    A first value is the median of the normalised squares over 2 ln 2, the median of chi-square with two degrees of
    freedom. The result is the mean of those squares that are not far above it. This estimator is this project's own.
    The ``typical`` factor is mixed in if fewer than `TRUSTED_FROM` stars have all eight neighbours.
    """
    residuals, covariances = stencil_residuals(nodes, points, nominal)
    count, total = 0.0, 0.0
    if len(residuals):
        squares = np.einsum("mi,mij,mj->m", residuals, np.linalg.inv(covariances), residuals)
        factor = float(np.median(squares)) / (2 * np.log(2))
        if factor > 0:
            near = squares < _MAX_SQUARE * factor
            count, total = float(np.count_nonzero(near)), float(squares[near].sum()) / 2.0
    borrowed = max(TRUSTED_FROM - count, 0.0)
    return (total + borrowed * typical) / (count + borrowed)
