"""Variance components of inconsistent views: smooth displacements of the target that differ from view to view.

A collimator that deviates from the model displaces neighbouring stars alike, and differently in every view. The
displacement is written as polynomials of the position in the beam up to degree four, and as a radial displacement of
the beam's rim. In each view the coefficients of one degree are random with a common variance. Shifts of the whole beam
(degree zero) have one variance along X and one along Y, because causes that move the centre have a direction. All
residuals together determine these variances by restricted maximum likelihood (REML; Patterson and Thompson, 1971).
Three views suffice, because each contributes some thirty coefficients. The covariance of the parameters is then H^-1
(sum over views of S D S^T) H^-1, where S holds the scores of a view's coefficients and D their variances.

The scores of three views have two degrees of freedom only, which is too few for a cluster-robust covariance. With more
views, the variance components give the working covariance of `calib.uncertainty.cluster_robust`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.adjustment.bundle import Bundle
from calib.adjustment.levenberg_marquardt import Loss
from calib.adjustment.parameters import AdjustmentParameters
from calib.uncertainty.field_equations import FieldEquations, monomials
from calib.uncertainty.repeats import noise_growth, views_of_poses
from calib.uncertainty.restricted_likelihood import PoseForms, maximum_likelihood

Array = NDArray[np.float64]

_DEGREES = 4
#: Powers of the radius in the displacements of a rim: the pupil is only partly filled (`calib.model.aberrations`).
_RIM_POWERS = (4, 10)
#: Combinations of coefficients with an eigenvalue below this share of the largest are not determined.
_DETERMINED = 1e-7
#: Components of which the scores show less than this share of the best shown one are taken as zero.
_SHOWN = 1e-9
#: Smallest noise variance, as a share of the mean square residual; needed if stars are hardly more than coefficients.
_MIN_NOISE_SHARE = 1e-3


@dataclass(frozen=True)
class VarianceComponents:
    """Variance components of the views, and the covariance that follows."""

    # (7,) float64 1-sigma displacement of a star, mm, by the shift along X, the shift along Y, the
    # polynomials of degree 1 to 4, and the rim; fewer if no view has enough stars for all degrees.
    sigma_mm: Array
    # field_covariance, star_covariance, prior_covariance: (G, G) float64 covariance of the shared parameters
    # from the displacements, from star noise, and from priors.
    field_covariance: Array
    star_covariance: Array
    prior_covariance: Array
    # (n, G, G) float64 covariance of each view's score for the shared parameters, from displacements and star
    # noise.
    score_covariances: Array
    # Degrees of freedom of the least certain variance of a parameter (Satterthwaite, 1946).
    effective_degrees_of_freedom: float

    @property
    def covariance(self) -> Array:
        """(G, G) float64 covariance of the shared parameters from all sources."""
        return np.asarray(self.field_covariance + self.star_covariance + self.prior_covariance)


@dataclass(frozen=True)
class _ComponentEquations:
    """Reduced normal equations of the field coefficients of all views."""

    score: Array  # (C,) float64 score of each coefficient
    normal: Array  # (C, C) float64 normal matrix: coefficients u have the expected score normal @ u
    # (n, F, F) float64 part of it that each view has of its own; zero for coefficients that a view does not
    # have.
    blocks: Array
    place: NDArray[np.int64]  # (C,) int64 place of each coefficient among the n F of the blocks
    coupling: Array  # (G, C) float64 coupling between shared parameters and coefficients
    group: NDArray[np.int64]  # (C,) int64 variance component of each coefficient
    view: NDArray[np.int64]  # (C,) int64 view of each coefficient
    information: Array  # (n, G, G) float64 information of each view on the shared parameters
    # shared, inverse: (G, G) float64 information of all views and the prior, and its inverse.
    shared: Array
    inverse: Array
    # (n, G, G) float64 covariance of the score of each pose by the noise of stars and readings.
    score_noise: Array
    noise: float  # Variance of a star's own noise, in units of weighted residuals squared


def variance_components(
    bundle: Bundle,
    parameters: AdjustmentParameters,
    loss: Loss,
    at_optimum: FieldEquations | None = None,
) -> VarianceComponents:
    """Estimate the variance components of the views at the optimum (REML; Patterson and Thompson, 1971).

    at_optimum: Residuals and derivatives at the optimum; None to compute them.
    """
    at_optimum = at_optimum or FieldEquations(bundle, parameters, loss)
    equations = _component_equations(bundle, parameters, at_optimum)
    return _propagate(bundle, equations, *maximum_likelihood(*_forms(equations)))


def _forms(equations: _ComponentEquations) -> tuple[PoseForms, Array]:
    """Return the quadratic forms of the components, and the variances to begin with; zero if undetermined.

    Combinations of coefficients that are not determined are taken out of the normal matrix: own choice.
    """
    eigenvalues, vectors = np.linalg.eigh(equations.normal)
    determined = eigenvalues > _DETERMINED * eigenvalues[-1]
    known, others = vectors[:, determined], vectors[:, ~determined]
    along = known.T @ equations.score
    squares = float((along**2 / eigenvalues[determined]).sum())
    own = np.bincount(equations.group, (known**2) @ eigenvalues[determined])
    start = np.divide(squares, len(own) * own, out=np.zeros_like(own), where=own > _SHOWN * own.max())
    # Scaled to a unit diagonal: the parameters differ by many orders of magnitude.
    scale = 1.0 / np.sqrt(np.diag(equations.shared))
    left, count = eigenvalues[~determined], len(scale)
    rows = np.hstack([equations.coupling.T * scale, others * np.sqrt(np.abs(left))])
    core = np.diag(np.concatenate([np.zeros(count), np.where(left < 0.0, -1.0, 1.0)]))
    core[:count, :count] = equations.shared * np.outer(scale, scale)
    poses, width = len(equations.blocks), equations.blocks.shape[1]
    at = equations.place
    group, score = np.full(poses * width, -1), np.zeros(poses * width)
    every = np.zeros((poses * width, rows.shape[1]))
    group[at], score[at], every[at] = equations.group, known @ along, rows
    return PoseForms(score, equations.blocks, every, core, group, equations.noise), start


def _propagate(
    bundle: Bundle, equations: _ComponentEquations, variances: Array, fisher: Array
) -> VarianceComponents:
    """Propagate the variance components to the shared parameters.

    With the response A of the parameters to coefficients of variances D, the covariance is A D A^T (JCGM 100:2008,
    section 5.2). Degrees of freedom of a variance V: 2 V^2 / Var(V) (Satterthwaite, 1946).
    """
    inverse = equations.inverse
    response = inverse @ equations.coupling
    each = np.stack(
        [(response[:, equations.group == kind] ** 2).sum(axis=1) for kind in range(len(variances))]
    )
    fields = (response * variances[equations.group]) @ response.T
    stars = inverse @ equations.score_noise.sum(axis=0) @ inverse
    prior = np.zeros_like(inverse)
    if bundle.prior is not None:
        at = [bundle.names.index(name) for name in bundle.prior.names]
        scaled = bundle.noise_variance * inverse[:, at]
        prior = scaled @ bundle.prior.information @ scaled.T
    total = np.diag(fields + stars + prior)
    # The uncertainty of each parameter's variance, propagated from that of the logarithms of the components.
    by_log = (each * variances[:, None]).T
    spread = np.einsum("gk,kl,gl->g", by_log, np.linalg.pinv(fisher, rcond=1e-6, hermitian=True), by_log)
    freedom = 2.0 * total**2 / np.maximum(spread, np.finfo(float).tiny)
    return VarianceComponents(
        np.sqrt(variances),
        fields,
        stars,
        prior,
        _score_covariances(equations, variances),
        float(freedom.min()),
    )


def _score_covariances(equations: _ComponentEquations, variances: Array) -> Array:
    """Return (n, G, G) the covariance of each view's score.

    Own derivation: noise A + S D S^T, with the information A of the view.
    """
    scores = equations.score_noise.copy()
    for i in range(len(scores)):
        own = equations.view == i
        scores[i] += (equations.coupling[:, own] * variances[equations.group[own]]) @ equations.coupling[
            :, own
        ].T
    return np.asarray(scores)


def _component_equations(
    bundle: Bundle, parameters: AdjustmentParameters, at_optimum: FieldEquations
) -> _ComponentEquations:
    """Set up the equations of the field coefficients, with local and shared parameters eliminated.

    Own derivation. Local parameters are eliminated by the Schur complement (Triggs et al., 2000, section 6.1), shared
    ones in the same way.
    """
    residuals, count = at_optimum.residuals, len(bundle.names)
    rims = _rim_shapes(bundle, parameters)
    information, normals, couplings, scores, groups, squares = [], [], [], [], [], 0.0
    read = []
    for views in views_of_poses(bundle):
        fields, group = basis_fields(bundle, views, rims)
        each = [at_optimum.of_view(i, own) for i, own in zip(views, fields, strict=True)]
        reduced = np.sum([view.normal for view in each], axis=0)
        information.append(reduced[:count, :count])
        read.append(np.sum([view.by_readings for view in each], axis=0))
        normals.append(reduced[count:, count:])
        couplings.append(reduced[:count, count:])
        scores.append(np.sum([view.score for view in each], axis=0))
        groups.append(group)
        squares += sum(view.squares for view in each)
    shared = np.asarray(sum(information, start=bundle.prior_information))
    inverse = np.linalg.inv(shared)
    coupling, score = np.hstack(couplings), np.concatenate(scores)
    freedom = at_optimum.degrees_of_freedom
    blocks, place = _stacked(normals)
    explained = _explained(blocks, score, place)
    noise = max(
        (squares - explained) / max(freedom - len(score), 1), _MIN_NOISE_SHARE * squares / len(residuals)
    )
    together = _block_diagonal(normals) - coupling.T @ inverse @ coupling
    group = np.unique(np.concatenate(groups), return_inverse=True)[1]
    view = np.repeat(np.arange(len(groups)), [len(own) for own in groups])
    symmetric = 0.5 * (together + together.T)
    grown = noise_growth(bundle, residuals)
    return _ComponentEquations(
        score,
        symmetric,
        blocks,
        place,
        coupling,
        group,
        view,
        np.array(information),
        shared,
        inverse,
        _score_noise(bundle, np.array(information), np.array(read), noise, grown),
        noise,
    )


def _explained(blocks: Array, score: Array, place: NDArray[np.int64]) -> float:
    """Return the sum of squares that the coefficients of each pose explain, each pose by itself."""
    eigenvalues, vectors = np.linalg.eigh(blocks)
    stacked = np.zeros((len(blocks), blocks.shape[1], 1))
    stacked.reshape(-1)[place] = score
    along = (np.swapaxes(vectors, 1, 2) @ stacked)[:, :, 0]
    determined = eigenvalues > _DETERMINED * eigenvalues[:, -1:]
    return float((along[determined] ** 2 / eigenvalues[determined]).sum())


def _score_noise(bundle: Bundle, information: Array, read: Array, noise: float, growth: Array) -> Array:
    """Return (n, G, G) the covariance of each pose's score by the noise of stars and readings.

    Own derivation: stars have the noise that is left beside the fields, readings the one that the bundle gives them.
    Repeated views enlarge the stars' part.
    """
    return np.asarray(growth[:, None, None] * noise * (information - read) + bundle.noise_variance * read)


def basis_fields(
    bundle: Bundle, views: Sequence[int], rims: Array | None
) -> tuple[list[Array], NDArray[np.int64]]:
    """Return basis fields over the stars of a pose, and the group of each field.

    They are polynomials along each axis, of unit mean square and orthogonal over the stars of the pose. Own choice of
    the fields; they are made orthogonal by QR decomposition.

    rims: (N, 2, R) displacements of the model's rim terms; None for those of a disc about the stars' mean.
    Returns: For each view of the pose (m, 2, F) displacements of its m stars by a unit of each coefficient,
      mm; and (F,) int64, the group of each coefficient: the shift along X (0), the shift along Y (1), the
      degrees 1 to 4 (2 to 5), and the rim (6).
    """
    slices = [bundle.observations.slices[i] for i in views]
    target_mm = np.concatenate([bundle.observations.target[rows, :2] for rows in slices])
    away = target_mm - target_mm.mean(axis=0)
    away /= np.linalg.norm(away, axis=1).max()
    values, degree = (each[..., : len(away)] for each in monomials(away, _DEGREES))
    smooth = np.linalg.qr(values)[0] * np.sqrt(len(away))
    if rims is None:
        radius = np.linalg.norm(away, axis=1)[:, None]
        shapes = np.stack([radius**power * away for power in _RIM_POWERS], axis=2)
    else:
        shapes = np.concatenate([rims[rows] for rows in slices])
    still = np.zeros_like(smooth)
    fields = np.concatenate(
        [
            np.stack([smooth, still], axis=1),
            np.stack([still, smooth], axis=1),
            shapes / np.sqrt((shapes**2).mean(axis=(0, 1))),
        ],
        axis=2,
    )
    bent = (1 + degree[1:]).tolist()
    group = np.array([0, *bent, 1, *bent, *[_DEGREES + 2] * shapes.shape[2]])
    return np.split(fields, np.cumsum([rows.stop - rows.start for rows in slices])[:-1]), group


def _rim_shapes(bundle: Bundle, parameters: AdjustmentParameters) -> Array | None:
    """Return (N, 2, R) the displacements of the model's rim terms; None if there are none."""
    at = [i for i, name in enumerate(parameters.collimator.aberrations) if name.startswith("rim_")]
    return bundle.displacements[:, :, at] if at and bundle.displacements is not None else None


def _block_diagonal(blocks: Sequence[Array]) -> Array:
    """Return blocks along the diagonal of one matrix."""
    ends = np.cumsum([len(block) for block in blocks])
    whole = np.zeros((ends[-1], ends[-1]))
    for end, block in zip(ends, blocks, strict=True):
        whole[end - len(block) : end, end - len(block) : end] = block
    return whole


def _stacked(blocks: Sequence[Array]) -> tuple[Array, NDArray[np.int64]]:
    """Return (n, F, F) n blocks, filled up with zeros, and the place of each row of each block among all n F."""
    width = max(len(block) for block in blocks)
    stacked = np.zeros((len(blocks), width, width))
    for own, block in zip(stacked, blocks, strict=True):
        own[: len(block), : len(block)] = block
    return stacked, np.concatenate([i * width + np.arange(len(block)) for i, block in enumerate(blocks)])
