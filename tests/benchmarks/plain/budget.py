"""The uncertainty budget: V = sum over groups V P_g V, exact at each component of the mixture.

P_g is the information of a group: stars, readings, a row of the table. With x = V q for the gradient q of a quantity, x
moves the unknowns of the poses too; each group contributes x^T P_g x, and they add up to q^T V q. What the means of the
components differ is a row of its own.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from calib.arrays import Array
from calib.model import result_parts as names
from calib.model.result_parts import ROW_QUANTITIES, WORST_CORNER, BudgetRow
from calib.uncertainty.projection_uncertainty import worst_point

from .mixture import Mixture
from .solution import Solution, reading_weights
from .table import Row, Statement

#: The rows that are no effects.
_ROWS = (
    Row(names.STARS, "A", "residuals of the stars"),
    Row(names.READINGS, "B", "station: reading_sigma_deg"),
    Row(names.PUPILS, "A", "visible discs"),
    Row(names.UNSTEADY, "A", "the focal lengths of the poses"),
    Row(names.AMPLITUDES, "A", "the sizes of these errors are known only so well"),
)


def variances(mixture: Mixture, rows: Array) -> dict[str, Array]:
    """Return by group the (p,) variances of (p, Q) functions of the quantities; they add up to those of the mixture."""
    parts = {names.UNSTEADY: (rows @ mixture.changing) ** 2} if mixture.unsteady else dict[str, Array]()
    middle, own_means = rows @ mixture.mean, _means(mixture, rows)
    for weight, component, own, number in mixture.members:
        gradients = rows @ own.rows
        for group, part in _at_component(component.solution, gradients).items():
            parts[group] = parts.get(group, 0.0) + weight * part
        there = rows @ own.values
        within, between = (there - own_means[number]) ** 2, (own_means[number] - middle) ** 2
        parts[names.AMPLITUDES] = parts.get(names.AMPLITUDES, 0.0) + weight * within
        differs = mixture.parts[number].row or next((part.row for part in mixture.parts if part.row), "")
        if differs:
            parts[differs] = parts.get(differs, 0.0) + weight * between
    return parts


def _means(mixture: Mixture, rows: Array) -> list[Array]:
    """Return (p,) the means of each explanation alone."""
    means = []
    for number, part in enumerate(mixture.parts):
        own = [
            weight * (rows @ there.values) for weight, _, there, other in mixture.members if other == number
        ]
        means.append(np.asarray(sum(own)) / part.share)
    return means


def _at_component(solution: Solution, gradients: Array) -> dict[str, Array]:
    """Return the (p,) variances by group of quantities with (p, S) gradients."""
    q, p, prior = solution.equations, solution.problem, solution.prior
    x, local, turned = solution.pulled(gradients)
    between, alone, _ = q.local
    stars = (x * (q.shared @ x)).sum(axis=0) + 2.0 * (local * (between @ x)).sum(axis=(0, 1))
    stars = stars + (local * (alone @ local)).sum(axis=(0, 1))
    # What the shared unknowns alone leave of the poses' own: the covariance of the poses does not move quantities.
    parts = {names.STARS: prior.star * stars}
    own = (local[:, : q.own_size] ** 2).sum(axis=0)
    known = np.concatenate([prior.shared[:, None] * x**2, prior.own[:, None] * own])
    for group, member in p.groups.items():
        parts[group] = parts.get(group, 0.0) + member @ known
    if p.readings is not None:
        pulled = (reading_weights(q, prior)[:, None, None] * turned**2).sum(axis=(0, 1))
        parts[names.READINGS] = parts.get(names.READINGS, 0.0) + pulled
    return parts


def row_gradients(mixture: Mixture) -> Array:
    """Return (5, Q) the gradients of `ROW_QUANTITIES`.

    The worst corner is the point of the sensor, and the direction, with the largest projection uncertainty.
    """
    camera = mixture.camera
    size = len(camera.values)
    gradients = np.zeros((len(ROW_QUANTITIES), len(mixture.names)))
    gradients[range(4), range(4)] = 1.0
    gradients[4, :size] = worst_point(camera, mixture.covariance[:size, :size])
    return gradients


def budget_rows(mixture: Mixture, gradients: Array, parts: Mapping[str, Array]) -> tuple[BudgetRow, ...]:
    """Return the rows of the budget from (5, Q) gradients and (5,) variances by group; their squares add up."""
    whole, unknowns = np.asarray(sum(parts.values())), mixture.problem.unknowns
    every = [row for part in mixture.parts for row in part.posterior.problem.unknowns.rows]
    known = {row.name: row for row in (*every, *mixture.problem.own.rows, *_ROWS)}
    first = mixture.first.largest.solution
    own = next(there for _, component, there, _ in mixture.members if component.solution is first)
    slopes = first.covariance @ (gradients @ own.rows).T
    rows = []
    for group, part in parts.items():
        _, kind, source = known.get(group, Row(group, "B"))
        row = BudgetRow.of(group, kind, source or "station", part, whole)
        stated = [s for s in unknowns.statements if s.row.name == group and s.unit and len(s.at) == 1]
        rows.append(_with_value(row, stated[0], slopes, unknowns.size) if len(stated) == 1 else row)
    return tuple(rows)


def _with_value(row: BudgetRow, statement: Statement, slopes: Array, size: Array) -> BudgetRow:
    """Return the row of a single stated value, with its sensitivities."""
    at = int(statement.at[0])
    sigma = float(size[at]) * statement.per_unknown
    signs = np.sign(slopes[at])
    sensitivity = {
        name: float(sign) * row.contribution[name] / sigma if sigma > 0 else 0.0
        for name, sign in zip(ROW_QUANTITIES, signs, strict=True)
    }
    sensitivity[WORST_CORNER] = abs(sensitivity[WORST_CORNER])
    term = statement.term
    if term is None:
        return replace(row, value=sigma, unit=statement.unit, divisor=1.0, sensitivity=sensitivity)
    freedom = term.degrees_of_freedom
    return replace(
        row,
        distribution=term.distribution,
        value=term.value,
        unit=f"mm at {term.radius_mm:g} mm" if term.kind == "print_bow" else term.unit,
        divisor=term.divisor,
        degrees_of_freedom=freedom if np.isfinite(freedom) else None,
        sensitivity=sensitivity,
    )
