"""The adjustment that a calibration will do, set up from predicted views.

Each pose contributes information on the shared parameters, and noise of its score: star noise, readings of the gimbal,
and the errors of the collimator, which differ from pose to pose. Both add up over the poses. Errors of the collimator
that all views share change the scores of all poses together.
`calib.studies.expected_uncertainty` turns the sums into uncertainties.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib.adjustment.bundle import Bundle
from calib.adjustment.collimator_terms import add_terms
from calib.adjustment.gimbal_observations import GimbalObservations
from calib.adjustment.observations import Observations
from calib.adjustment.parameters import AdjustmentParameters
from calib.adjustment.readings import add_readings
from calib.fit import WITHOUT_READINGS
from calib.fit.readings import MAX_READING_SCATTER
from calib.model.aberrations import LADDER
from calib.model.beam import Disc
from calib.model.collimator import CENTRE, Collimator
from calib.model.gimbal import Gimbal
from calib.model.gimbal_readings import GimbalReadings
from calib.model.passport import Passport
from calib.studies.collimator_errors import COMMON_DEGREES, COMMON_SPECTRUM, KEYSTONE_PER_PUPIL, SPECTRUM
from calib.studies.predicted_views import ExpectedBench
from calib.uncertainty.passport_propagation import certificate_prior
from calib.uncertainty.variance_components import basis_fields
from calib.view import View

Array = NDArray[np.float64]
Angles = Mapping[str, float]


@dataclass(frozen=True)
class PoseShare:
    """What a pose contributes to the adjustment, with its rotation eliminated."""

    information: Array  # (G, G) float64 information on the shared parameters, those of a passport included
    noise: Array  # (G, G) float64 covariance of the score by star noise and readings
    coupling: Array  # (G, F) float64 change of the score by the coefficients of the collimator's fields
    variances: Array  # (F,) float64 expected variance of each coefficient, mm^2
    # (G, C) float64 change of the score by the coefficients of the fields that all views share.
    common: Array

    @property
    def field_noise(self) -> Array:
        """(G, G) float64 covariance of the score by the collimator's fields."""
        return np.asarray((self.coupling * self.variances) @ self.coupling.T)


class _SingleReadings(GimbalObservations):
    """Readings of poses of which only some will be recorded: no reading counts as a repeat of another one."""

    def information(self, gimbal: Gimbal) -> Array:
        """See `GimbalObservations.information`."""
        axes = gimbal.axes(self.angles_deg)
        return np.asarray(np.linalg.inv(self.sigma_rad**2 * axes @ np.swapaxes(axes, 1, 2)))


class ExpectedFit:
    """The expected adjustment of predicted views.

    rotations: (n, 3, 3) rotations of the views, camera <- target.
    angles_deg: Angles of the gimbal for each view, degrees; needed if the bench has readings.
    growth: How many times less the stars weigh against readings and priors than their residuals suggest
      (`calib.studies.expected_uncertainty.expected_fit`).
    candidates: Whether the poses are candidates, of which only some will be recorded. Poses that repeat a
      reading of an axis then count as if each had a reading error of its own.
    passport: Passport of the collimator, if one holds parameters.
    certificate: Certificate of the radius, if it is a prior of the parameter r, because readings enter too.
    common_variances: (C,) float64 expected variance of each coefficient of the fields that all views share,
      mm^2; empty for an ideal collimator, for views with a centre each, and for candidates.
    """

    def __init__(
        self,
        bench: ExpectedBench,
        views: Sequence[View],
        rotations: Array,
        angles_deg: Sequence[Angles] = (),
        growth: float = 1.0,
        *,
        candidates: bool = False,
    ) -> None:
        self._bench, self.growth = bench, growth
        self._field_px = bench.errors.field_px(bench.star_sigma_px)
        self._spread_px = growth * float(np.hypot(bench.star_sigma_px, self._field_px))
        model = model_to_expect(bench)
        own = np.eye(2) * self._spread_px**2
        weighted = [replace(view, covariances_px2=np.tile(own, (len(view), 1, 1))) for view in views]
        held = bench.passport.names if bench.passport else ()
        free = tuple(name for name in CENTRE if name not in held and model != "planar")
        bundle = Bundle(
            Observations.from_views(weighted),
            (*bench.camera.parameter_names, *free),
            free_centres=model in WITHOUT_READINGS,
            drift_mm=bench.drift_mm if model == "drift" else float("inf"),
        )
        centre = bench.collimator
        parameters = AdjustmentParameters(
            bench.camera, Collimator(centre.x, centre.y, centre.r), rotations, np.zeros((len(views), 3))
        )
        terms = tuple(name for name in LADDER.get(model, ()) if name not in held)
        discs = self._discs(rotations)
        if terms or (bench.passport and bench.passport.terms):
            bundle, parameters = add_terms(
                weighted, discs, bundle, parameters, terms, bench.passport, bench.radial_sigma
            )
        readings = entering_readings(bench)
        certificate = weighed_certificate(bench)
        if readings is not None:
            readings = replace(readings, angles_deg=tuple(dict(one) for one in angles_deg))
            radius = certificate_prior(certificate, bench.terms) if certificate else None
            bundle, parameters = add_readings(weighted, discs, bundle, parameters, readings, radius)
        if candidates and bundle.gimbal is not None:
            bundle = replace(
                bundle, gimbal=_SingleReadings(bundle.gimbal.angles_deg, bundle.gimbal.sigma_rad)
            )
        self.bundle, self.parameters = bundle, parameters
        self.certificate = certificate
        self.passport = None if certificate else bench.passport
        self.names = (*bundle.names, *(self.passport.names if self.passport else ()))
        self._common, self.common_variances = self._common_fields(candidates=candidates)
        self.shares = tuple(self._shares())

    @property
    def prior_information(self) -> Array:
        """(G, G) float64 prior information on the parameters; zero for those that the passport holds."""
        return np.pad(self.bundle.prior_information, (0, len(self.names) - len(self.bundle.names)))

    def _discs(self, rotations: Array) -> list[Disc]:
        """Return the disc of each view: it follows the pupil across the beam."""
        centre, errors = self._bench.collimator, self._bench.errors
        radius = centre.r * np.tan(np.deg2rad(self._bench.half_angle_deg))
        places = np.array([centre.x, centre.y]) + errors.pupil_off_pivot_mm * _turns(rotations)
        return [Disc(place, float(radius), 0.0) for place in places]

    def _shares(self) -> Iterator[PoseShare]:
        """Yield the contribution of each view.

        Local parameters are eliminated by the Schur complement (Triggs et al., 2000, section 6.1).
        """
        whole = replace(self.bundle, names=self.names)
        moving = replace(self.bundle, names=("x", "y"), prior=None, free_centres=False, gimbal=None)
        readings = whole.reading_equations(self.parameters)
        count = len(self.names)
        known = count + (6 if whole.free_centres else 3)
        share = (self._bench.star_sigma_px / self._spread_px) ** 2
        for i, (jacobian, moves) in enumerate(
            zip(whole.jacobians(self.parameters), moving.jacobians(self.parameters), strict=True)
        ):
            own_fields, variances = self._fields(i)
            common = known + len(variances)
            fields = np.concatenate([own_fields, self._common[self.bundle.observations.slices[i]]], axis=2)
            by_field = -np.einsum("aim,maf->fim", moves[:2], fields)
            columns = (
                np.concatenate([jacobian, by_field]).reshape(common + len(self.common_variances), -1)
                / self._spread_px
            )
            normal = columns @ columns.T
            besides = np.zeros_like(normal)
            if readings is not None:
                besides[:known, :known] += readings[0][i]
            besides[count:known, count:known] += self.bundle.local_prior_information
            normal += besides
            rest = [*range(count), *range(known, len(normal))]
            turned = -np.linalg.solve(normal[count:known, count:known], normal[count:known, rest])
            reduced = normal[np.ix_(rest, rest)] + normal[rest, count:known] @ turned
            lift = np.vstack([np.eye(count), turned[:, :count]])
            extra = lift.T @ besides[:known, :known] @ lift
            information = reduced[:count, :count]
            own = count + len(variances)
            yield PoseShare(
                information,
                share * information + (1.0 - share) * extra,
                reduced[:count, count:own],
                variances,
                reduced[:count, own:],
            )

    def _fields(self, view: int) -> tuple[Array, Array]:
        """Return the fields (m, 2, F) of a view, and the variances (F,) of their coefficients, mm^2."""
        if self._field_px == 0.0:
            stars = self.bundle.observations.slices[view]
            return np.zeros((stars.stop - stars.start, 2, 0)), np.zeros(0)
        centre, obs = self._bench.collimator, self.bundle.observations
        (smooth,), group = basis_fields(self.bundle, [view], None)
        field_mm = self._field_px * centre.r / self._bench.camera.fx
        h = (obs.target[obs.slices[view], :2] - centre.centre[:2]) / centre.r
        keystone = h[:, :, None] * h[:, None, :]
        pupil_mm = self._bench.errors.pupil_mm(_turns(self.parameters.rotations))
        sizes = [*(field_mm * np.array(SPECTRUM)[group]), *(KEYSTONE_PER_PUPIL * pupil_mm)]
        return np.concatenate([smooth, keystone], axis=2), np.square(sizes)

    def _common_fields(self, *, candidates: bool) -> tuple[Array, Array]:
        """Return the fields (N, 2, C) that all views share, and the variances (C,) of their coefficients, mm^2.

        They are those of `calib.uncertainty.common_errors`: polynomials along each axis, of unit mean square and
        orthogonal over all stars. Shifts are left out: they move the centre and nothing else.
        """
        target_mm = self.bundle.observations.target[:, :2]
        if self._field_px == 0.0 or self.bundle.free_centres or candidates:
            return np.zeros((len(target_mm), 2, 0)), np.zeros(0)
        away = target_mm - target_mm.mean(axis=0)
        away /= np.linalg.norm(away, axis=1).max()
        powers = [(degree - j, j) for degree in range(COMMON_DEGREES + 1) for j in range(degree + 1)]
        values = np.array([away[:, 0] ** i * away[:, 1] ** j for i, j in powers]).T
        smooth = np.linalg.qr(values)[0][:, 1:] * np.sqrt(len(away))
        still = np.zeros_like(smooth)
        fields = np.concatenate(
            [np.stack([smooth, still], axis=1), np.stack([still, smooth], axis=1)], axis=2
        )
        field_mm = self._field_px * self._bench.collimator.r / self._bench.camera.fx
        sizes = [field_mm * COMMON_SPECTRUM[i + j - 1] for i, j in powers[1:]]
        return fields, np.square([*sizes, *sizes])


def model_to_expect(bench: ExpectedBench) -> str:
    """Return the model that a calibration on a bench will fit, as far as that is known beforehand.

    Returns: ``radial`` if the data choose the model: this model needs no rim, and the engine keeps it where
      it could choose the spherical one.
    """
    return "radial" if bench.model == "auto" else bench.model


def entering_readings(bench: ExpectedBench) -> GimbalReadings | None:
    """Return the readings of the gimbal with the uncertainty that they will have in the adjustment.

    Readings that scatter more than stated get less weight, and do not enter beyond
    `calib.fit.readings.MAX_READING_SCATTER` times. The pupil that wanders across the beam of a collimator out of focus
    turns the pattern as seen by the camera.

    Returns: None if readings do not enter: nothing bounds their parallax, or they will scatter too much.
    """
    stated = bench.readings
    if stated is None or stated.parallax is None or model_to_expect(bench) in WITHOUT_READINGS:
        return None
    scatter = reading_scatter(bench)
    if scatter > MAX_READING_SCATTER:
        return None
    return replace(stated, reading_sigma_deg=scatter * stated.reading_sigma_deg)


def weighed_certificate(bench: ExpectedBench) -> Passport | None:
    """Return the certificate if readings enter too: the radius is then a parameter with the certificate as its prior.

    Returns: None if there is no certificate, or if it holds the radius because readings do not enter.
    """
    passport = bench.passport
    if passport is None or not passport.is_certificate or entering_readings(bench) is None:
        return None
    return passport


def reading_scatter(bench: ExpectedBench) -> float:
    """Return how many times more than stated the readings of the gimbal will scatter about the stars.

    Returns: At least 1.
    """
    assert bench.readings is not None
    moved_rad = bench.errors.defocus * bench.errors.pupil_wander_mm / bench.collimator.r
    return float(np.hypot(1.0, np.rad2deg(moved_rad) / bench.readings.reading_sigma_deg))


def _turns(rotations: Array) -> Array:
    """Return (n, 2) the tangents of the camera's turn along the target's X and Y."""
    axes = rotations[:, 2]
    return np.asarray(axes[:, :2] / axes[:, 2:])
