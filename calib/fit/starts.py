"""Starting values of a fit, and its bundle without aberrations.

`calib.adjustment.initialization` compares starts; this module says which ones a model has.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.adjustment.bundle import Bundle
from calib.adjustment.initialization import best_start, passport_starts, planar_starts, spherical_starts
from calib.adjustment.observations import Observations
from calib.adjustment.parameters import AdjustmentParameters
from calib.calibration import CalibrationOptions
from calib.model.camera import PINHOLE
from calib.model.collimator import CENTRE
from calib.model.homography import view_homography
from calib.view import View


def initialize(
    views: Sequence[View],
    options: CalibrationOptions,
    model: str,
) -> tuple[Bundle, AdjustmentParameters]:
    """Return the bundle of the ideal model, without aberrations, and its starting values.

    model: ``planar`` frees the centre of each view; in ``spherical`` they share one.
    Raises DegenerateViews: If no start leads to a real camera.
    """
    size, distortion = views[0].image_size, tuple(options.distortion)
    held = options.passport.names if options.passport else ()
    centre = [] if model == "planar" else [name for name in CENTRE if name not in held]
    observations = Observations.from_views(views)
    bundle = Bundle(observations, (*PINHOLE, *distortion, *centre), free_centres=model == "planar")
    h = np.array([view_homography(view) for view in views])
    if options.passport:
        starts = list(passport_starts(h, size, distortion, options.passport))
    elif model == "planar":
        starts = list(planar_starts(h, size, distortion))
    else:
        starts = list(spherical_starts(h, size, distortion))
    return bundle, best_start(bundle, starts)
