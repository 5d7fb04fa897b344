"""A known collimator in the table: what a passport states jointly, as independent unknowns, and what has changed since.

With the covariance L L^T of what it states, its values are L z for unknowns z of 1-sigma 1.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.arrays import Array, Ints
from calib.errors import InputMismatch
from calib.model import result_parts as parts
from calib.model.passport import Passport

from . import amplitudes as amp
from . import knowledge as stated
from .fields import DEGREE, DEGREES, Fields
from .shapes import (
    CENTRE,
    FIELD,
    LARGER,
    RADIAL,
    RADIAL_RATIO,
    about_shifted_axis,
    radial_shapes,
    shift,
)
from .table import Row, Statement, Table

#: The pupil of another camera lies so far from that of the passport's, as a share of the radius: 4 mm (1-sigma).
_ELSEWHERE = 0.016
#: A change since a passport is as good as none if its variance is this share of that of the passport.
_UNCHANGED = 1e-3
#: Radial terms if nobody had stated them.
_FREE_RADIAL = (0.05, 0.05 * RADIAL_RATIO)
#: All of a passport has changed as often as one part, times this: another collimator has another axis and radius.
_TOGETHER = 0.1
#: Coefficients of a field that are no shift.
_PLACES = np.flatnonzero(np.tile(DEGREES, 2) > 0)


def stated_names(passport: Passport | None) -> tuple[str, ...]:
    """Return the names that a passport states and that this adjustment has; others are summed out.

    Its common field must have as many coefficients as here: otherwise the same names mean others.
    """
    if passport is None or passport.is_certificate:
        return ()
    field = [name for name in passport.names if name.startswith(FIELD)]
    if field and len(field) != len(_PLACES):
        raise InputMismatch(
            f"Its common field has {len(field)} coefficients; the adjustment has {len(_PLACES)}.",
            where="passport",
            remedy="Make the passport again from its run, with this version of Starbench.",
        )
    known = {*CENTRE, *RADIAL, *(f"{FIELD}{k}" for k in _PLACES)}
    return tuple(name for name in passport.names if name in known)


def add_passport(table: Table, fields: Fields, passport: Passport, source: str) -> None:
    """Add what a passport states, and what has changed since."""
    names = stated_names(passport)
    known = passport.subset(names)
    unit, zero = _units(known, fields)
    values = (known.values - zero) / unit
    floor = np.diag((stated.EXACT * np.maximum(np.abs(known.values), 1e-3) / unit) ** 2)
    covariance = known.covariance / np.outer(unit, unit) + floor + _elsewhere(known, fields)
    if "r" in names:  # the logarithm of the radius is the unknown
        values[names.index("r")] = np.log(known.values_by_name["r"] / fields.r0)
    row = Row(parts.PASSPORT, "B", source)
    root = np.asarray(np.linalg.cholesky(covariance), np.float64)
    mean = np.asarray(np.linalg.solve(root, values), np.float64)
    _add(table, "passport", row, (names, unit), root, np.ones(len(names)), fields, mean=mean)
    for witness, changed, free in (
        (stated.CHANGED_AXIS, CENTRE[:2], 2 * (stated.FREE_RADIUS,)),
        (stated.CHANGED_RADIUS, CENTRE[2:], (stated.FREE_RADIUS,)),
        (stated.CHANGED_RADIAL, RADIAL, _FREE_RADIAL),
    ):
        at = [names.index(name) for name in changed if name in names]
        if not at:
            continue
        own = np.sqrt(np.diag(covariance)[at])
        size = np.sqrt(_UNCHANGED) * own
        chosen = np.eye(len(names))[:, at]
        places = _add(table, f"change of {' '.join(changed)}", row, (names, unit), chosen, size, fields)
        wide = np.hypot(size, [free[changed.index(names[k])] for k in at])
        table.statements.append(
            Statement(
                witness,
                places,
                wide,
                LARGER,
                row,
                "" if witness == stated.CHANGED_RADIAL else "mm",
                per_unknown=float(unit[at[0]]),
                larger=own,
                together=parts.PASSPORT,
                together_odds=_TOGETHER,
            )
        )
    field = [k for k, name in enumerate(names) if name.startswith(FIELD)]
    if field:
        degrees = np.tile(DEGREES, 2)[_PLACES]
        sizes = np.array(amp.falling(1.0, DEGREE))[degrees - 1] / np.sqrt(degrees + 1.0)
        chosen = np.eye(len(names))[:, field]
        _add(table, "change of the field", row, (names, unit), chosen, sizes, fields, amplitude=amp.CHANGE)


def _units(known: Passport, fields: Fields) -> tuple[Array, Array]:
    """Return (k,) the unit of each stated value, and (k,) its zero: lengths are shares of r0, about the reference."""
    reference = dict(zip(CENTRE, fields.reference, strict=True))
    unit = [
        known.values_by_name["r"] if name == "r" else fields.r0 if name in CENTRE else 1.0
        for name in known.names
    ]
    return np.array(unit), np.array([reference.get(name, 0.0) for name in known.names])


def _add(
    table: Table,
    name: str,
    row: Row,
    what: tuple[Sequence[str], Array],
    root: Array,
    size: Array,
    fields: Fields,
    *,
    mean: Array | float = 0.0,
    amplitude: str = "",
) -> Ints:
    """Add q unknowns of which (k, q) ``root`` gives the k named values over their units; return their places."""
    names, unit = what
    columns = np.zeros((table.n, table.basis, root.shape[1]))
    shifts, radial, log_r = shift(fields), radial_shapes(fields), np.zeros(root.shape[1])
    field = np.zeros((columns.shape[1], root.shape[1]))[table.field_slice]
    for k, stated_name in enumerate(names):
        if stated_name == "r":
            log_r = root[k]
        elif stated_name in CENTRE:
            field += np.outer(shifts[:, CENTRE.index(stated_name)], root[k])
        elif stated_name in RADIAL:
            field += np.outer(radial[:, RADIAL.index(stated_name)], root[k])
        else:
            field[int(stated_name.removeprefix(FIELD))] += root[k]
    columns[:, table.field_slice] = field
    at = table.add(
        name, row, size, count=root.shape[1], amplitude=amplitude, mean=mean, columns=columns, log_r=log_r
    )
    for k, stated_name in enumerate(names):
        if stated_name == "r":
            table.follows("log r", at, root[k])
        else:
            table.follows(stated_name, at, unit[k] * root[k])
    return at


def _elsewhere(passport: Passport, fields: Fields) -> Array:
    """Return the (k, k) covariance of what changes because this camera's pupil looks through the glass elsewhere.

    The errors of the glass are then those about a shifted axis, in proportion to its radial terms.
    """
    shifted = about_shifted_axis(fields)
    shapes = np.zeros((len(passport.names), shifted.shape[1]))
    for k, name in enumerate(passport.names):
        if name.startswith(FIELD):
            shapes[k] = shifted[int(name.removeprefix(FIELD))]
    radial, radial_4 = (passport.values_by_name.get(name, 0.0) for name in RADIAL)
    size = _ELSEWHERE * np.hypot(radial, radial_4 / RADIAL_RATIO)
    return np.asarray(size**2 * shapes @ shapes.T)
