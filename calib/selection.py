"""Which model the data support: each candidate predicts views it has not seen.

Knows fitted calibrations and how to leave a view out. The reprojection error cannot choose: a richer model always
has the smaller one. A camera is asked for directions, so the test is: with camera and centre held, how well
does a rotation alone explain a view that had no part in the calibration?
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calib.bundle import Bundle, Observations, State
from calib.calibration import Calibration, CalibrationOptions, Candidate
from calib.collimator import Collimator
from calib.errors import CalibrationError, DegenerateViews
from calib.fit import Motion, bundle_of, fit, refine_robustly
from calib.refine import Loss, refine
from calib.view import View

Array = NDArray[np.float64]

MODELS: tuple[Motion, ...] = ("spherical", "planar")
#: Leaving one view out must leave enough to calibrate with.
_MIN_VIEWS = 3


def choose(views: Sequence[View], options: CalibrationOptions) -> Calibration:
    """Fit every model and return the one that best predicts views left out.

    With two views nothing can be left out; the spherical model is taken.

    Raises
    ------
    CalibrationError
        When no model can be fitted: the first one's reason.
    """
    fitted: list[tuple[Calibration, Candidate]] = []
    errors: list[CalibrationError] = []
    for model in MODELS:
        try:
            calibration = fit(views, options, model)
        except CalibrationError as error:
            errors.append(error)
            continue
        unseen = left_out_rms_px(views, calibration, options) if len(views) >= _MIN_VIEWS else None
        fitted.append((calibration, _candidate(calibration, unseen)))
    if not fitted:
        raise errors[0]
    best, chosen = min(fitted, key=lambda pair: _never_if_none(pair[1].left_out_rms_px))
    others = tuple(candidate for _, candidate in fitted)
    if chosen.left_out_rms_px is None:
        note = f"Two views cannot choose between models; the {chosen.model} one was taken."
    else:
        missed = f"{chosen.left_out_rms_px:.3f} px rms"
        note = f"The {chosen.model} model was chosen: it predicts a view left out to {missed}."
    return replace(best, candidates=others, notes=(*best.notes, note))


def left_out_rms_px(views: Sequence[View], calibration: Calibration, options: CalibrationOptions) -> float:
    """Return the rms residual, px, of each view predicted by a calibration from all the others.

    Camera and centre (the planar model's: the mean of its centres) come from the others, the rotation from the
    view itself.

    Raises
    ------
    DegenerateViews
        With fewer than 3 views.
    """
    if len(views) < _MIN_VIEWS:
        raise DegenerateViews(f"{len(views)} views; leaving one out takes at least {_MIN_VIEWS}.")
    squares, count = 0.0, 0
    for i, view in enumerate(views):
        others = [j for j in range(len(views)) if j != i]
        state = _without(calibration, others)
        bundle = bundle_of([views[j] for j in others], options, calibration.model)
        refined, _ = refine_robustly(bundle, state, options)
        squares += _squares_alone(view, refined.state, calibration.rotations[i])
        count += len(view)
    return float(np.sqrt(squares / count))


def _without(calibration: Calibration, kept: list[int]) -> State:
    """Return the calibration's state with the kept views only."""
    collimator = calibration.collimator or Collimator(0.0, 0.0, 0.0)
    centres = calibration.centres[kept] - collimator.centre
    return State(calibration.camera, collimator, calibration.rotations[kept], centres)


def _squares_alone(view: View, state: State, rotation: Array) -> float:
    """Return the sum of squared residuals, px^2, of a view of which only the rotation is solved."""
    x, y, z = state.centres.mean(axis=0)
    collimator = Collimator(float(x), float(y), float(-z))
    alone = Bundle(Observations.from_views([view]), ())
    start = State(state.camera, collimator, rotation[None], np.zeros((1, 3)))
    return float((alone.misses_px(refine(alone, start, Loss("l2")).state) ** 2).sum())


def _never_if_none(value: float | None) -> float:
    """Return a number that loses every comparison in place of none."""
    return np.inf if value is None else value


def _candidate(calibration: Calibration, missed: float | None) -> Candidate:
    """Summarise a fitted model; BIC with each residual component as one Gaussian measurement."""
    measurements = 2 * sum(view.n for view in calibration.views)
    parameters = measurements - calibration.degrees_of_freedom
    mean_square = calibration.rms_px**2 / 2.0
    bic = measurements * np.log(mean_square) + parameters * np.log(measurements)
    return Candidate(calibration.model, parameters, calibration.rms_px, missed, float(bic))
