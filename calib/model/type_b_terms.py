"""Type B terms of the uncertainty budget: what is stated about the bench, as data.

A type B term is an uncertainty that comes from a certificate, a data sheet or experience, not from the views of this
calibration (JCGM 100:2008, section 4.3). Each is an unknown of the joint adjustment (`calib.joint.knowledge`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from calib.arrays import product_sigma
from calib.errors import InputMismatch, require_known
from calib.model.passport import Passport
from calib.view import View

TermKind = Literal[
    "print_scale", "print_bow", "thermal", "collimator_thermal", "effective_radius", "wavefront"
]
Distribution = Literal["normal", "rectangular", "triangular", "u-shaped"]

#: Half width over standard uncertainty of each distribution (JCGM 100:2008, 4.3.7 and 4.3.9; JCGM 101:2008, table 1).
DIVISORS: Mapping[Distribution, float] = {
    "normal": 1.0,
    "rectangular": float(np.sqrt(3.0)),
    "triangular": float(np.sqrt(6.0)),
    "u-shaped": float(np.sqrt(2.0)),
}
#: Unit of the value of each kind; a relative value has the unit 1.
UNITS: Mapping[TermKind, str] = {
    "print_scale": "1",
    "print_bow": "mm",
    "thermal": "1",
    "collimator_thermal": "1",
    "effective_radius": "1",
    "wavefront": "urad",
}
#: Kinds that scale the target.
SCALES: tuple[TermKind, ...] = ("print_scale", "thermal")
#: Kinds that change the radius of a certificate.
RADII: tuple[TermKind, ...] = ("effective_radius", "collimator_thermal")


@dataclass(frozen=True)
class TypeBTerm:
    """A type B term; its value is a half width in the unit of its kind, or `coverage_factor` sigmas if ``normal``.

    kind: What the term changes. ``print_scale``: relative error of the scale of the printed target. ``print_bow``:
      height of a bowed target, mm, at `radius_mm` from the collimator's axis (required). ``thermal``: relative thermal
      expansion of the target. ``effective_radius``: relative difference between the radius of a certificate, which
      holds on the axis, and the effective radius over the beam. ``collimator_thermal``: relative change of that radius
      with temperature. ``wavefront``: RMS error of the slope of the collimator's wavefront, urad.
    source: A certificate, a drawing, a data sheet, a measurement; required.
    degrees_of_freedom: Of the value; infinite if it is exactly known.
    correction: Known relative change, applied to the data before the fit; for the kinds in `SCALES` and `RADII`.
    """

    name: str
    kind: TermKind
    value: float
    source: str
    distribution: Distribution = "normal"
    coverage_factor: float = 1.0
    degrees_of_freedom: float = float("inf")
    correction: float = 0.0
    radius_mm: float | None = None

    def __post_init__(self) -> None:
        where = f"budget term {self.name}"
        require_known("kind", self.kind, get_args(TermKind), where)
        require_known("distribution", self.distribution, get_args(Distribution), where)
        if not self.source.strip():
            raise self._fault("It has no source.", "State where its value comes from.")
        if not 0 <= self.value < np.inf:
            raise self._fault(f"Its value is {self.value}; it must not be negative.")
        if not -1.0 < self.correction < np.inf:
            raise self._fault(f"Its correction is {self.correction}; it must be finite, and above -1.")
        if not self.coverage_factor < np.inf:
            raise self._fault(f"Its coverage_factor is {self.coverage_factor}; it must be finite.")
        if self.correction and self.kind not in (*SCALES, *RADII):
            raise self._fault(f"A term of the kind {self.kind} cannot have a correction.")
        for name in ("coverage_factor", "degrees_of_freedom", "radius_mm"):
            number = getattr(self, name)
            if number is not None and not number > 0:
                raise self._fault(f"Its {name} is {number}; it must be positive.")
        if self.kind == "print_bow" and self.radius_mm is None:
            raise self._fault(
                "Its radius_mm is missing.", "State the distance from the axis at which it is so high."
            )

    def _fault(self, what: str, remedy: str = "") -> InputMismatch:
        """Return the error that names this term."""
        return InputMismatch(what, where=f"budget term {self.name}", remedy=remedy)

    @classmethod
    def thermal(
        cls,
        kind: Literal["thermal", "collimator_thermal"],
        name: str,
        source: str,
        *,
        expansion_per_c: float,
        expansion_sigma_per_c: float,
        difference_c: float,
        difference_sigma_c: float,
    ) -> TypeBTerm:
        """Return the normal term of a thermal expansion, with the expected expansion as its correction.

        Product of a coefficient of expansion and a difference of temperatures, measured minus reference (JCGM 100:2008,
        annex H.1): its variance has the first-order terms and, since the difference may be zero, the product of both
        variances. ``thermal`` is of the target, ``collimator_thermal`` of the radius of a certificate.
        """
        expansion, difference = (expansion_per_c, expansion_sigma_per_c), (difference_c, difference_sigma_c)
        sigma = product_sigma(expansion, difference)
        return cls(name, kind, sigma, source, correction=expansion_per_c * difference_c)

    @property
    def unit(self) -> str:
        """Unit of the value."""
        return UNITS[self.kind]

    @property
    def divisor(self) -> float:
        """Value over standard uncertainty."""
        return self.coverage_factor if self.distribution == "normal" else DIVISORS[self.distribution]

    @property
    def standard_uncertainty(self) -> float:
        """Standard uncertainty, in the unit of the kind."""
        return self.value / self.divisor


def corrected_views(views: Sequence[View], terms: Sequence[TypeBTerm]) -> list[View]:
    """Return views with the stars' true positions on the target, by the corrections of the terms of a scale."""
    scale = _product(terms, SCALES)
    return [view if scale == 1.0 else replace(view, target_mm=scale * view.target_mm) for view in views]


def corrected_passport(passport: Passport, terms: Sequence[TypeBTerm]) -> Passport:
    """Return a passport with the radius that the collimator has during the calibration, by the terms of a radius.

    If it holds more than the radius it stays: it was made with the same collimator and target.
    """
    scale = _product(terms, RADII)
    if passport.names != ("r",) or scale == 1.0:
        return passport
    return replace(passport, values=scale * passport.values)


def _product(terms: Sequence[TypeBTerm], kinds: Sequence[TermKind]) -> float:
    """Return the product of the relative changes that terms of some kinds state as known."""
    return float(np.prod([1.0 + term.correction for term in terms if term.kind in kinds]))
