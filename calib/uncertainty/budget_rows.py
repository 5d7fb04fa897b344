"""The uncertainty budget as rows, and the list of what is not known and not included."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from calib.adjustment.bundle import Bundle
from calib.adjustment.levenberg_marquardt import Loss
from calib.adjustment.parameters import AdjustmentParameters
from calib.model.budget_row import ROW_QUANTITIES, WORST_CORNER, BudgetRow
from calib.model.camera import CameraModel
from calib.model.type_b_terms import TermKind, TypeBTerm
from calib.uncertainty.budget_parts import (
    GIMBAL_AXES,
    GIMBAL_SCALE,
    PARALLAX_BOUND,
    PASSPORT,
    PRIORS,
    READINGS,
    STARS,
    covariance_parts,
)
from calib.uncertainty.common_errors import COMMON_ERRORS
from calib.uncertainty.covariance import INCONSISTENCY, Uncertainty
from calib.uncertainty.passport_propagation import UNBOUNDED_PARALLAX
from calib.uncertainty.projection_uncertainty import projection_derivatives
from calib.uncertainty.target_response import TargetResponse
from calib.uncertainty.type_b import AppliedBudget, Contribution, apply_budget

Array = NDArray[np.float64]

#: Type and source of the rows that an adjustment itself gives.
_OWN_SOURCES: Mapping[str, tuple[Literal["A", "B"], str]] = {
    STARS: ("A", "residuals of the stars"),
    INCONSISTENCY: ("A", "differences between the views"),
    COMMON_ERRORS: ("A", "residuals that all views share"),
    PRIORS: ("B", "expected size of the collimator's aberrations"),
    PASSPORT: ("B", "passport or certificate of the collimator"),
    READINGS: ("B", "station: reading_sigma_deg"),
    GIMBAL_SCALE: ("B", "station: scale_sigma, eccentricity_deg"),
    GIMBAL_AXES: ("B", "expected sizes"),
    PARALLAX_BOUND: ("B", "station: pupil_off_pivot_mm and defocus"),
    UNBOUNDED_PARALLAX: ("B", "not stated; about 1 % is typical of collimators out of focus"),
}
_SMALLEST_PX = 0.005


@dataclass(frozen=True)
class UncertaintyBudget:
    """The uncertainty budget of a calibration."""

    applied: AppliedBudget
    rows: tuple[BudgetRow, ...]
    not_included: tuple[str, ...]


def uncertainty_budget(
    bundle: Bundle,
    parameters: AdjustmentParameters,
    loss: Loss,
    estimate: Uncertainty,
    terms: Sequence[TypeBTerm],
    sources: Mapping[str, str] | None = None,
) -> UncertaintyBudget:
    """Add type B terms to the uncertainty of an adjustment, and return its whole budget.

    sources: Where values come from, by name of the row (see `budget_rows`).
    Returns: New uncertainty, rows, and what is not included.
    """
    applied = apply_budget(bundle, parameters, loss, estimate, terms)
    parts = covariance_parts(bundle, parameters, loss, estimate)
    quantities = _quantities(parameters.camera, applied)
    planar = bundle.free_centres and not bundle.has_drift_prior
    return UncertaintyBudget(
        applied, _rows(quantities, applied, parts, sources or {}), _not_included(quantities, applied, planar)
    )


def budget_rows(
    camera: CameraModel,
    applied: AppliedBudget,
    parts: Mapping[str, Array],
    sources: Mapping[str, str] | None = None,
) -> tuple[BudgetRow, ...]:
    """Return the rows of the uncertainty budget.

    The worst corner is the point of the sensor with the largest projection uncertainty, along its worse direction, so
    that the squares of the contributions add up to the square of that uncertainty, as they do for the parameters.

    parts: By source the (G, G) covariance without these terms
      (`calib.uncertainty.budget_parts.covariance_parts`).
    sources: Where values come from, by name of the row; replaces the general words, for example by the number
      of a certificate.
    Returns: Rows of the sources of the adjustment, then those of the terms, in their order. Terms that do not
      apply are omitted.
    """
    return _rows(_quantities(camera, applied), applied, parts, sources or {})


def _rows(
    rows: _Quantities, applied: AppliedBudget, parts: Mapping[str, Array], given: Mapping[str, str]
) -> tuple[BudgetRow, ...]:
    """Return the rows, as `budget_rows`."""
    own = rows.variances(applied.without_terms.covariance)
    found = {source: rows.variances(part) for source, part in parts.items()}
    for name, variance in own.items():
        together = sum(each[name] for each in found.values())
        # A parameter with few degrees of freedom is enlarged (`calib.uncertainty.type_b`), and so is each of its parts.
        for each in found.values():
            each[name] *= variance / together if together > 0 else 0.0
    whole = rows.variances(applied.uncertainty.covariance)
    answer = []
    for name, variances in found.items():
        kind, source = _OWN_SOURCES.get(name, ("B", "station"))
        freedom = applied.without_terms.effective_degrees_of_freedom if kind == "A" else np.inf
        contribution, share = _shares(variances, whole)
        row = BudgetRow(
            name,
            kind,
            source,
            degrees_of_freedom=_finite(freedom),
            contribution=contribution,
            share=share,
        )
        answer.append(_of_certificate(row, applied, rows) if name == PASSPORT else row)
    answer += [_row_of_term(each, rows, whole) for each in applied.contributions if each.applies]
    return tuple(replace(row, source=given.get(row.name, row.source)) for row in answer)


def _row_of_term(each: Contribution, rows: _Quantities, whole: Mapping[str, float]) -> BudgetRow:
    """Return the row of a type B term."""
    term = each.term
    signed = term.kind != "wavefront"
    sensitivity = rows.changes(each.sensitivity)
    if not signed and term.standard_uncertainty > 0:
        variances = rows.variances(each.covariance)
        sensitivity = {name: v**0.5 / term.standard_uncertainty for name, v in variances.items()}
    return BudgetRow(
        term.name,
        "B",
        term.source,
        term.distribution,
        term.value,
        f"mm at {term.radius_mm:g} mm" if term.kind == "print_bow" else term.unit,
        term.divisor,
        _finite(term.degrees_of_freedom),
        sensitivity,
        *_shares(rows.variances(each.covariance), whole),
    )


def _of_certificate(row: BudgetRow, applied: AppliedBudget, rows: _Quantities) -> BudgetRow:
    """Return the row of a passport, with value and sensitivity if it holds the radius alone."""
    response, names = applied.response, list(applied.uncertainty.names)
    if not response.has_certificate:
        return row
    sigma = float(np.sqrt(applied.without_terms.covariance[names.index("r"), names.index("r")]))
    return replace(
        row,
        value=sigma,
        unit="mm",
        divisor=1.0,
        sensitivity=rows.changes(response.shared_by_radius / response.r_mm),
    )


def _shares(
    variances: Mapping[str, float], whole: Mapping[str, float]
) -> tuple[dict[str, float], dict[str, float]]:
    """Return contributions (standard uncertainties) and shares of the whole variance, by quantity."""
    return (
        {name: float(max(v, 0.0) ** 0.5) for name, v in variances.items()},
        {name: float(v / whole[name]) if whole[name] > 0 else 0.0 for name, v in variances.items()},
    )


def _finite(number: float) -> float | None:
    """Return a number, or None if it is infinite."""
    return float(number) if np.isfinite(number) else None


def _quantities(camera: CameraModel, applied: AppliedBudget) -> _Quantities:
    """Return the quantities of all rows; the worst corner is that of the whole uncertainty."""
    return _Quantities(camera, applied.uncertainty.names, applied.uncertainty.covariance)


class _Quantities:
    """The quantities of a row as linear functions of the parameters: pinhole parameters, and the worst corner.

    The worst corner is where, and along which direction, a given covariance has its largest projection uncertainty.
    """

    def __init__(self, camera: CameraModel, names: Sequence[str], covariance: Array) -> None:
        at = [list(names).index(name) for name in camera.parameter_names]
        pixels, derivatives = projection_derivatives(camera)
        self._derivatives = np.zeros((len(pixels), 2, len(names)))
        self._derivatives[:, :, at] = derivatives
        variances = self._derivatives @ covariance @ np.swapaxes(self._derivatives, 1, 2)
        eigenvalues, vectors = np.linalg.eigh(variances)
        worst = int(np.argmax(eigenvalues[:, 1]))
        self._rows = {name: np.eye(len(names))[list(names).index(name)] for name in ROW_QUANTITIES[:4]}
        self._rows[WORST_CORNER] = vectors[worst, :, 1] @ self._derivatives[worst]

    def variances(self, covariance: Array) -> dict[str, float]:
        """Return the variance of each quantity, px^2, for a (G, G) covariance of the parameters."""
        return {name: float(row @ covariance @ row) for name, row in self._rows.items()}

    def changes(self, parameters: Array) -> dict[str, float]:
        """Return the change of each quantity, px, by a (G,) change of the parameters; that of the corner unsigned."""
        found = {name: float(row @ parameters) for name, row in self._rows.items()}
        return {**found, WORST_CORNER: abs(found[WORST_CORNER])}

    def farthest(self, parameters: Array) -> float:
        """Return the largest displacement of an image point over the sensor, px, by a (G,) change of the parameters."""
        return float(np.linalg.norm(self._derivatives @ parameters, axis=1).max())

    def widest(self, covariance: Array) -> float:
        """Return the largest 1-sigma of an image point over the sensor, px, for a (G, G) covariance."""
        variances = self._derivatives @ covariance @ np.swapaxes(self._derivatives, 1, 2)
        return float(np.sqrt(np.maximum(np.linalg.eigvalsh(variances)[:, 1], 0.0)).max())


def not_included(camera: CameraModel, applied: AppliedBudget, *, planar: bool = False) -> tuple[str, ...]:
    """Name the sources of uncertainty that nobody stated, with what each could do to this calibration.

    The amounts are examples. Their effects are computed for these views, this model and this passport.

    planar: Whether the target stands at finite distance, without a collimator.
    Returns: A sentence for each source. Sources that were stated but do not apply are named too.
    """
    return _not_included(_quantities(camera, applied), applied, planar)


def _not_included(quantities: _Quantities, applied: AppliedBudget, planar: bool) -> tuple[str, ...]:
    """Name the sources of uncertainty that nobody stated, as `not_included`."""
    stated = {each.term.kind for each in applied.contributions}
    sentences = []
    for amount, term in _examples(applied.response):
        if term.kind in stated or (planar and term.kind == "wavefront"):
            continue
        sentences.append(f"{term.name}: {amount} would {_effect(term, applied.response, quantities)}")
    idle = (each.term.name for each in applied.contributions if not each.applies)
    why = "stated, but no certificate determines the radius here, so it has no effect"
    return (*sentences, *(f"{name}: {why}" for name in idle))


def _effect(term: TypeBTerm, response: TargetResponse, quantities: _Quantities) -> str:
    """Describe what a term of its value would do: to fx, and to the image point that moves most."""
    at = response.names.index("fx")
    if term.kind == "wavefront":
        covariance = 4.0 * response.shared_by_wavefront(term) * term.value**2  # expanded, k = 2
        fx, farthest = float(np.sqrt(max(covariance[at, at], 0.0))), quantities.widest(covariance)
        chance = " (k = 2)"
    else:
        change = response.shared_by_term(term) * term.value
        fx, farthest, chance = abs(float(change[at])), quantities.farthest(change), ""
    if max(fx, farthest) < _SMALLEST_PX:
        return f"move fx and every image point by less than {_SMALLEST_PX:g} px"
    return f"move fx by {_px(fx)} and an image point by up to {_px(farthest)}{chance}"


def _px(number: float) -> str:
    """Return a length with two significant digits, at most three decimals."""
    return f"{number:.2g} px" if number >= _SMALLEST_PX else f"less than {_SMALLEST_PX:g} px"


def _examples(response: TargetResponse) -> list[tuple[str, TypeBTerm]]:
    """Return an example of each kind that a station may state: the amount in words, and the term."""
    radius = float(np.linalg.norm(response.stars_mm - response.axis_mm, axis=1).max())
    radius = float(np.floor(radius / 5.0) * 5.0) or radius
    examples: list[tuple[str, str, TermKind, float]] = [
        ("scale of the print", "an error of 0.01 %", "print_scale", 1e-4),
        ("bow of the print", f"0.01 mm at {radius:.3g} mm from the axis", "print_bow", 0.01),
        (
            "thermal expansion of the print",
            "5 \N{DEGREE SIGN}C at 9e-6 per \N{DEGREE SIGN}C",
            "thermal",
            4.5e-5,
        ),
        ("slopes of the collimator's wavefront", "5 \N{MICRO SIGN}rad RMS", "wavefront", 5.0),
    ]
    if response.has_certificate:
        examples += [
            (
                "thermal expansion of the collimator since its certificate",
                "5 \N{DEGREE SIGN}C at 2e-5 per \N{DEGREE SIGN}C",
                "collimator_thermal",
                1e-4,
            ),
            (
                "radius on the axis against that over the beam",
                "a difference of 0.06 %",
                "effective_radius",
                6e-4,
            ),
        ]
    return [
        (amount, TypeBTerm(name, kind, value, "example", radius_mm=radius if kind == "print_bow" else None))
        for name, amount, kind, value in examples
    ]
