"""Covariance of the estimates at the optimum, enlarged if the views are inconsistent.

The covariance rests on the residuals, not on the stars' stated covariances: J^T J inverted, times the variance of the
influence function over the square of its mean slope (Huber, 1981, chapter 7). It is right if the model is right. The
views test that: if their estimates differ by more than star noise allows, the covariance is multiplied by the square of
the Birge ratio.

Views of one pose are one where poses are compared: they share the errors of the collimator, of the pixel grid and of
the sensor's fixed pattern.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.adjustment.bundle import Bundle, ViewEquations, ViewScores
from calib.adjustment.levenberg_marquardt import refine
from calib.adjustment.loss import Loss
from calib.adjustment.parameters import AdjustmentParameters, views_of_poses
from calib.arrays import Array, rms_length
from calib.errors import DegenerateViews
from calib.model.collimator import Collimator
from calib.model.result_parts import COVERAGE, POSE_FIELDS, STARS

#: Below this ratio of eigenvalues, the information matrix (scaled to a unit diagonal) is numerically singular.
_SINGULAR = 1e-13
#: A view determines a direction of the shared parameters if the relative eigenvalue exceeds this.
_DETERMINED = 1e-6
#: Probability that consistent views are reported as inconsistent.
_FALSE_ALARMS = 1e-3
#: Leaving one pose out must leave enough to calibrate with.
_MIN_POSES = 3
#: Views differ by far more than what a refit leaves undone at this tolerance: some hundredths of a sigma.
_TOLERANCE = 1e-8
#: A step is the answer if it reaches this share of what it promises. Steps of 20 views that reached .83 or more ended
#: within a twentieth of their length of the optimum, and the rms of the views left out was right to a thousandth.
_PROMISED = 0.7
#: Behind a collimator the centres of the views agree to a few per cent of the radius. If they scatter by more than this
#: share of their distance, the target is a board that was placed anew for each view.
_PLACED_BY_HAND = 0.1


@dataclass(frozen=True)
class Uncertainty:
    """Covariance of the shared parameters."""

    names: tuple[str, ...]
    nominal: Array  # (G, G) float64 covariance if the model is right, in the order of the names
    variance_factor: float  # Estimated variance of a component of the weighted residuals
    degrees_of_freedom: int
    views_freedom: int  # Degrees of freedom of the comparison of the views
    # How many times more than star noise explains the estimates of the views differ (Birge, 1932); 1 is
    # agreement.
    birge_ratio: float
    # Whether the ratio is more than chance allows; the covariance is then enlarged.
    inconsistent: bool

    @property
    def growth(self) -> float:
        """Square of the Birge ratio (Birge, 1932) if the views are inconsistent, else 1."""
        return self.birge_ratio**2 if self.inconsistent else 1.0

    @property
    def covariance(self) -> Array:
        """(G, G) float64 covariance, enlarged if the views are inconsistent."""
        return self.growth * self.nominal

    @property
    def shares(self) -> Mapping[str, float]:
        """Share of the covariance by source."""
        stars = 1.0 / self.growth
        return {STARS: stars, POSE_FIELDS: 1.0 - stars} if self.inconsistent else {STARS: stars}

    @property
    def sigma(self) -> Mapping[str, float]:
        """Standard uncertainty of each parameter, by name."""
        sigmas = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        return dict(zip(self.names, sigmas.tolist(), strict=True))

    @property
    def coverage_factor(self) -> float:
        """The k for which value +- k sigma covers 95.45 % (Student's distribution; JCGM 100:2008, annex G).

        Degrees of freedom are those of the stars if the views are consistent, else those of the views.
        """
        return coverage_factor(self.views_freedom if self.inconsistent else self.degrees_of_freedom)


def coverage_factor(degrees_of_freedom: float) -> float:
    """Return the k for 95.45 % (Student; JCGM 100:2008, annex G): 2 for infinite degrees of freedom, else more."""
    from scipy import special

    tail = 0.5 + 0.5 * COVERAGE
    if np.isinf(degrees_of_freedom):
        return float(special.ndtri(tail))
    return float(special.stdtrit(degrees_of_freedom, tail))


def covariance_at_optimum(bundle: Bundle, parameters: AdjustmentParameters, loss: Loss) -> Uncertainty:
    """Return the covariance of shared parameters (Huber, 1981, chapter 7).

    The Birge ratio of the views is tested by an F test.
    Raises DegenerateViews: If there are no more measurements than parameters, or a parameter is not constrained.
    """
    residuals = bundle.weighted_residuals(parameters)
    from scipy import special

    lengths = np.hypot(residuals[:, 0], residuals[:, 1])
    views = bundle.equations(parameters, loss, curved=False).eliminated()
    count = len(bundle.names) + views.answer[:, :, 0].size
    freedom = 2 * len(lengths) - count
    if freedom <= 0:
        raise DegenerateViews(
            f"{2 * len(lengths)} measurements cannot determine {count} parameters.",
            remedy="Add views, or views with more points.",
        )
    influence = loss.weights(lengths) * lengths
    # Mean second derivative of rho over all directions in the plane: half its trace.
    slope = 0.5 * (loss.weights(lengths) + loss.second_derivatives(lengths)).mean()
    variance = float((influence**2).sum() / freedom)
    factor = variance / float(slope) ** 2
    inverse = inverse_information(views.information.sum(axis=0), bundle.names)
    ratio, views_freedom = _birge(views_of_poses(parameters.rotations), views, variance)
    limit = special.fdtri(views_freedom, freedom, 1.0 - _FALSE_ALARMS) if views_freedom > 0 else np.inf
    return Uncertainty(
        bundle.names,
        factor * inverse,
        factor,
        freedom,
        views_freedom,
        birge_ratio=float(np.sqrt(ratio)),
        inconsistent=bool(ratio > limit),
    )


def rotation_covariance(bundle: Bundle, parameters: AdjustmentParameters, uncertainty: Uncertainty) -> Array:
    """Return the joint (3 n, 3 n) covariance of the rotation vectors of all views on the camera's side, rad^2.

    It holds the star noise of each view, and the shared uncertainty of camera and collimator. Own derivation from the
    block inverse of the normal equations (Schur complement; Triggs et al., 2000, section 6.1): let L be the block of
    the local parameters, S their coupling to the shared ones, C the covariance of the shared ones, and v the variance
    of star noise. Then the covariance is v L^-1 + L^-1 S^T C S L^-1.
    """
    equations = bundle.equations(parameters, Loss("l2"))
    inverse = np.linalg.inv(equations.local)
    answer = -(inverse @ equations.coupling)[:, :3].reshape(-1, len(uncertainty.names))
    joint = answer @ uncertainty.covariance @ answer.T
    for i, own in enumerate(inverse[:, :3, :3]):
        joint[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] += uncertainty.growth * uncertainty.variance_factor * own
    return np.asarray(joint)


def _birge(poses: Sequence[Sequence[int]], views: ViewScores, variance: float) -> tuple[float, int]:
    """Return the squared Birge ratio of P poses and its degrees of freedom.

    At the optimum the scores s_i (P, G) of the poses cancel. Star noise gives s_i the covariance variance * A_i, where
    A_i is the pose's information (P, G, G) on the shared parameters. The sum of s_i^T A_i^+ s_i has as many degrees of
    freedom as the poses determine directions, minus the number of shared parameters. Own extension of Birge (1932) from
    one measurand to several, of which a pose may determine only some.
    """
    information, scores = (
        np.array([each[own].sum(axis=0) for own in poses]) for each in (views.information, views.score)
    )
    diagonals = np.diagonal(information, axis1=1, axis2=2)
    scale = 1.0 / np.sqrt(np.maximum(diagonals, np.finfo(float).tiny))
    eigenvalues, vectors = np.linalg.eigh(information * scale[:, :, None] * scale[:, None])
    determined = eigenvalues > _DETERMINED * eigenvalues[:, -1:]
    along = np.einsum("pgk,pg->pk", vectors, scale * scores)
    squares = np.divide(along**2, eigenvalues, out=np.zeros_like(along), where=determined)
    freedom = int(determined.sum()) - len(scores[0])
    if freedom <= 0 or variance <= 0:
        return 1.0, 0
    return float(squares.sum()) / freedom / variance, freedom


def inverse_information(information: Array, names: Sequence[str]) -> Array:
    """Invert (G, G) information, scaled to a unit diagonal (van der Sluis, 1969): the Cramér-Rao bound (Rao, 1945).

    Raises DegenerateViews: If a parameter is not constrained; names it, or the two that cannot be separated.
    """
    diagonal = np.diag(information)
    if not (diagonal > 0).all():
        free = names[int(np.argmin(diagonal))]
        raise DegenerateViews(f"These views do not constrain {free}.", remedy="Add views from other angles.")
    scale = 1.0 / np.sqrt(diagonal)
    eigenvalues, vectors = np.linalg.eigh(information * np.outer(scale, scale))
    if eigenvalues[0] < _SINGULAR * eigenvalues[-1]:
        worst = np.argsort(-np.abs(vectors[:, 0]))[:2]
        free = " and ".join(names[i] for i in sorted(worst))
        raise DegenerateViews(
            f"These views cannot separate {free}.", remedy="Add views turned about other axes."
        )
    return np.asarray((vectors / eigenvalues) @ vectors.T * np.outer(scale, scale))


def leave_one_out(bundle: Bundle, parameters: AdjustmentParameters, loss: Loss) -> float | None:
    """Predict the views of each of at least 3 poses from all others; return the rms residual, px (Stone, 1974)."""
    residuals, poses = list[Array](), views_of_poses(parameters.rotations)
    if len(poses) < _MIN_POSES:
        return None
    known = bundle.equations(parameters, loss)
    for views in poses:
        others = without_pose(bundle, views, parameters, loss, known)
        residuals += [predicted_residuals(bundle, i, parameters, others) for i in views]
    return rms_length(np.concatenate(residuals))


def without_pose(
    bundle: Bundle,
    views: Sequence[int],
    parameters: AdjustmentParameters,
    loss: Loss,
    known: ViewEquations | None = None,
) -> AdjustmentParameters:
    """Adjust without the views of a pose, from the optimum of all; ``known``: its equations, if at hand.

    These equations without the pose give the step (a downdate; Cook and Weisberg, 1982, section 3.4). If it reaches
    what it promises, it is the answer; else a search goes on from it: with few poses, one of them moves the others far.
    """
    others = [i for i in range(len(parameters.rotations)) if i not in views]
    fewer, start = bundle.subset(others), parameters.subset(others)
    every = known or bundle.equations(parameters, loss)
    rest = ViewEquations(every.normal[others], every.right[others], every.count, every.costs[others])
    try:
        shared, local = rest.step(0.0)
    except np.linalg.LinAlgError:
        return refine(fewer, start, loss, tolerance=_TOLERANCE).parameters
    moved = start.after_step(bundle.names, shared, local)
    count = len(shared)
    promised = 0.5 * float(rest.right[:, :count].sum(axis=0) @ shared + (rest.right[:, count:] * local).sum())
    reached = float(every.costs[others].sum() - fewer.costs(moved, loss).sum())
    if reached >= _PROMISED * promised:
        return moved
    return refine(fewer, moved if reached > 0 else start, loss, tolerance=_TOLERANCE).parameters


def predicted_residuals(
    bundle: Bundle, i: int, parameters: AdjustmentParameters, others: AdjustmentParameters
) -> Array:
    """Return the (N, 2) residuals, px, of view i by what others give, with its rotation (of a board: pose) adjusted."""
    by_hand = False
    if bundle.free_centres:
        x, y, z = others.centres.mean(axis=0).tolist()
        by_hand = bool(np.linalg.norm(others.centres.std(axis=0)) > _PLACED_BY_HAND * abs(z))
        others = replace(others, collimator=Collimator(x, y, -z))
    offset = (parameters.centres[i] - others.collimator.centre) * by_hand
    start = replace(others, rotations=parameters.rotations[i : i + 1], offsets=offset[None])
    view = replace(bundle.subset([i]), names=(), free_centres=by_hand)
    return view.residuals_px(refine(view, start, Loss("l2"), tolerance=_TOLERANCE).parameters)
