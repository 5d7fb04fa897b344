"""Numbers of a passport that no measurement gives: too small, too large, or a covariance that is not one. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from calib.errors import InputMismatch
from calib.model.passport import Passport

_MOST = 1e6
"""Largest size of a value, mm; no collimator is a kilometre long."""
LEAST_R_MM = 0.1
"""Smallest focal length of a collimator, mm."""
_LEAST_SIGMA = 1e-7
"""Smallest standard uncertainty, mm: a tenth of a nanometre."""
_LEAST_RELATIVE_SIGMA_OF_R = 1e-8
_LEAST_EIGENVALUE = 1e-13
"""Smallest eigenvalue of the correlation matrix; rounding alone gives values below it."""
_ASYMMETRY = 1e-9
_MOST_NUMBERS = 10_000


def refuse_absurd_numbers(document: Mapping[str, Any]) -> None:
    """Refuse values and covariances of a size that no collimator has, before anything is calculated with them.

    Raises InputMismatch: When a number is too large or too small.
    """
    for name in ("values", "covariance"):
        numbers = list(_numbers(document.get(name)))
        if len(numbers) > _MOST_NUMBERS:
            raise InputMismatch(f"Its {name} has more than {_MOST_NUMBERS} numbers.", where="passport")
        for number in numbers:
            if not abs(number) <= _MOST:
                raise InputMismatch(f"Its {name} contains {number:g}, which is too large.", where="passport")


def _numbers(found: Any) -> list[float]:
    """Return all numbers of nested lists; other things are left to the reader of the passport."""
    if isinstance(found, list):
        return [number for one in found for number in _numbers(one)]
    if isinstance(found, bool) or not isinstance(found, int | float):
        return []
    try:
        return [float(found)]
    except OverflowError:
        return [float("inf")]


def refuse_indefinite(passport: Passport) -> None:
    """Refuse a covariance that is not symmetric and positive definite, or states a certainty that nobody has.

    Own limits: a standard uncertainty below 0.1 nm, or below 1e-8 of the focal length, is not a measurement. The
    smallest eigenvalue is that of the correlation matrix, so that the units of the parameters do not matter.

    Raises InputMismatch: When it is refused; the message names the parameter.
    """
    covariance = passport.covariance
    variances = covariance.diagonal()
    least = {
        name: max(_LEAST_SIGMA, _LEAST_RELATIVE_SIGMA_OF_R * abs(value) if name == "r" else 0.0)
        for name, value in passport.values_by_name.items()
    }
    for name, variance in zip(passport.names, variances.tolist(), strict=True):
        if not variance > least[name] ** 2:
            what = f"The variance of {name} in its covariance is {variance:g}; "
            raise InputMismatch(
                f"{what}no measurement is that certain. A variance is the square of a standard uncertainty, mm².",
                where="passport",
            )
    scale = np.sqrt(variances)
    correlation = covariance / np.outer(scale, scale)
    if not np.allclose(correlation, correlation.T, rtol=0.0, atol=_ASYMMETRY):
        raise InputMismatch("Its covariance is not symmetric.", where="passport")
    if np.linalg.eigvalsh(correlation)[0] < _LEAST_EIGENVALUE:
        raise InputMismatch(
            "Its covariance is not positive definite: the uncertainties contradict each other.",
            where="passport",
        )
