"""Normal equations of smooth displacements of the target, beside the parameters of an adjustment at its optimum.

`calib.uncertainty.variance_components` asks for displacements that differ from view to view, and
`calib.uncertainty.common_errors` for those that all views share. This module decides nothing about either.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib.adjustment.bundle import Bundle
from calib.adjustment.levenberg_marquardt import Loss
from calib.adjustment.parameters import AdjustmentParameters

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ReducedView:
    """Equations of one view, with its own rotation (and centre) eliminated."""

    # (G + F, G + F) float64 normal matrix of the shared parameters and of the coefficients of the fields.
    normal: Array
    score: Array  # (F,) float64 score of each coefficient
    squares: float
    by_readings: Array  # (G, G) float64 part of the normal matrix that comes from the gimbal's readings


class FieldEquations:
    """Residuals and derivatives at the optimum, from which the equations of fields are set up."""

    def __init__(self, bundle: Bundle, parameters: AdjustmentParameters, loss: Loss) -> None:
        self.bundle = bundle
        self.residuals = bundle.weighted_residuals(parameters)
        self._weights = loss.weights(np.linalg.norm(self.residuals, axis=1))
        # A displacement of the target moves the image as a shift of the centre does, with the opposite sign.
        moving = replace(bundle, names=("x", "y", *bundle.names))
        self._derivatives = [(whole[2:], whole[:2]) for whole in moving.jacobians(parameters)]
        self._readings = bundle.reading_equations(parameters)

    @property
    def local_count(self) -> int:
        """Number of parameters that each view has of its own: 3, or 6 with a centre of its own."""
        return 6 if self.bundle.free_centres else 3

    @property
    def degrees_of_freedom(self) -> int:
        """Number of residuals minus number of parameters, without fields."""
        own = len(self._derivatives) * self.local_count
        return 2 * len(self.residuals) - len(self.bundle.names) - own

    def of_view(self, view: int, fields: Array) -> ReducedView:
        """Return the equations of a view, with its local parameters eliminated.

        Own derivation. Local parameters are eliminated by the Schur complement (Triggs et al., 2000, section 6.1).

        fields: (m, 2, F) float64 displacements of its m stars by a unit of each coefficient, mm.
        """
        bundle, count = self.bundle, len(self.bundle.names)
        columns, weighted = self._weighted_columns(view, fields)
        normal = columns @ columns.T
        known = count + self.local_count
        by_readings = np.zeros((count, count))
        if self._readings is not None:
            normal[:known, :known] += self._readings[0][view]
        normal[count:known, count:known] += bundle.local_prior_information
        local, rest = slice(count, known), [*range(count), *range(known, len(columns))]
        answer = np.linalg.solve(normal[local, local], normal[local, rest])
        if self._readings is not None:
            # The readings' part of the score: its local parameters are eliminated as those of the whole.
            turn = np.hstack([np.eye(count), -answer[:, :count].T])
            by_readings = turn @ self._readings[0][view] @ turn.T
        reduced = normal[np.ix_(rest, rest)] - normal[rest, local] @ answer
        return ReducedView(reduced, columns[known:] @ weighted, float(weighted @ weighted), by_readings)

    def _weighted_columns(self, view: int, fields: Array) -> tuple[Array, Array]:
        """Return (G + L + F, 2 m) weighted derivatives of a view's stars and their (2 m,) weighted residuals.

        The derivatives are by the shared parameters, the local ones and the coefficients of the fields.
        """
        jacobian, moves = self._derivatives[view]
        rows = self.bundle.observations.slices[view]
        root = np.sqrt(self._weights[rows])
        a, b, c = root * self.bundle.observations.factors[:, rows]
        along_x, along_y = np.ascontiguousarray(fields.transpose(1, 2, 0))
        u, v = (-(moves[0, axis] * along_x + moves[1, axis] * along_y) for axis in (0, 1))
        by_x, by_y = np.concatenate([jacobian[:, 0], u]), np.concatenate([jacobian[:, 1], v])
        columns = np.concatenate([a * by_x, b * by_x + c * by_y], axis=1)
        return columns, (root[:, None] * self.residuals[rows]).T.reshape(-1)


def monomials(points: Array, degree: int) -> tuple[Array, NDArray[np.int64]]:
    """Return all monomials of points in the plane up to a degree.

    points: (N, 2) float64.
    Returns: (N, M) float64 values, and the (M,) int64 degree of each.
    """
    powers = [(k - j, j) for k in range(degree + 1) for j in range(k + 1)]
    x, y = [np.ones(len(points))], [np.ones(len(points))]
    for _ in range(degree):
        x.append(x[-1] * points[:, 0])
        y.append(y[-1] * points[:, 1])
    return np.array([x[i] * y[j] for i, j in powers]).T, np.array([i + j for i, j in powers])
