"""Views of a flat board at finite distance, which the model of a collimator cannot explain: told before a long fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

from scipy.special import fdtrc

from calib.adjustment.bundle import RADIAL_TERM
from calib.adjustment.initialization import initialized, with_distorted_glass
from calib.adjustment.levenberg_marquardt import refine
from calib.adjustment.loss import Loss
from calib.errors import DegenerateViews
from calib.view import View

_LENS: Final = ("k1", "k2", "p1", "p2")
#: Stars of a view that are compared, and the steps of a comparison: the starts are near the end already.
_STARS, _STEPS, _TOLERANCE = 40, 40, 1e-8
#: Numbers that a homography states, those of a pose by turns and by places, and those of a pinhole camera.
_OF_HOMOGRAPHY, _OF_TURN, _OF_PLACE, _OF_CAMERA = 8, 3, 6, 4
#: Chance of an F as large as this among views through a collimator, as the prior odds of other hypotheses.
_LEVEL = 1e-3


def require_turns(views: Sequence[View]) -> None:
    """Refuse (`DegenerateViews`) views that places of the camera explain, and turns about one point do not.

    Through a collimator all views have one centre (arXiv:2512.16092, eq. 3); a centre for each view is the planar
    model, which contains the other. The F-test of both takes the sums of squares of short adjustments; what the places
    leave counts as if it were in the homographies alone, so that errors of glass and lens, which are alike for
    neighbouring stars, are not taken for many independent ones.
    """
    n = len(views)
    freed, left = (_OF_PLACE - _OF_TURN) * (n - 1), (_OF_HOMOGRAPHY - _OF_PLACE) * n - _OF_CAMERA
    if left < 1:
        return
    turns, places = _misfit(views, planar=False), _misfit(views, planar=True)
    ratio = (turns / places - 1.0) * left / freed
    if ratio > 0 and fdtrc(freed, left, ratio) < _LEVEL:
        raise DegenerateViews(
            "These are views of a flat board at a finite distance: places of the camera explain them"
            f" {(turns / places) ** 0.5:.3g} times better than turns in a collimator do.",
            remedy='Use the planar model: --model planar, or CalibrationOptions(model="planar").',
        )


def _misfit(views: Sequence[View], *, planar: bool) -> float:
    """Return the weighted sum of squares that is left of some stars of each view."""
    bundle, start = initialized(views, _LENS, None, planar=planar)
    bundle = bundle.thinned(_STARS)
    if not planar:
        start = with_distorted_glass(bundle, start)
        if start.collimator.aberrations:
            bundle = replace(bundle, names=(*bundle.names, RADIAL_TERM))
    return refine(bundle, start, Loss("l2"), _STEPS, _TOLERANCE).cost
