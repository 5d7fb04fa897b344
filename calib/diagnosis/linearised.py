"""The joint adjustment linearised at its optimum: what an unexpected shift of one view does to the residuals.

Only what a changed camera, centre or rotation cannot explain leaves a trace. It is linear algebra on a few stars of
each view, so that hundreds of hypotheses cost no more than one step of an adjustment.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib.adjustment.bundle import Bundle
from calib.adjustment.loss import Loss
from calib.adjustment.parameters import AdjustmentParameters

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ShiftEquations:
    """The cost of an adjustment as a function of a shift of each of n views, everything else adjusted to it.

    Sum of squares, weighted, for shifts s_i: ``squares - 2 sum_i gradient_i s_i + sum_ij s_i information_ij s_j``.
    """

    squares: float  # Sum of the squared weighted residuals without shifts
    gradient: Array  # (n, 2) float64, 1 / mm for shifts of the target, 1 / px for shifts of the image
    information: Array  # (n, 2, n, 2) float64, the same units squared

    def squares_after(self, view: int, shifts: Array) -> Array:
        """Return (K,) sums of squares, at least 0, after (K, 2) shifts, mm or px, of one view alone."""
        own = self.information[view, :, view]
        change = np.einsum("ki,ij,kj->k", shifts, own, shifts) - 2.0 * shifts @ self.gradient[view]
        return np.asarray(np.maximum(self.squares + change, 0.0))


def plain_bundle(bundle: Bundle, stars: int) -> Bundle:
    """Return a bundle of some of the stars, with shared camera and centre."""
    return Bundle(bundle.observations, bundle.names).thinned(stars)


def target_shifts(bundle: Bundle, parameters: AdjustmentParameters) -> ShiftEquations:
    """Return the equations of shifts of the target positions of each view, mm, of a bundle of `plain_bundle`.

    Gauss and Newton's linearisation; the free parameters are eliminated by the Schur complement (Triggs et al., 2000,
    section 6.1). A shift of the target is the opposite shift of the centre.
    """
    return _shift_equations(bundle, parameters, of_image=False)


def image_shifts(bundle: Bundle, parameters: AdjustmentParameters) -> ShiftEquations:
    """Return the equations of shifts of the image points of each view, px; else as `target_shifts`."""
    return _shift_equations(bundle, parameters, of_image=True)


def _shift_equations(bundle: Bundle, parameters: AdjustmentParameters, *, of_image: bool) -> ShiftEquations:
    """Return the reduced equations of target shifts or of image shifts."""
    squares, gram, score = _without_turns(bundle, parameters, of_image=of_image)
    n, count = len(gram), len(bundle.names)
    gradient, coupling = score[:, count:], gram[:, count:, :count]
    information = np.zeros((n, 2, n, 2))
    information[np.arange(n), :, np.arange(n)] = gram[:, count:, count:]
    if count:
        shared = gram[:, :count, :count].sum(axis=0)
        scale = 1.0 / np.sqrt(np.maximum(np.diag(shared), np.finfo(float).tiny))
        flat = coupling.reshape(2 * n, count) * scale
        inverse = np.linalg.pinv(shared * np.outer(scale, scale), rcond=1e-13, hermitian=True)
        right = scale * score[:, :count].sum(axis=0)
        squares -= float(right @ inverse @ right)
        gradient = gradient - (flat @ inverse @ right).reshape(n, 2)
        information = information - (flat @ inverse @ flat.T).reshape(n, 2, n, 2)
    return ShiftEquations(max(squares, 0.0), gradient, information)


def _without_turns(
    bundle: Bundle, parameters: AdjustmentParameters, *, of_image: bool
) -> tuple[float, Array, Array]:
    """Return sum of squares, normal matrices (n, G + 2, G + 2) and gradients (n, G + 2) of n views.

    They are of the shared parameters and two shifts a view; its rotation is eliminated as in `target_shifts`.
    """
    count = len(bundle.names)
    # A shift of the image is one of the principal point; a shift of the target is the opposite one of the centre.
    names = (*bundle.names, "cx", "cy") if of_image else bundle.names
    freed = replace(bundle, names=names, free_centres=not of_image)
    equations = freed.equations(parameters, Loss("l2"))
    normal, gradient = equations.normal, equations.right
    shift, turn = ((0, 1), (2, 3, 4)) if of_image else ((3, 4), (0, 1, 2))
    kept, turned = [*range(count), *(count + k for k in shift)], [count + k for k in turn]
    sign = np.ones(count + 2)
    sign[count:] = 1.0 if of_image else -1.0
    coupling = sign[:, None] * normal[:, kept][:, :, turned]
    inverse = np.linalg.pinv(normal[:, turned][:, :, turned], hermitian=True)
    answer = coupling @ inverse
    own = gradient[:, turned]
    squares = float((bundle.weighted_residuals(parameters) ** 2).sum())
    return (
        squares - float(np.einsum("ni,nij,nj->", own, inverse, own)),
        np.outer(sign, sign) * normal[:, kept][:, :, kept] - answer @ np.swapaxes(coupling, 1, 2),
        sign * gradient[:, kept] - (answer @ own[:, :, None])[:, :, 0],
    )
