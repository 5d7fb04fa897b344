"""What a result states as functions of the unknowns: camera, collimator's centre, its errors; and the mixture of them.

Programs have no term of r^8, so a result states the k1 to k3 that project as the whole series does over the sensor: to
1/32 of what the term moves the corner.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calib.arrays import Array
from calib.model.camera import PINHOLE, CameraModel
from calib.model.lens import R8

from .posterior import Component, Posterior
from .problem import Problem
from .shapes import CENTRE, RADIAL
from .uncertainty import expanded

#: What k1 to k3 take up of r^8 if the corner is at 1, and the power of the corner's tangent with which that grows: over
#: the unit interval, s^3 less 1/32 of Chebyshev's third polynomial is its nearest one of degree 2 (Lanczos, 1938).
_NEAREST = {"k1": (1.0 / 32.0, 6), "k2": (-18.0 / 32.0, 4), "k3": (48.0 / 32.0, 2)}


@dataclass(frozen=True)
class Quantities:
    """Q quantities at some unknowns: values, and how they follow these."""

    values: Array  # (Q,)
    rows: Array  # (Q, S)

    def covariance(self, of_unknowns: Array) -> Array:
        """Return (Q, Q) their covariance, by the (S, S) of the unknowns."""
        return np.asarray(self.rows @ of_unknowns @ self.rows.T)


def names_of(problem: Problem) -> tuple[str, ...]:
    """Return the names of the quantities: those of the camera with the term of r^8, the centre, errors of the glass."""
    glass = [name for name in problem.unknowns.results if name not in (*CENTRE, *RADIAL, "log r")]
    return (*PINHOLE, *problem.camera.lens, *CENTRE, *RADIAL, *glass)


def quantities(problem: Problem, b: Array) -> Quantities:
    """Return the quantities of `names_of` at (S,) shared unknowns."""
    depth, unknowns, fields = problem.depth, problem.unknowns, problem.fields
    model, by_camera = problem.camera.model(b[:depth]), problem.camera.by_unknowns(b[:depth])
    names = names_of(problem)
    rows, values = np.zeros((len(names), len(b))), np.zeros(len(names))
    count = len(model.values)
    rows[:count, :depth], values[:count] = by_camera, model.values
    reference = dict(zip(CENTRE[:2], fields.reference, strict=False))
    for k, name in enumerate(names[count:], start=count):
        if name == "r":
            values[k] = fields.r0 * np.exp(unknowns.results["log r"] @ b)
            rows[k] = values[k] * unknowns.results["log r"]
        else:
            rows[k] = unknowns.results[name]
            values[k] = rows[k] @ b + reference.get(name, 0.0)
    return Quantities(values, rows)


@dataclass(frozen=True)
class Part:
    """A posterior by one explanation in the mixture of all."""

    posterior: Posterior
    share: float
    row: str = ""  # Of the budget: what the difference to the first belongs to


@dataclass(frozen=True)
class Mixture:
    """Quantities over all explanations; the first one is the most probable."""

    parts: tuple[Part, ...]
    no_bound: float = 0.0  # Probability that the bound of the parallax is wrong: a hand moves the camera
    unsteady: float = 0.0  # 1-sigma of the focal length from pose to pose, as a share

    @cached_property
    def changing(self) -> Array:
        """(Q,) what 1-sigma of a focal length that is not steady does."""
        focal = np.isin(self.names, ("fx", "fy"))
        return np.asarray(np.where(focal, self.unsteady * self.mean, 0.0))

    @property
    def first(self) -> Posterior:
        """The most probable explanation."""
        return self.parts[0].posterior

    @property
    def problem(self) -> Problem:
        """Its problem."""
        return self.first.problem

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the Q quantities of the first explanation."""
        return names_of(self.problem)

    @cached_property
    def members(self) -> list[tuple[float, Component, Quantities, int]]:
        """Each component with its weight, its quantities, and the number of its explanation.

        Coefficients that another family of lenses has not are those of the first explanation.
        """
        first, members = self.first, []
        usual = quantities(first.problem, first.mean)
        for number, part in enumerate(self.parts):
            posterior, problem = part.posterior, part.posterior.problem
            place = {name: k for k, name in enumerate(names_of(problem))}
            has = np.array([name in place for name in self.names])
            at = [place[name] for name in self.names if name in place]
            for weight, component in zip(posterior.weights.tolist(), posterior.components, strict=True):
                there = quantities(problem, component.solution.mean)
                values, rows = usual.values.copy(), np.zeros((len(has), there.rows.shape[1]))
                values[has], rows[has] = there.values[at], there.rows[at]
                members.append((part.share * weight, component, Quantities(values, rows), number))
        return members

    @cached_property
    def mean(self) -> Array:
        """(Q,) means."""
        return np.asarray(sum(weight * own.values for weight, _, own, _ in self.members))

    @cached_property
    def covariance(self) -> Array:
        """(Q, Q) covariance."""
        weights, means, within = self._gaussians
        away = means - self.mean
        changing = np.outer(self.changing, self.changing)
        return np.asarray(np.tensordot(weights, within, 1) + (weights[:, None] * away).T @ away + changing)

    @cached_property
    def _gaussians(self) -> tuple[Array, Array, Array]:
        """(K,) weights, (K, Q) means and (K, Q, Q) covariances of the components."""
        weights = np.array([weight for weight, _, _, _ in self.members])
        means = np.array([own.values for _, _, own, _ in self.members])
        within = [own.covariance(component.solution.covariance) for _, component, own, _ in self.members]
        return weights, means, np.array(within)

    def expanded(self, row: Array) -> float:
        """Return the expanded uncertainty of the quantity with the (Q,) gradient row."""
        weights, means, within = self._gaussians
        variances = (within @ row) @ row + (row @ self.changing) ** 2
        return expanded(weights / weights.sum(), means @ row, np.sqrt(np.maximum(variances, 0.0)))

    def places(self, names: Sequence[str]) -> list[int]:
        """Return the places of quantities."""
        return [self.names.index(name) for name in names]

    @cached_property
    def camera(self) -> CameraModel:
        """The camera, with the term of r^8."""
        values = dict(zip(self.names, self.mean.tolist(), strict=True))
        fx, fy, cx, cy = (values[name] for name in PINHOLE)
        lens = {name: values[name] for name in self.problem.camera.lens}
        return CameraModel(fx, fy, cx, cy, self.problem.camera.image_size, lens)


@dataclass(frozen=True)
class Stated:
    """What a result states: the camera without the term of r^8, centre and radial terms."""

    names: tuple[str, ...]
    estimates: Array  # (G,)
    covariance: Array  # (G, G)
    coverage_factors: dict[str, float]
    rows: Array  # (G, Q) how they follow the quantities of the mixture
    camera: CameraModel  # Without the term of r^8


def stated(mixture: Mixture) -> Stated:
    """Return what a result states. U of k1 to k3 also covers the coefficients of the whole series."""
    camera = mixture.camera
    names = (*(name for name in camera.parameter_names if name != R8), *CENTRE, *RADIAL)
    rows = np.eye(len(mixture.names))[mixture.places(names)]
    taken = _taken_up(camera) if R8 in camera.distortion else {}
    halves = [mixture.expanded(row) for row in rows]
    for name, share in taken.items():
        k = names.index(name)
        rows[k, mixture.names.index(R8)] = share
        halves[k] += abs(share * camera.distortion[R8])
    covariance = rows @ mixture.covariance @ rows.T
    factors = np.array(halves) / np.sqrt(np.diag(covariance))
    return Stated(
        names,
        rows @ mixture.mean,
        covariance,
        dict(zip(names, factors.tolist(), strict=True)),
        rows,
        _without_r8(camera, taken),
    )


def _without_r8(camera: CameraModel, taken: Mapping[str, float]) -> CameraModel:
    """Return the camera whose k1 to k3 take up the term of r^8; one without this term as it is."""
    if R8 not in camera.distortion:
        return camera
    lens = {name: value for name, value in camera.distortion.items() if name != R8}
    for name, share in taken.items():
        lens[name] += share * camera.distortion[R8]
    return replace(camera, distortion=lens)


def _taken_up(camera: CameraModel) -> dict[str, float]:
    """Return what k1 to k3 become by a unit of r^8: at most 1/32 of it is left anywhere."""
    width, height = camera.image_size
    rays = camera.rays(np.array([(x, y) for x in (0.0, width - 1.0) for y in (0.0, height - 1.0)]))
    seen = np.hypot(rays[:, 0], rays[:, 1]) / rays[:, 2]
    nominal = 0.5 * float(np.hypot(width, height)) / camera.fx
    corner = float(np.nanmax([*seen, nominal]))  # a corner without a ray lies beyond a fold of the distortion
    return {name: share * corner**power for name, (share, power) in _NEAREST.items()}
