"""The uncertainty budget of the posterior: V = sum over groups V P_g V, exact at each sample of the amplitudes.

P_g is the information of a group: stars, readings, a statement, a field. With x = V q for the gradient q of a quantity,
x moves the own fields and rotations too; each group contributes x^T P_g x, and they add up to q^T V q. What the
samples' means differ is a row of its own.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from calib.arrays import Array
from calib.joint.effects.effect import Row
from calib.joint.knowledge import Statement
from calib.joint.marginal import Solution
from calib.joint.posterior import Posterior
from calib.model import result_parts as names
from calib.model.result_parts import ROW_QUANTITIES, WORST_CORNER, BudgetRow
from calib.uncertainty.projection_uncertainty import worst_point

#: The rows that are neither effects nor statements, and those about which an effect says the same.
_ROWS = (
    Row(names.STARS, "A", "residuals of the stars"),
    Row(names.READINGS, "B", "station: reading_sigma_deg"),
    Row(names.PUPILS, "A", "visible discs"),
    Row(names.UNSTEADY, "A", "the focal lengths of the poses"),
    Row(names.AMPLITUDES, "A", "the sizes of these errors are known only so well"),
    Row(names.PRIORS, "B", "square pixels, and limits of the unknowns"),
    Row(names.GIMBAL_AXES, "B", "expected sizes"),
)


def variances(posterior: Posterior, gradients: Array) -> dict[str, Array]:
    """Return by group the (p,) variances of quantities with (p, S) gradients; they add up to those of the posterior."""
    parts: defaultdict[str, Array] = defaultdict(lambda: np.zeros(len(gradients)))
    if posterior.unsteady is not None:
        parts[names.UNSTEADY] += (gradients @ posterior.unsteady) ** 2 / 3.0
    means, middle, end = posterior.means @ gradients.T, posterior.mean @ gradients.T, 0
    members = [(posterior, posterior.share, gradients, "")]
    for other in posterior.others:
        members.append((other.posterior, other.share, other.gradients(gradients), other.hypothesis.row))
        parts[other.hypothesis.row] += other.share * ((gradients @ other.rest) * gradients).sum(axis=1)
    differs = max(posterior.others, key=lambda other: other.share).hypothesis.row if posterior.others else ""
    for member, share, slopes, row in members:
        weights = np.array([node.weight for node in member.nodes])
        own_means = means[end : (end := end + len(weights))]
        for node, weight in zip(member.nodes, weights, strict=True):
            for groups, terms in _at_node(node.solution, slopes):
                for group in dict.fromkeys(groups):
                    of_group = [name == group for name in groups]
                    parts[group] += share * weight * (of_group @ terms)
        own = weights @ own_means
        parts[names.AMPLITUDES] += share * (weights @ (own_means - own) ** 2)
        if differs:
            parts[row or differs] += share * (own - middle) ** 2
        if member.pupils is not None:
            parts[names.PUPILS] += share * ((slopes @ member.pupils) * slopes).sum(axis=1)
    return dict(parts)


def _at_node(solution: Solution, gradients: Array) -> Iterator[tuple[Sequence[str], Array]]:
    """Give the (T, p) variances that T terms make at given amplitudes, and the group of each term."""
    marginal, squares = solution.marginal, solution.squares
    x = solution.covariance @ gradients.T
    fields = -np.swapaxes(solution.own_root, 1, 2) @ (solution.between @ x)
    stars = (x * (marginal.shared @ x)).sum(axis=0)
    stars = stars + 2.0 * (fields * (marginal.between @ x)).sum(axis=(0, 1))
    stars = stars + (fields * (marginal.own @ fields)).sum(axis=(0, 1))
    yield (names.STARS,), stars[None] / solution.star_variance
    own = marginal.problem.own_information(squares)
    yield marginal.problem.bench.layout.own.rows, own[:, None] * (fields**2).sum(axis=0)
    if marginal.uses_readings:
        pulled = marginal.rows @ x + marginal.own_rows @ fields[marginal.problem.bench.poses]
        pulled = marginal.reading_weights(squares)[:, :, None] * pulled
        loose, read = solution.star_variance * marginal.loose, marginal.reading_variance(squares)
        yield (names.STARS,), (loose[:, :, None] * pulled**2).sum(axis=(0, 1))[None]
        yield (names.READINGS,), (read[:, :, None] * pulled**2).sum(axis=(0, 1))[None]
    stated = marginal.problem.stated(solution.faults)
    seen = stated.rows @ x
    yield stated.groups, seen * (stated.inside @ seen)
    random = marginal.problem.random
    seen = x[random.places]
    yield random.groups, seen * (solution.inside @ seen)


def row_gradients(posterior: Posterior, camera_covariance: Array) -> Array:
    """Return (5, S) the gradients of `ROW_QUANTITIES`.

    The worst corner is the point of the sensor, and the direction, with the largest projection uncertainty.
    """
    bench = posterior.optimum.marginal.problem.bench
    size = len(bench.layout.pose.camera)
    camera = bench.camera(posterior.mean)
    gradients = np.zeros((len(ROW_QUANTITIES), len(bench.layout.names)))
    gradients[range(4), range(4)] = 1.0
    gradients[4, :size] = worst_point(camera, camera_covariance)
    return gradients


def budget_rows(posterior: Posterior, gradients: Array, parts: Mapping[str, Array]) -> tuple[BudgetRow, ...]:
    """Return the rows of the budget from (5, S) gradients and (5,) variances by group; their squares add up."""
    whole = np.asarray(sum(parts.values()))
    statements = posterior.optimum.marginal.problem.knowledge.statements
    stated: dict[str, list[Statement]] = {}
    for statement in statements:
        stated.setdefault(statement.group, []).append(statement)
    slopes = posterior.optimum.solution.covariance @ gradients.T
    known, rows = _rows_of(posterior), []
    for group, part in parts.items():
        _, kind, source = known.get(group, Row(group, "B"))
        stated_by = stated[group][0].source if group in stated else "station"
        row = BudgetRow.of(group, kind, source or stated_by, part, whole)
        witness = [
            statement for statement in stated.get(group, ()) if statement.unit and len(statement.values) == 1
        ]
        rows.append(_with_value(row, witness[0], slopes) if len(witness) == 1 else row)
    return tuple(rows)


def _rows_of(posterior: Posterior) -> dict[str, Row]:
    """Return the rows that are not statements, by name."""
    layouts = [member.optimum.marginal.problem.bench.layout for member, _, _ in posterior.explanations]
    effects = [row for layout in layouts for row in layout.rows.values()]
    return {row.name: row for row in (*effects, *_ROWS)}


def _with_value(row: BudgetRow, statement: Statement, slopes: Array) -> BudgetRow:
    """Return the row of a single stated value, with its sensitivities."""
    sigma = float(np.sqrt(statement.covariance[0, 0]))
    signs = np.sign((statement.rows @ slopes)[0])
    sensitivity = {
        name: float(sign) * row.contribution[name] / sigma if sigma > 0 else 0.0
        for name, sign in zip(ROW_QUANTITIES, signs, strict=True)
    }
    sensitivity[WORST_CORNER] = abs(sensitivity[WORST_CORNER])
    if statement.term is None:
        return replace(row, value=sigma, unit=statement.unit, divisor=1.0, sensitivity=sensitivity)
    term = statement.term
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
