"""What is known beside the stars: statements, each a linear observation of shared unknowns with its source.

A statement says ``rows b = values`` with a covariance. Its errors may be larger than stated: up to what would be known
of the same quantity if nobody had stated it. The posterior weighs these (`calib.joint.doubts`), so a wrong statement
loses its weight, and a note can name it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np

from calib.arrays import Array
from calib.calibration import CalibrationOptions
from calib.errors import InputMismatch
from calib.joint.effects.by_turn import ASIDE, ByTurn
from calib.joint.effects.camera import DRIFT
from calib.joint.effects.collimator import (
    CENTRE,
    CHANGE,
    COMMON_PLACES,
    FIELD,
    RADIAL,
    RADIAL_RATIO,
    SHIFTED_SIZES,
)
from calib.joint.effects.gimbal import GimbalErrors
from calib.joint.fields import FieldBasis
from calib.joint.hypotheses import ANOTHER_THING, LARGER_ERRORS, NOT_SQUARE, OTHER_LENGTH, UNSTEADY
from calib.joint.layout import Layout
from calib.model import result_parts as rows
from calib.model.cause import PARALLAX
from calib.model.gimbal import MOUNTING, NON_ORTHOGONALITY, SCALES, STANDING
from calib.model.gimbal_readings import GimbalReadings, ParallaxBound
from calib.model.passport import Passport
from calib.model.target_focus import CertifiedLength, TargetFocus
from calib.model.type_b_terms import RADII, TypeBTerm
from calib.model.type_b_terms import SCALES as SCALE_TERMS

#: Fault of a statement: it is as if nobody had stated it.
WRONG = "wrong"
#: Errors may be so many times as large as stated, or more: the first step of a ladder. By each further such factor the
#: odds fall as one over the width, as the tails of published measurements do (Bailey, 2017).
_WIDER = 10.0**0.5
#: A statement is named if it is doubted with this probability. An honest one is named at 2.8 sigma.
DOUBTED = 0.2
#: No fault: a certificate that does not say which length it states may state the focal length, and not what the camera
#: sees.
FOCAL = "focal length"
#: Names of witnesses.
CERTIFICATE = "certificate of the collimator"
CHANGED_AXIS = "change of the axis since the passport"
CHANGED_RADIUS = "change of the radius since the passport"
CHANGED_RADIAL = "change of the radial errors since the passport"
CHANGED_FIELD = "size of irregular changes since the passport"
SCALE_OF, ORTHOGONAL = "scale of {}", "axes at a right angle"
ASPECT, READINGS = "square pixels", "readings of the gimbal"
STEADY = "steady focal length"

#: 1-sigma of the coefficients of a denominator: the share of the distance from the axis by which they move a point at
#: the corner of the sensor. All others of a lens have an amplitude (`calib.joint.layout`).
_DENOMINATOR = {"k4": 0.1, "k5": 0.05, "k6": 0.01}
_SKEW_PX = 5.0
#: Pixels are square to this share: a sensor is exact to 1e-5, but one that is tilted by 1.4 degrees shows one axis
#: shorter by 3e-4. If not, to the second.
_ASPECT_SIGMA, _FREE_ASPECT = 3e-4, 0.1
#: Focal length and radius change by this share from first to last pose: 1 K of aluminium; if not, by the second.
_DRIFT_SIGMA, _FREE_DRIFT = 3e-5, 5e-3
#: The principal point lies in the middle of the sensor to this share of its diagonal.
_MIDDLE_SHARE = 0.1
#: A certificate may be another collimator's, whose radius is within a factor of 1.5 (1-sigma).
_ANY_RADIUS = 0.4
#: If nobody had stated it, or stated it wrongly: the radius since a passport, the scale of an axis or a print, its
#: thermal expansion, the parallax over the one that is expected without a bound.
_FREE_RADIUS, FREE_SCALE, _FREE_PARALLAX = 0.02, 0.005, 0.005
_FREE_RADIAL = {"radial": 0.05, "radial_4": 0.05 * RADIAL_RATIO}
_FREE_TERMS = {"thermal": 1e-3, "print_scale": 5e-3}
_SKEW_DEG = 0.1
#: The pupil of another camera lies so far from that of the passport's, as a share of the radius: 4 mm (1-sigma).
_ELSEWHERE = 0.016
#: Standard uncertainty that stands for exact, as a share.
_EXACT = 1e-7
#: A change since a passport is as good as none if its variance is this share of that of the passport.
_UNCHANGED = 1e-3


class Doubt(NamedTuple):
    """What a statement can be beside what it says."""

    covariance: Array  # (k, k)
    odds: float  # Beforehand, against a statement that holds


@dataclass(frozen=True)
class Statement:
    """A linear observation of shared unknowns."""

    name: str  # Of the witness
    group: str  # The row of the budget that it belongs to
    source: str
    rows: Array  # (k, S)
    values: Array  # (k,)
    covariance: Array  # (k, k)
    # (k, k) covariance if nobody had stated it; None if this is no statement that could be wrong.
    free: Array | None = None
    # (k, k) covariance that is larger if the errors are larger than stated; None: all of it.
    doubtful: Array | None = None
    # (k, k) covariance if it states a focal length; None if that is none of its meanings.
    focal: Array | None = None
    unit: str = ""
    term: TypeBTerm | None = None  # The type B term of the budget that it is
    doubt: float = LARGER_ERRORS.odds  # Odds beforehand that its errors are `_WIDER` times as large or more

    @cached_property
    def doubts(self) -> Mapping[str, Doubt]:
        """What else it can be, by name: ever wider ones up to that if nobody had stated it, and its other meaning."""
        if self.free is None:
            return {}
        own = self.covariance if self.doubtful is None else self.doubtful
        widest = float(np.sqrt(np.linalg.eigvals(np.linalg.solve(own, self.free)).real.max()))
        doubts, left, times = {}, self.doubt, _WIDER
        while times * _WIDER**0.5 < widest:
            wider = self.covariance + (times**2 - 1.0) * own
            doubts[f"{times:.3g} times"] = Doubt(wider, left * (1.0 - 1.0 / _WIDER))
            left, times = left / _WIDER, times * _WIDER
        doubts[WRONG] = Doubt(self.free, max(left, ANOTHER_THING.odds))
        return doubts if self.focal is None else doubts | {FOCAL: Doubt(self.focal, OTHER_LENGTH.odds)}

    @cached_property
    def _informations(self) -> dict[str, Array]:
        """The inverse covariances, by doubt."""
        covariances = {"": self.covariance} | {name: doubt.covariance for name, doubt in self.doubts.items()}
        return {name: np.asarray(np.linalg.inv(covariance)) for name, covariance in covariances.items()}

    def information(self, doubt: str = "") -> Array:
        """Return the (k, k) inverse covariance; ``doubt`` is one of `doubts`, or empty if the statement holds."""
        return self._informations.get(doubt, self._informations[""])

    def as_meant(self, fault: str) -> Statement:
        """Return the statement as ``fault`` says it is meant: that of a focal length, or as it stands."""
        if fault != FOCAL or self.focal is None:
            return self
        return replace(self, covariance=self.focal, focal=None)


@dataclass(frozen=True)
class Knowledge:
    """All statements."""

    statements: tuple[Statement, ...]

    @property
    def witnesses(self) -> dict[str, Statement]:
        """The statements that could be wrong, by name."""
        return {statement.name: statement for statement in self.statements if statement.free is not None}


class _Source(NamedTuple):
    """Who states something, and the row of the budget that it belongs to."""

    layout: Layout
    group: str
    name: str

    def says(
        self,
        what: str,
        terms: Mapping[str, float],
        stated: tuple[float, float],
        free: float | None = None,
        unit: str = "",
        term: TypeBTerm | None = None,
    ) -> Statement:
        """Return a statement about a sum of unknowns, each times its factor in ``terms``.

        ``stated`` is value and 1-sigma; ``free`` the 1-sigma if nobody had stated it.
        """
        row = np.zeros((1, len(self.layout.names)))
        row[0, self.layout.places(tuple(terms))] = list(terms.values())
        wide = None if free is None else np.array([[max(free, stated[1]) ** 2]])
        values, covariance = np.array([stated[0]]), np.array([[stated[1] ** 2]])
        return Statement(what, self.group, self.name, row, values, covariance, wide, unit=unit, term=term)


def gather(
    options: CalibrationOptions, layout: Layout, image_size: tuple[int, int], start: Mapping[str, float]
) -> Knowledge:
    """Return all that is known beside the stars; ``start``, near the solution, scales the weak limits."""
    statements = [*_camera(layout, image_size, start), *_limits(layout, image_size, start)]
    passport = options.passport
    statements += [_of_term(layout, term) for term in options.budget if term.name in layout.bench.terms]
    if passport is not None and passport.is_certificate:
        statements.append(_certificate(layout, options, passport))
    elif passport is not None:
        statements += _passport(layout, options, passport)
    bound = options.gimbal.parallax if options.gimbal else None
    if bound is not None:
        statements += _parallax(layout, bound, start["r"])
    if layout.names_of(GimbalErrors) and options.gimbal:
        statements += _gimbal(layout, options.gimbal)
    if options.radial_sigma is not None and not set(layout.bench.passport) & set(RADIAL):
        station = _Source(layout, rows.PRIORS, "station: bow and distortion")
        sigmas = zip(RADIAL, (options.radial_sigma, options.radial_sigma * RADIAL_RATIO), strict=True)
        statements += [
            station.says("distortion of the target's map", {name: 1.0}, (0.0, sigma))
            for name, sigma in sigmas
        ]
    return Knowledge(tuple(statements))


def _of_term(layout: Layout, term: TypeBTerm) -> Statement:
    """Return the statement of a type B term."""
    stated, free = (0.0, max(term.standard_uncertainty, 1e-12)), _FREE_TERMS.get(term.kind)
    source = _Source(layout, term.name, term.source)
    return source.says(term.name, {term.name: 1.0}, stated, free, term.unit, term)


def _camera(layout: Layout, image_size: tuple[int, int], start: Mapping[str, float]) -> list[Statement]:
    """Return what is known of every camera: square pixels, a focal length that stays, a lens that is not absurd."""
    f = float(np.sqrt(start["fx"] * start["fy"]))
    square = _Source(layout, rows.PRIORS, "pixels are square")
    still = _Source(layout, rows.PRIORS, "nothing changes while the poses are recorded")
    camera = [
        replace(
            square.says(ASPECT, {"fx": 1.0 / f, "fy": -1.0 / f}, (0.0, _ASPECT_SIGMA), _FREE_ASPECT),
            doubt=NOT_SQUARE.odds,
        ),
        replace(still.says(STEADY, {DRIFT: 1.0}, (0.0, _DRIFT_SIGMA), _FREE_DRIFT), doubt=UNSTEADY.odds),
    ]
    corner, lens = 0.5 * float(np.hypot(*image_size)) / f, _Source(layout, rows.LENS, "expected sizes")
    sigmas = {name: size * corner ** (-2.0 * (int(name[1]) - 3)) for name, size in _DENOMINATOR.items()}
    sigmas["skew"] = _SKEW_PX
    camera += [
        lens.says(rows.LENS, {name: 1.0}, (0.0, sigmas[name]))
        for name in layout.pose.camera[4:]
        if name in sigmas
    ]
    return camera


def _limits(layout: Layout, image_size: tuple[int, int], start: Mapping[str, float]) -> list[Statement]:
    """Return priors so wide that they matter only where nothing else is known."""
    middle = 0.5 * (np.array(image_size) - 1.0)
    wide = _MIDDLE_SHARE * float(np.hypot(*image_size))
    limits = {"cx": (float(middle[0]), wide), "cy": (float(middle[1]), wide)}
    limits |= {name: (start[name], start[name]) for name in ("fx", "fy")}
    limits |= {name: (start[name], start["r"]) for name in CENTRE}
    expected = _Source(layout, rows.PRIORS, "expected sizes")
    return [expected.says(rows.PRIORS, {name: 1.0}, stated) for name, stated in limits.items()]


def _certificate(layout: Layout, options: CalibrationOptions, passport: Passport) -> Statement:
    """Return a certificate's length on the axis; type B terms of the radius change it."""
    r_mm = float(passport.values_by_name["r"])
    terms = {
        term.name: r_mm for term in options.budget if term.kind in RADII and term.name in layout.bench.terms
    }
    sigma = max(float(np.sqrt(passport.covariance[0, 0])), _EXACT * r_mm)
    source = _Source(layout, rows.PASSPORT, options.passport_source or "certificate of the collimator")
    focus = _focus(options)
    more_mm, more_sigma = focus.seen_less_focal_mm(r_mm)
    focal = r_mm + more_mm, float(np.hypot(sigma, more_sigma))
    # Who states where the pupil is before the focal plane means the focal length.
    is_focal = passport.length == CertifiedLength.FOCAL or bool(focus.pupil_to_focus_mm)
    stated = focal if is_focal and passport.length != CertifiedLength.SEEN else (r_mm, sigma)
    certificate = source.says(CERTIFICATE, {"r": 1.0, **terms}, stated, _ANY_RADIUS * r_mm, "mm")
    unsaid = passport.length == CertifiedLength.UNSAID and not is_focal
    return replace(certificate, focal=np.array([[focal[1] ** 2]])) if unsaid else certificate


def _focus(options: CalibrationOptions) -> TargetFocus:
    """Return what is known of the target's focus and the pupil's place; a bound of the parallax has a defocus."""
    focus = options.focus or TargetFocus()
    bound = options.gimbal.parallax if options.gimbal else None
    if focus.defocus is not None or bound is None:
        return focus
    return replace(focus, defocus=(bound.defocus, bound.defocus_sigma))


def stated_names(passport: Passport) -> tuple[str, ...]:
    """Return the names that a passport states; aberrations that this adjustment does not have are summed out.

    Its common field must have as many coefficients as here: otherwise the same names mean others.
    """
    field = [name for name in passport.names if name.startswith(FIELD)]
    if field and len(field) != len(COMMON_PLACES):
        raise InputMismatch(
            f"Its common field has {len(field)} coefficients; the adjustment has {len(COMMON_PLACES)}.",
            where="passport",
            remedy="Make the passport again from its run, with this version of Starbench.",
        )
    return () if passport.is_certificate else passport.names


def _passport(layout: Layout, options: CalibrationOptions, passport: Passport) -> list[Statement]:
    """Return the joint statement of a passport about what was then, and that nothing has changed since.

    The amplitude of the changes of the common field is estimated (`calib.joint.layout`).
    """
    known = passport.subset(layout.bench.passport)
    source = options.passport_source or "passport of the collimator"
    then = np.zeros((len(known.names), len(layout.names)))
    for row, name in zip(then, known.names, strict=True):
        row[[layout.index[name], layout.index[CHANGE.format(name)]]] = 1.0, -1.0
    floor = np.diag((_EXACT * np.maximum(np.abs(known.values), 1e-3)) ** 2)
    covariance = known.covariance + floor + _elsewhere(layout, known)
    statements = [Statement(rows.PASSPORT, rows.PASSPORT, source, then, known.values, covariance)]
    free = dict.fromkeys(CENTRE, _FREE_RADIUS * known.values_by_name["r"]) | _FREE_RADIAL
    for witness, names in (
        (CHANGED_AXIS, CENTRE[:2]),
        (CHANGED_RADIUS, CENTRE[2:]),
        (CHANGED_RADIAL, RADIAL),
    ):
        at = [known.names.index(name) for name in names if name in known.names]
        if not at:
            continue
        own, wide = covariance[np.ix_(at, at)], np.diag([free[known.names[k]] ** 2 for k in at])
        stated = _UNCHANGED * own
        statements.append(
            Statement(
                witness,
                rows.PASSPORT,
                source,
                np.eye(len(layout.names))[layout.places([CHANGE.format(known.names[k]) for k in at])],
                np.zeros(len(at)),
                stated,
                stated + wide,
                own,
                unit="mm" if witness != CHANGED_RADIAL else "",
            )
        )
    return statements


def _elsewhere(layout: Layout, passport: Passport) -> Array:
    """Return the (k, k) covariance of what changes because this camera's pupil looks through the glass elsewhere.

    The errors of the glass are then those about a shifted axis, in proportion to its radial terms.
    """
    shifted = layout.basis.about_shifted_axis(SHIFTED_SIZES)
    shapes = np.zeros((len(passport.names), shifted.shape[1]))
    for k, name in enumerate(passport.names):
        if name.startswith(FIELD):
            shapes[k] = shifted[int(name.removeprefix(FIELD))]
    radial, radial_4 = (passport.values_by_name.get(name, 0.0) for name in RADIAL)
    size = _ELSEWHERE * np.hypot(radial, radial_4 / RADIAL_RATIO)
    return np.asarray(size**2 * shapes @ shapes.T)


def _parallax(layout: Layout, bound: ParallaxBound, r_mm: float) -> list[Statement]:
    """Return what bounds the parallax: its size, how alike it is along both axes, how far the pupil is beside them."""
    stated, aside = bound.mean_and_sigma(r_mm), max(bound.aside_sigma(r_mm), 1e-9)
    value, sigma = stated[0], max(stated[1], 1e-9)
    station = _Source(layout, rows.PARALLAX, "station: pupil_off_pivot_mm and defocus")
    free = max(_FREE_PARALLAX, 5.0 * sigma)
    other = 0.2 * sigma + 2e-5
    on_axis = ByTurn(layout.pose, layout.bench).on_axis
    x, y = on_axis("turn_x", 0, 0.5), on_axis("turn_y", 1, 0.5)
    alike = (x | on_axis("turn_y", 1, -0.5), on_axis("turn_x", 1), on_axis("turn_y", 0))
    return [
        station.says(PARALLAX, x | y, (value, sigma), free, "1"),
        *(station.says(PARALLAX, terms, (0.0, other)) for terms in alike),
        *(station.says(PARALLAX, {name: 1.0}, (0.0, aside)) for name in ASIDE),
    ]


def _gimbal(layout: Layout, readings: GimbalReadings) -> list[Statement]:
    """Return what is known of the gimbal's axes."""
    expected = _Source(layout, rows.GIMBAL_AXES, "expected sizes")
    station = _Source(
        layout, rows.GIMBAL_SCALE, f"station: {readings.source}" if readings.source else "station"
    )
    square, scale = float(np.radians(_SKEW_DEG)), (1.0, max(readings.scale_sigma, _EXACT))
    eccentric = max(float(np.radians(readings.eccentricity_deg)), 1e-9)
    gimbal = [expected.says(rows.GIMBAL_AXES, {name: 1.0}, (0.0, 1.0)) for name in (*MOUNTING, *STANDING)]
    gimbal.append(expected.says(ORTHOGONAL, {NON_ORTHOGONALITY: 1.0}, (0.0, square), 0.1))
    for name in layout.names_of(GimbalErrors):
        if name in SCALES:
            what = SCALE_OF.format(name.removeprefix("scale_"))
            gimbal.append(station.says(what, {name: 1.0}, scale, FREE_SCALE, "1"))
        elif name.startswith("eccentricity"):
            gimbal.append(station.says(rows.GIMBAL_SCALE, {name: 1.0}, (0.0, eccentric)))
    return gimbal


def term_shapes(terms: Sequence[TypeBTerm], basis: FieldBasis) -> dict[str, Array]:
    """Return by name the field of a unit of each type B term; zero for those of a certificate's radius.

    A scale moves a star along its position vector. A bow of height z at h moves it by -z h, seen from the centre.
    """
    x, y, r = basis.reference
    shapes = {}
    for term in terms:
        if term.kind in SCALE_TERMS:
            shapes[term.name] = basis.shape(partial(np.add, np.array([x, y]) / r))
        elif term.kind == "print_bow":
            assert term.radius_mm is not None
            height = (r / term.radius_mm) ** 2 / r
            shapes[term.name] = -height * basis.radial[:, 0]
        elif term.kind in RADII:
            shapes[term.name] = basis.shape(np.zeros_like)
    return shapes


def wavefront(terms: Sequence[TypeBTerm]) -> float:
    """Return the RMS slope of the wavefront that a station states, rad; 0 if it states none."""
    squares = [term.standard_uncertainty**2 for term in terms if term.kind == "wavefront"]
    return 1e-6 * float(np.sqrt(sum(squares)))
