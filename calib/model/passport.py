"""The collimator's passport: what is known of a collimator, to calibrate cameras with one to three views.

Knows a Gaussian over the collimator's parameters and where it came from. Focal length and radius are nearly one
parameter (correlation .998), so a radius known beforehand settles the focal length. The passport's values are taken as
they are, not estimated anew by one to three views that know less; their uncertainty enters that of the camera.
Files are written and read elsewhere; here are plain numbers in and out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.errors import InputMismatch
from calib.model.collimator import CENTRE, Collimator
from calib.model.prior import Prior

Array = NDArray[np.float64]

SCHEMA = "starbench/collimator-passport/1"
#: A parameter held exactly would make the equations singular; this share of it is as good as exact.
_FLOOR = 1e-9


@dataclass(frozen=True)
class Passport:
    """A collimator as known before a camera is calibrated.

    Parameters
    ----------
    names, values
        The parameters known: of x, y, r, mm, and of the imperfections.
    covariance
        Their joint covariance.
    reference
        Centre about which the imperfections are expressed; None when there are none.
    disagreement
        How many times their stars' noise the views differed by from which it came; 1 for a certificate.
    views
        Names of those views.
    conditions
        Whatever else is to be remembered: serial number, temperature, date, certificate.

    Raises
    ------
    InputMismatch
        When the numbers contradict each other.
    """

    names: tuple[str, ...]
    values: Array
    covariance: Array
    reference: tuple[float, float, float] | None = None
    birge_ratio: float = 1.0
    views: tuple[str, ...] = ()
    conditions: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        n = len(self.names)
        if self.values.shape != (n,) or self.covariance.shape != (n, n):
            raise InputMismatch(f"{n} parameters, but {self.values.shape} values.", where="passport")
        if not (np.isfinite(self.values).all() and np.isfinite(self.covariance).all()):
            raise InputMismatch("It holds numbers that are not finite.", where="passport")
        eigenvalues = np.linalg.eigvalsh(self.covariance)
        if not np.allclose(self.covariance, self.covariance.T) or eigenvalues[0] < -1e-9 * eigenvalues[-1]:
            raise InputMismatch("Its covariance is none.", where="passport")
        if "r" not in self.names:
            raise InputMismatch("It does not know the radius r.", where="passport")
        if self.terms and self.reference is None:
            raise InputMismatch("Its imperfections have no reference.", where="passport")

    @classmethod
    def of_radius(cls, r_mm: float, sigma_mm: float, conditions: Mapping[str, Any] | None = None) -> Passport:
        """Return the passport that a certificate of the radius makes."""
        return cls(("r",), np.array([r_mm]), np.array([[sigma_mm**2]]), conditions=conditions or {})

    @property
    def terms(self) -> tuple[str, ...]:
        """Names of the imperfections known."""
        return tuple(name for name in self.names if name not in CENTRE)

    @property
    def values_by_name(self) -> Mapping[str, float]:
        """The parameters by name."""
        return dict(zip(self.names, self.values.tolist(), strict=True))

    def collimator(self, otherwise: Collimator) -> Collimator:
        """Return the collimator, x, y or r taken from another where the passport does not know them."""
        start = Collimator(
            otherwise.x, otherwise.y, otherwise.r, dict.fromkeys(self.terms, 0.0), self.reference
        )
        return start.with_values(self.values_by_name)

    def subset(self, names: Sequence[str]) -> Passport:
        """Return what it knows of some of the parameters; those it does not know are passed over."""
        kept = tuple(name for name in self.names if name in names)
        values = np.array([self.values_by_name[name] for name in kept])
        return replace(self, names=kept, values=values, covariance=self.covariance_of(kept))

    def covariance_of(self, names: Sequence[str]) -> Array:
        """Return the joint covariance of some of the parameters, in the order asked for."""
        at = [self.names.index(name) for name in names]
        return self.covariance[np.ix_(at, at)]

    def prior(self, names: Sequence[str]) -> Prior | None:
        """Return what it knows of some of the parameters as a prior of the refinement; None for no names."""
        if not names:
            return None
        mean = np.array([self.values_by_name[name] for name in names])
        floor = np.diag((_FLOOR * np.maximum(np.abs(mean), 1e-3)) ** 2)
        return Prior(tuple(names), mean, np.asarray(np.linalg.inv(self.covariance_of(names) + floor)))

    def to_dict(self) -> dict[str, Any]:
        """Return plain numbers, lists and names, ready for JSON."""
        return {
            "schema": SCHEMA,
            "names": list(self.names),
            "values": self.values.tolist(),
            "covariance": self.covariance.tolist(),
            "reference": list(self.reference) if self.reference else None,
            "disagreement": self.birge_ratio,
            "views": list(self.views),
            "conditions": dict(self.conditions),
        }

    @classmethod
    def from_dict(cls, shape: Mapping[str, Any]) -> Passport:
        """Read what `to_dict` returns.

        Raises
        ------
        InputMismatch
            When it is no passport.
        """
        if shape.get("schema") != SCHEMA:
            raise InputMismatch(f"Not a passport: its schema is {shape.get('schema')!r}.", where="passport")
        try:
            return cls(
                tuple(str(name) for name in shape["names"]),
                np.array(shape["values"], float),
                np.array(shape["covariance"], float),
                _triple(shape["reference"]),
                float(shape["disagreement"]),
                tuple(str(name) for name in shape["views"]),
                dict(shape["conditions"]),
            )
        except (KeyError, TypeError, ValueError) as error:
            raise InputMismatch(f"Not a passport: {error}.", where="passport") from error


def _triple(numbers: Sequence[float] | None) -> tuple[float, float, float] | None:
    """Return three numbers as a tuple."""
    if numbers is None:
        return None
    x, y, r = (float(v) for v in numbers)
    return x, y, r
