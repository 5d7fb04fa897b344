"""The collimator: where the camera's centre of rotation lies in front of the star target, and how a real one departs.

Knows the collimator's parameters only. Behind a collimator the target stands at infinity, and a camera that
turns sees it as if it turned about one fixed point (x, y, -r) of the target frame (the spherical motion model).
What real collimators add to that is measured by named coefficients; `calib.model.aberrations` says what each does.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

CENTRE = ("x", "y", "r")


@dataclass(frozen=True)
class Collimator:
    """The centre of the spherical motion, mm of the target, and the collimator's imperfections.

    Parameters
    ----------
    x, y
        Foot of the perpendicular from the centre to the target plane.
    r
        Distance of the centre from the target plane: the collimator's focal length on the target's scale.
    imperfections
        Coefficients by name; those not named are zero.
    reference
        The centre (x, y, r) about which the coefficients are expressed; it is a convention, not an estimate.
    """

    x: float
    y: float
    r: float
    aberrations: Mapping[str, float] = field(default_factory=dict)
    reference: tuple[float, float, float] | None = None

    @property
    def centre(self) -> Array:
        """(3,) the centre (x, y, -r) in the target frame."""
        return np.array([self.x, self.y, -self.r])

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the parameters, as `values` orders them."""
        return (*CENTRE, *self.aberrations)

    @property
    def values(self) -> Array:
        """(3 + number of coefficients,) x, y, r and the coefficients."""
        return np.array([self.x, self.y, self.r, *self.aberrations.values()])

    def with_values(self, known: Mapping[str, float]) -> Collimator:
        """Return the collimator with the parameters that `known` names."""
        return replace(
            self,
            **{name: known.get(name, getattr(self, name)) for name in CENTRE},
            aberrations={name: known.get(name, value) for name, value in self.aberrations.items()},
        )

    def to_dict(self) -> dict[str, float]:
        """Return the parameters by name."""
        return dict(zip(self.parameter_names, self.values.tolist(), strict=True))
