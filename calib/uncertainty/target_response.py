"""Response of the estimates to displacements of the target, and to a radius that a certificate gives.

Displaced stars move the image points by du, and the estimated parameters follow by H^-1 J^T W du, with the rotations of
the views eliminated. This linear response holds for every model: a radial term that is estimated takes up most of a
bow, for example. The sensitivities are therefore those of one calibration, with its views, priors and passport.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from calib.adjustment.bundle import Bundle
from calib.adjustment.levenberg_marquardt import Loss
from calib.adjustment.parameters import AdjustmentParameters
from calib.model.type_b_terms import RADII, SCALES, TypeBTerm

Array = NDArray[np.float64]

_MICRO = 1e-6
#: Signs of displacements of the centre by those of a star along X, Y and Z.
_AGAINST = np.array([-1.0, -1.0, 1.0])
#: Stars lie on a lattice if its rows and columns have at most this many times as many crossings as there are stars.
_LATTICE_SHARE = 4


@dataclass(frozen=True)
class _ViewResponses:
    """How the rotations of n views follow displacements of the stars; computed when it is asked for."""

    # local, coupling: (n, L, L) and (n, G, L) float64 blocks of the normal equations.
    local: Array
    coupling: Array
    # For each view the indices of its stars, (m,) int64, and the gradients of its local parameters by their
    # displacements, (L, 3, m).
    gradients: Sequence[tuple[NDArray[np.int64], Array]]
    free: Array  # (G, 3, M) float64 response of the free parameters to displacements of the stars, per mm
    # (G,) float64 their response to a relative change of 1 of a radius that has a prior; None if it is held.
    free_by_radius: Array | None

    @cached_property
    def turns(self) -> Array:
        """(3 n, 3, M) float64 change of the rotation vectors on the camera's side, rad / mm."""
        right = -np.einsum("ngl,gkm->nlkm", self.coupling, self.free)
        for own, (index, gradients) in zip(right, self.gradients, strict=True):
            own[:, :, index] += gradients
        return self._solved(right).reshape(-1, *self.free.shape[1:])

    def turns_by_radius(self, r_mm: float) -> Array:
        """Return (3 n,) the change of the rotation vectors by a relative change of 1 of the radius, rad."""
        if self.free_by_radius is None:
            return np.asarray(-r_mm * self.turns[:, 2].sum(axis=1))
        # A radius with a prior moves the rotations only through the other parameters.
        return self._solved(-(self.free_by_radius @ self.coupling)[:, :, None]).reshape(-1)

    def _solved(self, right: Array) -> Array:
        """Return the rotations by back-substitution (Triggs et al., 2000, section 6.1)."""
        return np.asarray(np.linalg.solve(self.local, right.reshape(*right.shape[:2], -1))[:, :3])


@dataclass(frozen=True)
class TargetResponse:
    """Response of the estimates to displacements of the target, and to a held radius."""

    names: tuple[str, ...]
    stars_mm: Array  # (M, 2) float64 nominal positions of the stars that the views show, mm
    # axis_mm, r_mm: Foot of the collimator's axis on the target, and its radius, mm; medians if each view has
    # its own centre.
    axis_mm: tuple[float, float]
    r_mm: float
    # (G, 3, M) float64 change of each parameter by the displacement of a star along X, Y and Z, per mm.
    shared: Array
    views: _ViewResponses
    # (G,) float64 change of each parameter by a relative change of 1 of the radius of a certificate; zero if
    # no certificate determines the radius.
    shared_by_radius: Array
    has_certificate: bool  # Whether a certificate determines the radius

    @property
    def turns(self) -> Array:
        """(3 n, 3, M) float64 change of the rotation vectors of n views on the camera's side, rad / mm."""
        return self.views.turns

    @property
    def turns_by_radius(self) -> Array:
        """(3 n,) float64 change of the rotation vectors by a relative change of 1 of the radius of a certificate."""
        if not self.has_certificate:
            return np.zeros(3 * len(self.views.local))
        return self.views.turns_by_radius(self.r_mm)

    def by_term(self, term: TypeBTerm) -> tuple[Array, Array]:
        """Return the response to a term by one unit of its value.

        term: A term that is not random from star to star: any kind but ``wavefront``.
        Returns: (G,) changes of the parameters and (3 n,) changes of the rotation vectors, rad, per unit of
          the term.
        """
        if term.kind in RADII:
            return self.shared_by_radius, self.turns_by_radius
        return self.shared_by_term(term), np.einsum("gkm,mk->g", self.turns, self._displacements(term))

    def shared_by_term(self, term: TypeBTerm) -> Array:
        """Return the first result of `by_term`: the changes of the parameters.

        term: A term that is not random from star to star: any kind but ``wavefront``.
        Returns: (G,) changes of the parameters per unit of the term.
        """
        if term.kind in RADII:
            return self.shared_by_radius
        return np.asarray(np.einsum("gkm,mk->g", self.shared, self._displacements(term)))

    def _displacements(self, term: TypeBTerm) -> Array:
        """Return (M, 3) displacements of the stars, mm, by one unit of a term.

        A scale displaces a star along its position vector. A bow is a paraboloid about the collimator's axis; that of
        another axis differs by a shift and a tilt of the target only.
        """
        displaced = np.zeros((len(self.stars_mm), 3))
        if term.kind in SCALES:
            displaced[:, :2] = self.stars_mm
        elif term.kind == "print_bow" and term.radius_mm is not None:
            displaced[:, 2] = ((self.stars_mm - self.axis_mm) ** 2).sum(axis=1) / term.radius_mm**2
        return displaced

    def by_wavefront(self, term: TypeBTerm) -> tuple[Array, Array]:
        """Return the covariance of the estimates by random slopes of the wavefront of 1 urad RMS.

        Own model. The wavefront is a Gaussian random field over the beam with a Gaussian correlation function, so its
        slopes are a random field without curl, alike over the correlation length. A slope s displaces a star by r s on
        the target, in all views alike. The RMS is that over the stars after subtraction of the mean slope.

        term: A term of the kind ``wavefront``.
        Returns: (G, G) covariance of the parameters and (3 n, 3 n) of the rotation vectors, rad^2, per
          urad^2.
        """
        scale = self._wavefront_scale(term)
        length = self._correlation_mm(term)
        return (
            scale * _slopes_covariance(self.stars_mm / length, self.shared[:, :2]),
            scale * _slopes_covariance(self.stars_mm / length, self.turns[:, :2]),
        )

    def shared_by_wavefront(self, term: TypeBTerm) -> Array:
        """Return the first result of `by_wavefront`: the covariance of the parameters.

        term: A term of the kind ``wavefront``.
        Returns: (G, G) covariance of the parameters per urad^2.
        """
        stars = self.stars_mm / self._correlation_mm(term)
        return np.asarray(self._wavefront_scale(term) * _slopes_covariance(stars, self.shared[:, :2]))

    def _correlation_mm(self, term: TypeBTerm) -> float:
        """Return the length of the correlation of the wavefront, on the target, mm."""
        return term.correlation_mm or 0.5 * self.star_radius_mm

    def _wavefront_scale(self, term: TypeBTerm) -> float:
        """Return the variance, mm^2, that gives slopes of 1 urad RMS after subtraction of the mean slope."""
        count = len(self.stars_mm)
        mean = np.zeros((2, 2, count))
        mean[0, 0] = mean[1, 1] = 1.0 / count
        of_mean = _slopes_covariance(self.stars_mm / self._correlation_mm(term), mean)
        mean_square = 2.0 - float(np.trace(of_mean))
        # One star alone has no slope besides the mean.
        return (_MICRO * self.r_mm) ** 2 / mean_square if mean_square > 0 else 0.0

    @property
    def star_radius_mm(self) -> float:
        """Largest distance of a star from the middle of all stars, mm."""
        return float(np.linalg.norm(self.stars_mm - self.stars_mm.mean(axis=0), axis=1).max())


def target_response(
    bundle: Bundle,
    parameters: AdjustmentParameters,
    loss: Loss,
    names: Sequence[str],
    information: Array | None = None,
) -> TargetResponse:
    """Return the response of the estimates to displacements of the target, at the optimum.

    Linear propagation (JCGM 100:2008, section 5.1.3) through the normal equations, with local parameters eliminated by
    the Schur complement (Triggs et al., 2000, section 6.1). Parameters that a passport holds do not respond.

    information: (G, G) information on the free parameters, in the order of the bundle's names, times the
      noise variance; None for that of the bundle.
    Returns: The response; that of a held parameter is zero, except to its own change.
    """
    obs, equations = bundle.observations, bundle.robust_equations(parameters, loss)
    stars, index = _positions(obs.target_rows)
    own = [index[rows] for rows in obs.slices]
    gradients = list(_gradients(bundle, parameters, loss))
    count = len(bundle.names)
    eliminated = np.swapaxes(np.linalg.solve(equations.local, np.swapaxes(equations.coupling, 1, 2)), 1, 2)
    shared = np.zeros((count, 3, len(stars)))
    for at, by_view, back in zip(own, gradients, eliminated, strict=True):
        shared[:, :, at] += by_view[:count] - np.tensordot(back, by_view[count:], 1)
    information = equations.reduced() if information is None else information
    free = _solved(information, shared.reshape(count, -1)).reshape(shared.shape)
    x, y, z = np.median(parameters.centres, axis=0).tolist()
    by_radius, has_certificate = _radius_gradient(bundle, names, free, information, -z)
    held = np.zeros(len(names))
    if has_certificate and "r" not in bundle.names:
        held[list(names).index("r")] = -z
    by_stars = [(at, by_view[count:]) for at, by_view in zip(own, gradients, strict=True)]
    through = by_radius if "r" in bundle.names else None
    return TargetResponse(
        tuple(names),
        stars,
        (x, y),
        -z,
        _spread(free, bundle.names, names),
        _ViewResponses(equations.local, equations.coupling, by_stars, free, through),
        held + _spread(by_radius, bundle.names, names),
        has_certificate,
    )


def _positions(target_rows: Array) -> tuple[Array, NDArray[np.int64]]:
    """Return the (M, 2) different positions of stars, mm, in the order of X, then Y; and (N,) the place of each."""
    x, y = target_rows[:2]
    found, index = np.unique(x + 1j * y, return_inverse=True)
    return np.column_stack([found.real, found.imag]), index.reshape(-1)


def _gradients(bundle: Bundle, parameters: AdjustmentParameters, loss: Loss) -> Iterator[Array]:
    """Yield (G + L, 3, m) the gradients of each view by displacements of its m stars along X, Y and Z, 1 / mm."""
    count = len(bundle.names)
    # A displacement of a star moves its image as the centre does, with the opposite sign; the centre has Z = -r.
    moving = replace(bundle, names=(*bundle.names, "x", "y", "r"))
    xx, xy, yy = bundle.pull(parameters, loss).curvature
    for rows, jacobian in zip(bundle.observations.slices, moving.jacobians(parameters), strict=True):
        u, v = np.swapaxes(jacobian[count : count + 3] * _AGAINST[:, None, None], 0, 1)
        own = np.concatenate([jacobian[:count], jacobian[count + 3 :]])
        by_u, by_v = xx[rows] * u + xy[rows] * v, xy[rows] * u + yy[rows] * v
        yield own[:, :1] * by_u + own[:, 1:] * by_v


def _radius_gradient(
    bundle: Bundle, names: Sequence[str], free: Array, information: Array, r: float
) -> tuple[Array, bool]:
    """Return the change (G,) of the free parameters by a relative change of the certificate's radius.

    A held radius that grows acts as a target that moves towards the camera. A radius with a prior follows the mean of
    the prior. The second entry is whether there is a certificate: a passport that holds or gives the radius alone.
    """
    held = [name for name in names if name not in bundle.names]
    if held == ["r"]:
        return -r * free[:, 2].sum(axis=1), True
    prior = bundle.prior
    if "r" in bundle.names and prior is not None and "r" in prior.names:
        at = [bundle.names.index(name) for name in prior.names]
        gradient = np.zeros((len(bundle.names), 1))
        gradient[at, 0] = bundle.noise_variance * prior.information[:, prior.names.index("r")] * r
        return _solved(information, gradient)[:, 0], True
    return np.zeros(len(bundle.names)), False


def _slopes_covariance(stars: Array, sums: Array) -> Array:
    """Return the covariance (Q, Q) of sums of the slopes of a random wavefront of unit variance at the stars.

    ``stars`` (M, 2) are in lengths of the correlation, ``sums`` (Q, 2, M) are the factors of the slopes. The slopes are
    those of a field with the correlation function exp(-d^2 / 2). It is a product of a function of x and one of y, so
    that on a lattice of stars the sums run over columns, then over rows.
    """
    (xs, column), (ys, row) = (np.unique(stars[:, axis], return_inverse=True) for axis in (0, 1))
    if len(xs) * len(ys) > _LATTICE_SHARE * len(stars):
        flat, slope, bend = _correlations(stars[:, 0])
        flat_y, slope_y, bend_y = _correlations(stars[:, 1])
        blocks = ((bend * flat_y, -slope * slope_y), (-slope * slope_y, flat * bend_y))
        pairs = (sums[:, a] @ blocks[a][b] @ sums[:, b].T for a in (0, 1) for b in (0, 1))
        return np.asarray(sum(pairs))
    spread = np.zeros((len(sums), 2, len(xs), len(ys)))
    spread[:, :, column.reshape(-1), row.reshape(-1)] = sums
    flat, slope, bend = _correlations(xs)
    flat_y, slope_y, bend_y = _correlations(ys)
    u, v = spread[:, 0], spread[:, 1]
    by_u = bend @ u @ flat_y.T - slope @ v @ slope_y.T
    by_v = flat @ v @ bend_y.T - slope @ u @ slope_y.T
    whole = np.concatenate([by_u.reshape(len(sums), -1), by_v.reshape(len(sums), -1)], axis=1)
    return np.asarray(whole @ spread.reshape(len(sums), -1).T)


def _correlations(places: Array) -> tuple[Array, Array, Array]:
    """Return f(d) = exp(-d^2 / 2), d f(d) and (1 - d^2) f(d) of the distances d between all places, (M, M) each."""
    away = places[:, None] - places
    flat = np.exp(-0.5 * away**2)
    return flat, away * flat, (1.0 - away**2) * flat


def _solved(information: Array, right: Array) -> Array:
    """Solve the normal equations for the columns of `right`, scaled to a unit diagonal (van der Sluis, 1969)."""
    scale = 1.0 / np.sqrt(np.diag(information))
    return np.asarray(
        scale[:, None] * np.linalg.solve(information * np.outer(scale, scale), scale[:, None] * right)
    )


def _spread(values: Array, own: Sequence[str], names: Sequence[str]) -> Array:
    """Return values of some parameters in the order of all names; zeros for the others."""
    spread = np.zeros((len(names), *values.shape[1:]))
    for name, value in zip(own, values, strict=True):
        if name in names:
            spread[list(names).index(name)] = value
    return spread
