"""The collimator: the centre of the spherical motion, and the coefficients of its aberrations.

Behind a collimator, the target is at infinity. A camera that rotates in front of it sees the target as if the camera
moved on a sphere about one fixed point (x, y, -r) of the target frame: the spherical motion model (Liang et al., 2024;
arXiv:2512.16092, eq. 2). Real collimators deviate from this by their aberrations.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from calib.arrays import Array

CENTRE = ("x", "y", "r")
#: Names of the aberrations that a passport may hold, those of earlier versions included. ``radial`` and ``radial_4``
#: are |h|^2 h and |h|^4 h, with the field h in units of r. The others follow the camera's place in the pupil; the joint
#: adjustment has fields by the turn for these (docs/adjustment.md).
ABERRATIONS = frozenset(
    {
        "pupil_shift",
        "radial",
        "radial_4",
        "field_curve",
        "tilt_x",
        "tilt_y",
        "coma",
        "coma_round",
        "astigmatism",
        "rim_4",
        "rim_10",
    }
)


@dataclass(frozen=True)
class Collimator:
    """The centre of the spherical motion and the collimator's aberrations.

    Parameters
    ----------
    x, y
        Foot of the perpendicular from the centre to the target plane, mm.
    r
        Distance of the centre from the target plane, mm: the collimator's focal length on the target's scale.
    aberrations
        Coefficients by name, dimensionless; those that are not named are zero.
    reference
        Centre (x, y, r), mm, about which the aberrations are expressed. It is a convention, not an estimate.
    """

    x: float
    y: float
    r: float
    aberrations: Mapping[str, float] = field(default_factory=dict)
    reference: tuple[float, float, float] | None = None

    @property
    def centre(self) -> Array:
        """(3,) float64 centre (x, y, -r) in the target frame, mm."""
        return np.array([self.x, self.y, -self.r])

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the parameters, in the order of `values`."""
        return (*CENTRE, *self.aberrations)

    @property
    def values(self) -> Array:
        """(3 + T,) float64 values: x, y, r in mm, then T aberration coefficients."""
        return np.array([self.x, self.y, self.r, *self.aberrations.values()])

    def with_values(self, known: Mapping[str, float]) -> Collimator:
        """Return the collimator with some of its parameters replaced.

        Parameters
        ----------
        known
            New values by name; names of other things are ignored.

        Returns
        -------
        Collimator
            Collimator with the same aberrations and the same reference.
        """
        return replace(
            self,
            **{name: known.get(name, getattr(self, name)) for name in CENTRE},
            aberrations={name: known.get(name, value) for name, value in self.aberrations.items()},
        )

    def to_dict(self) -> dict[str, float]:
        """Return the parameters by name.

        Returns
        -------
        dict of str to float
            x, y, r in mm, and the aberration coefficients.
        """
        return dict(zip(self.parameter_names, self.values.tolist(), strict=True))
