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
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.stars.grid_map import LocalMap
from calib.stars.symmetry_kernels import SYMMETRY_UNKNOWNS, normal_equations

#: Half the side of the square in which symmetry is measured, pitches: the star's own cell and no more, so that
#: neighbours share no pixels.
SYMMETRY_REACH = 0.49
#: A step that is shorter is the last one, px. Each step is about a hundredth of the one before.
LAST_STEP_PX = 1e-3
_MAX_STEPS = 12
#: Normal equations of a larger condition determine no step.
_MAX_CONDITION = 1e12


class SymmetryFit(NamedTuple):
    """Centres of N stars by symmetry."""

    centres: NDArray[np.float64]  # (N, 2) float64, px
    # (N, 2, 2) float64, (brightness / px)^2, J^T J of the centre after elimination of the slopes.
    information: NDArray[np.float64]
    mean_square: NDArray[np.float64]  # (N,) float64, brightness^2, mean square of the residuals
    # (N,) float64, 1/pitch, length of g: relative slope of the light across the star.
    light_slope: NDArray[np.float64]
    converged: NDArray[np.bool_]  # (N,) bool, whether the last step was shorter than `LAST_STEP_PX`

    def select(self, mask: NDArray[np.bool_]) -> SymmetryFit:
        """Return the fits of some stars by an (N,) mask, in the same order."""
        return SymmetryFit(
            self.centres[mask],
            self.information[mask],
            self.mean_square[mask],
            self.light_slope[mask],
            self.converged[mask],
        )


def smooth(image: NDArray[np.float32], sigma_px: float) -> NDArray[np.float32]:
    """Blur an image by a Gaussian, against the noise of single pixels and the effect of the pixel grid."""
    return np.ascontiguousarray(cv2.GaussianBlur(image, (0, 0), sigma_px), np.float32)


def symmetry_samples(pitch_px: float) -> NDArray[np.float64]:
    """Return (M, 2) offsets s from the centre, pitches, one of each pair (s, -s), about a pixel apart."""
    side = int(np.clip(np.ceil(2 * SYMMETRY_REACH * pitch_px), 16, 64))
    steps = (np.arange(side) + 0.5) / side * 2.0 - 1.0
    u, v = np.meshgrid(steps * SYMMETRY_REACH, steps * SYMMETRY_REACH)
    upper = (v > 0) | ((v == 0) & (u > 0))
    return np.column_stack([u[upper], v[upper]])


class _Steps(NamedTuple):
    """Gauss-Newton steps of N stars."""

    regular: NDArray[np.bool_]  # (N,) bool, whether the image determines every unknown; a flat one does not
    step: NDArray[np.float64]  # (N, 6) float64, 0 where it does not


def solve_steps(normal: NDArray[np.float64], right: NDArray[np.float64]) -> _Steps:
    """Solve the (N, 6, 6) normal equations of each star by the eigenvalues of its matrix.

    Scaled to a unit diagonal first (van der Sluis, 1969), because the unit of some unknowns is the grey value.
    """
    diagonal = np.diagonal(normal, axis1=1, axis2=2)
    lit = np.asarray(np.isfinite(normal).all(axis=(1, 2)) & (diagonal > 0.0).all(axis=1))
    scale = np.sqrt(np.where(lit[:, None], diagonal, 1.0))
    scaled = np.where(lit[:, None, None], normal, 0.0) / scale[:, :, None] / scale[:, None, :]
    values, vectors = np.linalg.eigh(scaled)
    regular = lit & (values[:, 0] * _MAX_CONDITION > values[:, -1])
    along = np.einsum("nki,nk->ni", vectors, right / scale)
    along = np.divide(along, values, out=np.zeros_like(along), where=regular[:, None])
    return _Steps(regular, np.einsum("nki,ni->nk", vectors, along) / scale)


def centre_information(normal: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the (N, 2, 2) information of centres, without the slopes, from regular (N, 6, 6) equations."""
    shares = np.linalg.solve(normal[:, 2:, 2:], normal[:, 2:, :2])
    return normal[:, :2, :2] - normal[:, :2, 2:] @ shares


def refine_by_symmetry(
    image: NDArray[np.float32],
    guesses: NDArray[np.float64],
    local_map: LocalMap,
    samples: NDArray[np.float64],
    used_to: NDArray[np.float64],
    reach_px: float,
) -> SymmetryFit:
    """Find the centre of each star by symmetry, with Gauss-Newton steps of all stars at the same time.

    The cost is that of Schöps et al. (2020), arXiv:1912.02908, with this project's own additions; the head of the
    module gives the equations. The image is smoothed; ``used_to``, (N, 2) pitches, is how far each star's cell is used
    along columns and rows. A centre that moves further than ``reach_px`` from its guess, px, or whose cell lies too far
    outside of the image, is nan and not converged.
    """
    n = len(guesses)
    fit = SymmetryFit(
        np.full((n, 2), np.nan),
        np.full((n, 2, 2), np.nan),
        np.full(n, np.nan),
        np.full(n, np.nan),
        np.zeros(n, np.bool_),
    )
    pixels, places = image.ravel(), np.ascontiguousarray(samples.T, np.float32)
    linear, quadratic = np.ascontiguousarray(local_map.linear), np.ascontiguousarray(local_map.quadratic)
    stars, centres, slopes = np.arange(n), guesses.astype(float), np.zeros((n, SYMMETRY_UNKNOWNS - 2))
    for _ in range(_MAX_STEPS):
        normal = np.zeros((len(stars), SYMMETRY_UNKNOWNS, SYMMETRY_UNKNOWNS))
        right, mean_square = np.zeros((len(stars), SYMMETRY_UNKNOWNS)), np.empty(len(stars))
        fixed = linear[stars], quadratic[stars], places, used_to[stars]
        filled = np.empty_like(places), normal, right, mean_square
        normal_equations(pixels, image.shape[1], centres, *fixed, slopes, *filled)
        regular, step = solve_steps(normal, right)
        length = np.hypot(step[:, 0], step[:, 1])
        shorter = 1.5 / np.maximum(length, 1.5)
        centres -= shorter[:, None] * step[:, :2]
        slopes -= shorter[:, None] * step[:, 2:]
        kept = regular & (np.hypot(*(centres - guesses[stars]).T) <= reach_px)
        done = kept & (length < LAST_STEP_PX)
        found = stars[done]
        fit.converged[found], fit.centres[found] = True, centres[done]
        fit.information[found], fit.mean_square[found] = centre_information(normal[done]), mean_square[done]
        fit.light_slope[found] = np.hypot(slopes[done, 0], slopes[done, 1])
        going = kept & ~done
        stars, centres, slopes = stars[going], centres[going], slopes[going]
    return fit
