"""Views of a flat board at finite distance, which the model of a collimator cannot explain: told before a long fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from calib.adjustment.bundle import RADIAL_TERM
from calib.adjustment.initialization import initialized, with_distorted_glass
from calib.adjustment.levenberg_marquardt import Refinement, refine
from calib.adjustment.loss import Loss
from calib.adjustment.parameters import AdjustmentParameters
from calib.errors import DegenerateViews
from calib.view import View

_LENS: Final = ("k1", "k2", "p1", "p2")
#: Stars of a view that are compared, and the steps of a comparison: the starts are near the end already.
_STARS, _STEPS, _TOLERANCE = 40, 40, 1e-8
#: Numbers that a homography states, those of a turn, of a pose with a place of its own, and of a pinhole camera.
_OF_HOMOGRAPHY, _OF_TURN, _OF_PLACE, _OF_CAMERA = 8, 3, 6, 4
#: Chance of an F as large as this among views through a collimator, as the prior odds of the engine's hypotheses.
_LEVEL = 1e-3
#: Residuals smaller than this share of a star's sigma say nothing.
_ROUNDING = 0.01
#: Way of the centre over distance times turn: 0 through a collimator, 1 if the camera looks at one place of a board.
_TURNS, _ORBITS = 0.0, 1.0


def require_turns(views: Sequence[View]) -> None:
    """Refuse (`DegenerateViews`) views that places of the camera explain, and turns about one point do not.

    Through a collimator all views have one centre (arXiv:2512.16092, eq. 3); with a centre for each, the planar model
    contains that one. The F-test compares what both leave after short adjustments. What the places leave is an error of
    glass and lens that all views have in common: it counts as the numbers of one homography, however many the stars.
    Points without errors leave rounding alone.
    """
    from scipy.special import fdtrc  # a plan needs none of scipy

    n = len(views)
    freed = (_OF_PLACE - _OF_TURN) * (n - 1)
    left = min((_OF_HOMOGRAPHY - _OF_PLACE) * n - _OF_CAMERA, _OF_HOMOGRAPHY)
    if left < 1:
        return
    turned, placed = (_adjusted(views, planar=planar) for planar in (False, True))
    rounding = _ROUNDING**2 * 2 * _STARS * n
    share = (turned.cost + rounding) / (placed.cost + rounding)
    if fdtrc(freed, left, max(0.0, (share - 1.0) * left / freed)) < _LEVEL and orbits(placed.parameters):
        raise DegenerateViews(
            "These views show a flat board at a finite distance: the camera was at other places. The residuals of turns"
            f" in a collimator are {share**0.5:.3g} times as large.",
            remedy='Calibrate with the planar model: --model planar, or CalibrationOptions(model="planar").',
        )


def _adjusted(views: Sequence[View], *, planar: bool) -> Refinement[AdjustmentParameters]:
    """Return a short adjustment to some stars of each view: a centre for each, or one and the glass's distortion."""
    bundle, start = initialized(views, _LENS, None, planar=planar)
    bundle = bundle.thinned(_STARS)
    if not planar:
        start = with_distorted_glass(bundle, start)
        if start.collimator.aberrations:
            bundle = replace(bundle, names=(*bundle.names, RADIAL_TERM))
    return refine(bundle, start, Loss("l2"), _STEPS, _TOLERANCE)


def orbits(poses: AdjustmentParameters) -> bool:
    """Tell whether, from view to view, the camera went round the board rather than turned where it was.

    Own rule: its way is over half of distance times turn t, in the median pair; cos t = (trace(R S^T) - 1) / 2.
    """
    first, second = np.triu_indices(len(poses.centres), 1)
    cosines = (np.einsum("nij,nij->n", poses.rotations[first], poses.rotations[second]) - 1.0) / 2.0
    ways = np.linalg.norm(poses.centres[first] - poses.centres[second], axis=1)
    turns = np.abs(poses.centres[:, 2]).mean() * np.arccos(np.clip(cosines, -1.0, 1.0))
    return bool(np.median(ways - (_TURNS + _ORBITS) / 2.0 * turns) > 0)
