"""The posterior as a `Calibration`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.adjustment.parameters import AdjustmentParameters
from calib.arrays import Array, Bools
from calib.calibration import Calibration, CalibrationOptions, ViewSummary, rms_and_mean
from calib.diagnosis.gross_stars import GrossStars, used_stars
from calib.model.camera import CameraModel
from calib.model.cause import PARALLAX
from calib.model.collimator import Collimator
from calib.model.gimbal import MOUNTING, NON_ORTHOGONALITY, STANDING, Gimbal
from calib.model.passport import Passport
from calib.model.result_parts import WORST_CORNER, Amplitude, Boresight, GimbalEstimate
from calib.model.rotation import log_map, skew
from calib.progress import begin
from calib.view import View

from . import amplitudes as amp
from .adjust import adjusted
from .budget import budget_rows, row_gradients, variances
from .causes import find_causes
from .explanations import explanations, unbounded, without_bound
from .fields import FIELD_RADIUS
from .gimbal import ENCODER
from .knowledge import FREE_SCALE
from .left_out import left_out_rms, rotation_errors
from .mixture import Mixture, Stated, stated
from .posterior import Posterior
from .problem import Stars, State
from .pupils import Pupil
from .search import Optimum, followed
from .shapes import CENTRE, FIELD, RADIAL
from .unsteady_focus import spread_of, unsteady_focus
from .weights import precisions, robust_weights
from .witnesses import fault_probabilities, witnesses
from .words import lens_note, notes, require_determined, require_own_certificate
from .wrong_views import ShiftedIds, find_other_origins, find_shifted_ids

#: Amplitudes that are given in microradians of a direction; all others are factors or coefficients.
_DIRECTIONS = (*amp.POSE, *amp.COMMON, *amp.TURN, *amp.TURN_2, amp.CHANGE)
#: Readings that scatter this many times more than stated contradict the stars, and do not enter.
_MOST_SCATTER = 3.0
#: Nor if a scale differs by this many times what a wrong statement is expected to.
_FARTHEST_SCALE = 3.0
#: A mounting with a larger 1-sigma is not determined, rad: one axis alone leaves a turn free.
_UNDETERMINED = 0.05


@dataclass(frozen=True)
class _Answer:
    """The mixture, and rotations and gimbal that belong to its mean."""

    mixture: Mixture
    state: State  # Of the first explanation, at its mean
    better_lens: str

    @classmethod
    def of(cls, mixture: Mixture, better_lens: str) -> _Answer:
        """Return a mixture, and the state at its mean: rotations and own fields follow."""
        first = mixture.first
        largest = first.largest.solution
        q = largest.equations
        step = first.mean - q.state.b
        local = largest.local - largest.follow @ (step - largest.step)
        state = q.state.moved(step, local[:, : q.own_size], q.turns(local))
        return cls(mixture, followed(state, largest), better_lens)

    @property
    def posterior(self) -> Posterior:
        """The first explanation."""
        return self.mixture.first

    @property
    def gimbal(self) -> Gimbal | None:
        """The gimbal, with its scales."""
        readings = self.posterior.problem.readings
        if readings is None:
            return None
        g = self.state.b[readings.at]
        values = dict(zip((error.name for error in readings.errors), g[7:].tolist(), strict=True))
        scales = [1.0 + values.get(f"scale_{axis}", 0.0) for axis in ("pan", "tilt", "roll")]
        return replace(readings.gimbal(g), scales=(scales[0], scales[1], scales[2]))

    def parameters(self) -> AdjustmentParameters:
        """Return camera, centre and rotations."""
        named = dict(zip(self.mixture.names, self.mixture.mean.tolist(), strict=True))
        radial = {name: named[name] for name in RADIAL}
        reference = self.posterior.problem.fields.reference
        centre = Collimator(named["x"], named["y"], named["r"], radial, reference)
        rotations = self.state.rotations
        return AdjustmentParameters(
            self.mixture.camera, centre, rotations, np.zeros((len(rotations), 3)), self.gimbal
        )


def calibrate_jointly(
    views: Sequence[View], options: CalibrationOptions, wrong: Sequence[GrossStars]
) -> Calibration:
    """Return the result; wrong stars take no part, nor do readings of the gimbal that contradict the stars."""
    begin()
    used = used_stars(views, options.guard_band, wrong)
    kept = [view if own.all() else view.part(own) for view, own in zip(views, used, strict=True)]
    answer, stated_by = _Answer.of(*explanations(kept, options)), options
    shifted = _shifted_ids(answer, kept, options)
    gimbal = _gimbal(answer, options)
    if gimbal is not None:
        doubted = without_bound(answer.mixture, kept, options, shifted.worth)
        if doubted is not answer.mixture:
            answer = _Answer.of(doubted, answer.better_lens)
            shifted = _shifted_ids(answer, kept, options)
            gimbal = _gimbal(answer, options)
    if gimbal is not None and not gimbal.entered:
        options = replace(options, gimbal=None)
        answer = _Answer.of(*explanations(kept, options))
        shifted = shifted if shifted.words else _shifted_ids(answer, kept, options)
    known = options.passport is not None
    doubt = (
        lens_note(answer.better_lens) or shifted.words
    )  # a lens of another family looks like shifted ids, too
    require_own_certificate(answer.mixture, shifted.words)
    require_determined(answer.mixture, kept, answer.parameters(), known=known, doubt=doubt)
    focus = None if shifted.words else unsteady_focus(answer.posterior, kept)
    answer = replace(answer, mixture=replace(answer.mixture, unsteady=spread_of(focus)))
    result = _calibration(answer, views, used, gimbal)
    causes = () if shifted.words else find_causes(result, answer.posterior, focus, stated_by)
    result = replace(result, causes=causes)
    other = "" if shifted.words else find_other_origins(answer.posterior.optimum, kept)
    wrongs = filter(None, (shifted.words, other))
    return replace(result, notes=(*wrongs, *notes(result, answer.mixture, answer.better_lens)))


def _shifted_ids(answer: _Answer, views: Sequence[View], options: CalibrationOptions) -> ShiftedIds:
    """Return the views whose ids are shifted, if the pupil is moved as the first explanation has it."""
    optimum = answer.posterior.optimum
    problem = optimum.solution.problem
    same = options if problem.moved.pupil is Pupil.HELD else unbounded(options)

    def again(moved: Sequence[View]) -> Optimum:
        return adjusted(moved, same, problem.moved.pupil, problem.camera.lens)[0].optimum

    return find_shifted_ids(optimum, views, options.max_iterations, again)


def _calibration(
    answer: _Answer, views: Sequence[View], used: Sequence[Bools], gimbal: GimbalEstimate | None
) -> Calibration:
    posterior, mixture, parameters = answer.posterior, answer.mixture, answer.parameters()
    result, largest = stated(mixture), posterior.largest.solution
    star = float(np.exp(largest.eta[posterior.problem.star]))
    residuals, weights = _residuals(answer, views, used, star)
    lengths = [np.linalg.norm(e[own], axis=1) for e, own in zip(residuals, used, strict=True)]
    rms_px, mean_px = rms_and_mean(np.concatenate(lengths))
    errors, gradients = rotation_errors(posterior), row_gradients(mixture)
    parts = variances(mixture, np.concatenate([result.rows, gradients]))
    count = len(result.names)
    faults: dict[str, float] = {}
    for part in mixture.parts:
        for name, probability in fault_probabilities(part.posterior).items():
            faults[name] = faults.get(name, 0.0) + part.share * probability
    if mixture.no_bound:
        faults[PARALLAX] = max(faults.get(PARALLAX, 0.0), mixture.no_bound)
    return Calibration(
        model="joint",
        camera=result.camera,
        collimator=parameters.collimator,
        rotations=parameters.rotations,
        centres=parameters.centres,
        parameter_names=result.names,
        estimates=result.estimates,
        covariance=result.covariance,
        residuals_px=residuals,
        weights=weights,
        rms_px=rms_px,
        mean_px=mean_px,
        variance_factor=star**2,
        degrees_of_freedom=max(round(largest.equations.observed - largest.determined), 1),
        views=tuple(
            ViewSummary(view.name, len(own), *rms_and_mean(own))
            for view, own in zip(views, lengths, strict=True)
        ),
        converged=posterior.optimum.converged,
        iterations=posterior.optimum.rounds,
        birge_ratio=_disagreement(posterior),
        coverage_factor=result.coverage_factors["fx"],
        left_out_rms_px=left_out_rms(largest),
        rotation_covariance=errors.joint_covariance,
        rotation_errors=errors,
        budget={group: _contributions(result, part[:count]) for group, part in parts.items()},
        gimbal=gimbal,
        boresight=_boresight(answer, parameters.camera),
        poses=tuple(posterior.problem.poses.tolist()),
        budget_rows=budget_rows(mixture, gradients, {group: part[count:] for group, part in parts.items()}),
        witnesses=witnesses(posterior, faults),
        amplitudes=_amplitudes(posterior),
        coverage_factors={**result.coverage_factors, WORST_CORNER: _corner_factor(mixture, gradients[-1])},
        glass=_glass(answer, views),
    )


def _corner_factor(mixture: Mixture, gradient: Array) -> float:
    """Return U over sigma of the worst corner, by its (Q,) gradient."""
    return mixture.expanded(gradient) / float(np.sqrt(gradient @ mixture.covariance @ gradient))


def _contributions(result: Stated, part: Array) -> dict[str, float]:
    """Return by name the 1-sigma contributions of a group, from its variances."""
    return dict(zip(result.names, np.sqrt(np.maximum(part, 0.0)).tolist(), strict=True))


def _disagreement(posterior: Posterior) -> float:
    """Return how many times more than star noise the poses differ: 1 without own fields (Birge, 1932)."""
    solution = posterior.largest.solution
    q, f = solution.equations, solution.equations.own_size
    alone = q.local[1]
    turns = alone[:, f:, f:] + np.eye(q.local_size - f) * q.empty[:, None, f:]
    own = alone[:, :f, :f] - alone[:, :f, f:] @ np.linalg.solve(turns, alone[:, f:, :f])
    fields = q.state.own + solution.local[:, :f]
    explained = float(np.einsum("nf,nfg,ng->", fields, own, fields))
    return float(np.sqrt(1.0 + solution.prior.star * explained / fields.size))


def _residuals(
    answer: _Answer, views: Sequence[View], used: Sequence[Bools], star: float
) -> tuple[list[Array], list[Array]]:
    """Return the residuals of all stars at the mean, and their weights; 0 for stars that were not used."""
    problem = answer.posterior.problem
    stars = []
    for view, known, own in zip(views, problem.stars, used, strict=True):
        rho = np.ones(len(view))
        rho[own] = known.rho
        stars.append(Stars.of(view, problem.fields, rho, known.disc))
    whole = replace(problem, stars=tuple(stars), readings=None)
    residuals, weights = whole.residuals(answer.state), []
    equations = answer.posterior.largest.solution.equations
    for length, precision, own in zip(
        whole.lengths(answer.state), precisions(stars, equations.weights), used, strict=True
    ):
        weights.append(
            own * precision * robust_weights(np.sqrt(precision) * np.nan_to_num(length, nan=np.inf), star)
        )
    return residuals, weights


def _amplitudes(posterior: Posterior) -> tuple[Amplitude, ...]:
    """Return the sizes of the errors; fields as directions."""
    expected, eta, answer = posterior.problem.expected, posterior.optimum.solution.eta, list[Amplitude]()
    for name, value, spread, middle in zip(expected.names, eta, posterior.spread, expected.mean, strict=True):
        unit, times = ("urad", 1e6) if name in _DIRECTIONS else ("1", 1.0)
        median = times * float(np.exp(middle))
        answer.append(Amplitude(name, times * float(np.exp(value)), float(spread), unit, median))
    return tuple(answer)


def _glass(answer: _Answer, views: Sequence[View]) -> Passport:
    """Return what was found out about the collimator: centre, radial terms, common field, jointly."""
    mixture, fields = answer.mixture, answer.posterior.problem.fields
    names = tuple(name for name in mixture.names if name in (*CENTRE, *RADIAL) or name.startswith(FIELD))
    at = mixture.places(names)
    return Passport(
        names,
        mixture.mean[at],
        mixture.covariance[np.ix_(at, at)],
        fields.reference,
        _disagreement(answer.posterior),
        tuple(view.name for view in views),
        {FIELD_RADIUS: fields.radius_mm},
    )


def _gimbal(answer: _Answer, options: CalibrationOptions) -> GimbalEstimate | None:
    """Return the gimbal's parameters and how its readings agree; None without readings."""
    posterior, gimbal = answer.posterior, answer.gimbal
    readings = posterior.problem.readings
    if readings is None or gimbal is None or options.gimbal is None:
        return None
    turns = log_map(np.array([gimbal.camera_from_head, gimbal.base_from_target])).reshape(-1)
    at, mean = readings.at, posterior.mean[readings.at]
    names = [*MOUNTING, *STANDING, NON_ORTHOGONALITY, *(error.name for error in readings.errors)]
    values = dict(zip(names, [*turns, *mean[6:]], strict=True))
    values |= {name: 1.0 + value for name, value in values.items() if name.startswith("scale_")}
    sigmas = dict(zip(names, np.sqrt(np.diag(posterior.covariance)[at]), strict=True))
    times = float(np.exp(posterior.largest.solution.eta[posterior.problem.reading]))
    off_scale = max((abs(values[name] - 1.0) for name in names if name.startswith("scale_")), default=0.0)
    farthest = _FARTHEST_SCALE * max(options.gimbal.scale_sigma, FREE_SCALE)
    entered = bool(times < _MOST_SCATTER and off_scale < farthest)
    off = readings.off(answer.state.b[at], answer.state.rotations)
    unit = {name: 1.0 if name.startswith("scale_") else float(np.rad2deg(1.0)) for name in names}
    told = [name for name in names if entered and not name.startswith(ENCODER)]
    return GimbalEstimate(
        entered=entered,
        values={name: unit[name] * float(values[name]) for name in told},
        sigma={name: unit[name] * float(sigmas[name]) for name in told},
        chi_square=float((off**2).sum()) / readings.sigma_rad**2,
        degrees_of_freedom=max(off.size - 6, 1),
        rms_deg=float(np.rad2deg(np.sqrt((off**2).sum(axis=1).mean()))),
        reading_sigma_deg=times * options.gimbal.reading_sigma_deg,
        scatter=times,
        source=options.gimbal.source,
    )


def _boresight(answer: _Answer, camera: CameraModel) -> Boresight | None:
    """Return how the camera is mounted on the stage, jointly with its principal point.

    None if no readings determine it, or if the camera would look backwards: an axis has the wrong sign.
    """
    posterior, gimbal = answer.posterior, answer.gimbal
    readings = posterior.problem.readings
    if gimbal is None or readings is None:
        return None
    at = readings.at[:3]
    covariance = posterior.covariance[np.ix_(at, at)]
    rotation = gimbal.camera_from_head
    if np.linalg.eigvalsh(covariance)[-1] > _UNDETERMINED**2 or rotation[2, 2] < 0.0:
        return None
    unit, depth = np.eye(len(posterior.mean)), posterior.problem.depth
    middle = (np.array([camera.image_size]) - 1.0) / 2.0
    ray = camera.rays(middle)[0]
    _, by_ray, by_parameters = camera.project_with_jacobians(ray[None])
    by_camera = posterior.problem.camera.by_unknowns(posterior.mean[:depth]) @ unit[:depth]
    moved = skew(ray[None])[0] @ unit[at] - np.linalg.pinv(by_ray[0]) @ by_parameters[0] @ by_camera
    across = np.cross([0.0, 1.0, 0.0], ray)
    across /= np.linalg.norm(across)
    rows = np.stack([across, np.cross(ray, across)]) @ moved
    return Boresight(
        rotation,
        covariance,
        np.degrees([posterior.expanded(row) for row in unit[at]]),
        rotation.T @ ray,
        rows @ posterior.covariance @ rows.T,
        np.degrees([posterior.expanded(row) for row in rows]),
    )
