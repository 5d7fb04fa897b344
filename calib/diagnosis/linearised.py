"""The joint adjustment linearised at its optimum: what unexpected shifts of views do to the residuals.

Only what a changed camera, centre or rotation cannot explain leaves a trace. It is linear algebra on a few stars of
each view, so that hundreds of hypotheses cost no more than one step of an adjustment.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib.adjustment.bundle import Bundle
from calib.adjustment.loss import Loss
from calib.adjustment.parameters import AdjustmentParameters
from calib.arrays import Array

#: Residuals above this multiple of the noise that neighbouring stars show are mostly systematic. They vary slowly over
#: a view and resemble each other in all views, so they count as this number of independent components: for 72 places,
#: the residuals must fall to 60 %. With more components, sound views of a real collimator were called wrong.
_SYSTEMATIC = 1.3
_INDEPENDENT = 18


@dataclass(frozen=True)
class ShiftEquations:
    """The cost of an adjustment as a function of a shift of each of n views, everything else adjusted to it.

    Sum of squares, weighted, for shifts s_i: ``squares - 2 sum_i gradient_i s_i + sum_ij s_i information_ij s_j``.
    """

    squares: float  # Sum of the squared weighted residuals without shifts
    gradient: Array  # (n, 2) float64, 1 / mm for shifts of the target, 1 / px for shifts of the image
    information: Array  # (n, 2, n, 2) float64, the same units squared

    def squares_after(self, shifts: Array) -> Array:
        """Return (K,) sums of squares, at least 0, after (K, n, 2) shifts of the views, mm or px."""
        flat = shifts.reshape(len(shifts), -1)
        information = self.information.reshape(flat.shape[1], -1)
        change = ((flat @ information - 2.0 * self.gradient.ravel()) * flat).sum(axis=1)
        return np.asarray(np.maximum(self.squares + change, 0.0))


def plain_bundle(bundle: Bundle, stars: int) -> Bundle:
    """Return a bundle of some of the stars, with shared camera and centre."""
    return Bundle(bundle.observations, bundle.names).thinned(stars)


def rms_px(bundle: Bundle, parameters: AdjustmentParameters) -> float:
    """Return the rms length of the residual vectors, px; infinite if a star cannot be projected."""
    with np.errstate(invalid="ignore", over="ignore"):
        rms = float(np.sqrt((bundle.residuals_px(parameters) ** 2).sum(axis=1).mean()))
    return rms if np.isfinite(rms) else float("inf")


def independent_components(bundle: Bundle, rms: float, noise_px: float) -> float:
    """Return the number of independent residual components, if the rms length of the residual vectors is as given, px.

    The noise is that of neighbouring stars, px, 1 sigma per axis.
    """
    obs = bundle.observations
    components = max(2 * len(obs.view) - len(bundle.names) - 3 * len(obs.slices), 0)
    systematic = rms / np.sqrt(2.0) > _SYSTEMATIC * noise_px
    return float(min(components, _INDEPENDENT) if systematic else components)


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
