"""What views disagree on: a displacement of the target's points, smooth over the beam, that each view has of its own.

Knows residuals, and how to tell what is common to a view's stars from what is each star's own. A collimator that is
not quite the model moves neighbouring stars alike, and differently in every view. Such a field is written as
polynomials of the place in the beam, to the fourth degree, and as the beam's rim moved along its radius; the
coefficients of one degree are drawn, in each view, from one variance; the shifts of the whole beam, degree zero, from
one along X and one along Y, as what moves a centre has a direction. Those variances are estimated from all residuals
together by restricted maximum likelihood, so three views tell them: each brings some thirty coefficients. The
parameters' covariance follows: H^-1 (sum over views of S D S^T) H^-1, S a view's coefficients' pull at them.

Three views pull at the parameters three times, two of them free; this tells what those pulls cannot. Where views are
more, it is what the pulls are expected to be (`calib.uncertainty.cluster_robust`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib.adjustment.bundle import Bundle
from calib.adjustment.levenberg_marquardt import Loss
from calib.adjustment.parameters import AdjustmentParameters

Array = NDArray[np.float64]

_DEGREES = 4
#: Powers of the radius by which a rim moves outwards: a pupil only partly filled (`calib.model.aberrations`).
_RIM_POWERS = (4, 10)
#: Combinations of coefficients that the residuals show by less than this share of the best are not shown.
_SHOWN = 1e-7
#: Where stars are hardly more than coefficients, their noise is at least this share of the residuals' mean square.
_LEAST_NOISE = 1e-3
_ROUNDS = 100
#: Sizes are settled when a round changes none by more than this share.
_SETTLED = 5e-3


@dataclass(frozen=True)
class VarianceComponents:
    """What views disagree on, and what it is worth.

    Attributes
    ----------
    sigma_mm
        (7,) 1-sigma displacement of a star by the shifts along X and along Y, by the polynomials of each degree, 1 to
        4, and by the rim; fewer where no view has stars enough for all degrees.
    field_covariance, star_covariance, prior_covariance
        (G, G) covariance of the shared parameters by these fields, by the stars' own noise, and by what was
        known beforehand.
    score_covariances
        (n, G, G) covariance of each view's pull at the shared parameters, by its fields and its stars.
    effective_freedom
        Degrees of freedom behind the least certain of the variances (Satterthwaite).
    """

    sigma_mm: Array
    field_covariance: Array
    star_covariance: Array
    prior_covariance: Array
    score_covariances: Array
    effective_degrees_of_freedom: float

    @property
    def covariance(self) -> Array:
        """(G, G) covariance of the shared parameters by all."""
        return np.asarray(self.field_covariance + self.star_covariance + self.prior_covariance)


@dataclass(frozen=True)
class _Evidence:
    """What the residuals show of the fields' coefficients, all views' one below the other.

    `score` (C,) is each coefficient's pull at the residuals; were the coefficients u, it would be `shown` (C, C)
    times u. `answer` (G, C) is their pull at the shared parameters, `group` (C,) the size each is drawn by, `view` (C,)
    whose they are, `information` (n, G, G) each view's information, and `noise` the variance of a star's own noise.
    """

    score: Array
    shown: Array
    answer: Array
    group: NDArray[np.int64]
    view: NDArray[np.int64]
    information: Array
    inverse: Array
    noise: float


def variance_components(bundle: Bundle, parameters: AdjustmentParameters, loss: Loss) -> VarianceComponents:
    """Measure what views disagree on, at the optimum.

    Parameters
    ----------
    bundle, state, loss
        What was fitted, its optimum, and the loss with the limit it ended with.
    """
    evidence = _evidence(bundle, parameters, loss)
    eigenvalues, vectors = np.linalg.eigh(evidence.shown)
    determined = eigenvalues > _SHOWN * eigenvalues[-1]
    roots = np.sqrt(eigenvalues[determined])
    # Whitened: noise alone gives z unit covariance times its variance.
    z = (vectors[:, determined].T @ evidence.score) / roots
    by_coefficient = roots[:, None] * vectors[:, determined].T
    kinds = range(int(evidence.group.max()) + 1)
    parts = [by_coefficient[:, evidence.group == kind] for kind in kinds]
    variances, fisher = _variances(z, [part @ part.T for part in parts], evidence.noise)
    return _of(bundle, evidence, variances, fisher)


def _of(bundle: Bundle, evidence: _Evidence, variances: Array, fisher: Array) -> VarianceComponents:
    """Carry the fields' variances on to the shared parameters."""
    inverse = evidence.inverse
    answers = inverse @ evidence.answer
    each = np.stack([(answers[:, evidence.group == kind] ** 2).sum(axis=1) for kind in range(len(variances))])
    fields = (answers * variances[evidence.group]) @ answers.T
    stars = evidence.noise * inverse @ evidence.information.sum(axis=0) @ inverse
    prior = np.zeros_like(inverse)
    if bundle.prior is not None:
        at = [bundle.names.index(name) for name in bundle.prior.names]
        scaled = bundle.noise_variance * inverse[:, at]
        prior = scaled @ bundle.prior.information @ scaled.T
    total = np.diag(fields + stars + prior)
    # How uncertain each parameter's variance is: that of the logarithms of the sizes, carried on.
    by_log = (each * variances[:, None]).T
    spread = np.einsum("gk,kl,gl->g", by_log, np.linalg.pinv(fisher, rcond=1e-6, hermitian=True), by_log)
    freedom = 2.0 * total**2 / np.maximum(spread, np.finfo(float).tiny)
    return VarianceComponents(
        np.sqrt(variances),
        fields,
        stars,
        prior,
        _score_covariances(evidence, variances),
        float(freedom.min()),
    )


def _score_covariances(evidence: _Evidence, variances: Array) -> Array:
    """Return (n, G, G) the covariance of each view's pull."""
    scores = evidence.noise * evidence.information
    for i in range(len(scores)):
        own = evidence.view == i
        scores[i] += (evidence.answer[:, own] * variances[evidence.group[own]]) @ evidence.answer[:, own].T
    return np.asarray(scores)


def _variances(z: Array, parts: Sequence[Array], noise: float) -> tuple[Array, Array]:
    """Return the variances of most likelihood, z ~ N(0, sum_k v_k parts_k + noise), and their information.

    Each round multiplies a variance by the root of what its part of z shows over what would be expected; the
    likelihood grows in every round. The information is that on the variances' logarithms.
    """
    own = noise * np.eye(len(z))
    variances = np.array([z @ z / np.trace(part) / len(parts) for part in parts])
    for _ in range(_ROUNDS):
        inverse = np.linalg.inv(sum((v * part for v, part in zip(variances, parts, strict=True)), start=own))
        scaled = inverse @ z
        shown = np.array([scaled @ part @ scaled for part in parts])
        expected = np.array([(inverse * part).sum() for part in parts])
        factors = np.sqrt(shown / expected)
        variances = variances * factors
        if (np.abs(np.sqrt(factors) - 1.0) * (variances > 1e-3 * variances / factors)).max() < _SETTLED:
            break
    weighed = [v * inverse @ part for v, part in zip(variances, parts, strict=True)]
    return variances, 0.5 * np.array([[(a * b.T).sum() for b in weighed] for a in weighed])


def _evidence(bundle: Bundle, parameters: AdjustmentParameters, loss: Loss) -> _Evidence:
    """Collect what residuals show, each view's own rotation and the shared parameters' answer taken out."""
    obs, residuals = bundle.observations, bundle.weighted_residuals(parameters)
    weights = loss.weights(np.linalg.norm(residuals, axis=1))
    count = len(bundle.names)
    # The target's displacement moves the image as the centre's does, the other way.
    moving = replace(bundle, names=("x", "y"), prior=None, free_centres=False)
    shown, answers, scores, groups, squares = [], [], [], [], 0.0
    information = []
    rims = _rims(bundle, parameters)
    slopes_of_all = zip(obs.slices, bundle.jacobians(parameters), moving.jacobians(parameters), strict=True)
    for rows, slopes, moves in slopes_of_all:
        fields, group = _fields(obs.target[rows, :2], None if rims is None else rims[rows])
        by_field = -np.einsum("aim,maf->fim", moves[:2], fields)
        root = np.sqrt(weights[rows])[:, None, None] * obs.whitening[rows]
        columns = np.einsum("mij,fjm->fim", root, np.concatenate([slopes, by_field]))
        columns = columns.reshape(len(columns), -1)
        missed = (np.sqrt(weights[rows])[:, None] * residuals[rows]).T.reshape(-1)
        normal = columns @ columns.T
        local, rest = slice(count, len(slopes)), [*range(count), *range(len(slopes), len(columns))]
        stiff = normal[local, local] + bundle.local_prior_information
        left = normal[np.ix_(rest, rest)] - normal[rest, local] @ np.linalg.solve(stiff, normal[local, rest])
        information.append(left[:count, :count])
        shown.append(left[count:, count:])
        answers.append(left[:count, count:])
        scores.append(columns[len(slopes) :] @ missed)
        groups.append(group)
        squares += float(missed @ missed)
    inverse = np.asarray(np.linalg.inv(sum(information, start=bundle.prior_information)))
    answer, score = np.hstack(answers), np.concatenate(scores)
    freedom = 2 * len(residuals) - count - len(obs.slices) * (6 if bundle.free_centres else 3)
    explained = sum(
        float(own @ np.linalg.pinv(block, rcond=_SHOWN, hermitian=True) @ own)
        for own, block in zip(scores, shown, strict=True)
    )
    noise = max((squares - explained) / max(freedom - len(score), 1), _LEAST_NOISE * squares / len(residuals))
    together = _block_diagonal(shown) - answer.T @ inverse @ answer
    group = np.unique(np.concatenate(groups), return_inverse=True)[1]
    view = np.repeat(np.arange(len(groups)), [len(own) for own in groups])
    shown_by = 0.5 * (together + together.T)
    return _Evidence(score, shown_by, answer, group, view, np.array(information), inverse, noise)


def _fields(target_mm: Array, rims: Array | None) -> tuple[Array, NDArray[np.int64]]:
    """Return (n, 2, F) fields over a view's stars, of unit mean square, and each one's group.

    Polynomials, orthogonal over the stars, along each axis; groups are the shift along X, that along Y, and the
    further degrees. The last group is the rim's: the model's own shapes, or those of a disc about the stars' middle.
    """
    away = target_mm - target_mm.mean(axis=0)
    away /= np.linalg.norm(away, axis=1).max()
    powers = [(k - j, j) for k in range(_DEGREES + 1) for j in range(k + 1)][: len(away)]
    monomials = np.column_stack([away[:, 0] ** i * away[:, 1] ** j for i, j in powers])
    smooth = np.linalg.qr(monomials)[0] * np.sqrt(len(away))
    if rims is None:
        radius = np.linalg.norm(away, axis=1)[:, None]
        rims = np.stack([radius**power * away for power in _RIM_POWERS], axis=2)
    still = np.zeros_like(smooth)
    fields = np.concatenate(
        [
            np.stack([smooth, still], axis=1),
            np.stack([still, smooth], axis=1),
            rims / np.sqrt((rims**2).mean(axis=(0, 1))),
        ],
        axis=2,
    )
    bent = [1 + i + j for i, j in powers[1:]]
    return fields, np.array([0, *bent, 1, *bent, *[_DEGREES + 2] * rims.shape[2]])


def _rims(bundle: Bundle, parameters: AdjustmentParameters) -> Array | None:
    """Return (N, 2, R) the displacements of the model's rim; None when it has none."""
    at = [i for i, name in enumerate(parameters.collimator.aberrations) if name.startswith("rim_")]
    return bundle.displacements[:, :, at] if at and bundle.displacements is not None else None


def _block_diagonal(blocks: Sequence[Array]) -> Array:
    """Return blocks along the diagonal of one matrix."""
    ends = np.cumsum([len(block) for block in blocks])
    whole = np.zeros((ends[-1], ends[-1]))
    for end, block in zip(ends, blocks, strict=True):
        whole[end - len(block) : end, end - len(block) : end] = block
    return whole
