"""The calibration engine: arrays in, dataclasses out.

The engine uses no file, device, clock or random source of its own. It imports nothing of bench, drivers, sequences or
simulators. A notebook needs only the names below. Each is loaded at its first use, so ``import calib`` costs nothing.

=====================================================  =============================================================
`flicker_from_triggers`, `flicker_from_events`         flicker of the light in a recording
`make_images`                                          event images from whole flicker periods
`StarTarget`, `detect_view`, `View`                    the printed target; the stars of an image as a view
`calibrate`, `CalibrationOptions`, `Calibration`       joint adjustment of all views, and its result
`CameraModel`, `Collimator`, `Passport`                the parts of a result; a calibrated collimator
`projection_uncertainty`                               uncertainty of directions over the sensor
`ExpectedBench`, `predicted_view`, `forecast`          the stars that poses will show; the expected uncertainty
`CalibrationError`                                     base class of all errors of the engine
=====================================================  =============================================================

References
----------
- arXiv:2512.16092: Liu, Liang et al., Collimator-assisted high-precision calibration method for event cameras.
- Birge (1932), The calculation of errors by the method of least squares, Physical Review 40, 207.
- Olson (2011), AprilTag: a robust and flexible visual fiducial system, ICRA.
- Schöps, Larsson, Pollefeys and Sattler (2020), Why having 10,000 parameters in your camera model is better than
  twelve, CVPR, arXiv:1912.02908.

Examples
--------
A camera is calibrated from three predicted views with 0.02 px of noise on every star:

>>> from dataclasses import replace
>>> import numpy as np
>>> from calib import CameraModel, Collimator, ExpectedBench, StarTarget, calibrate, predicted_view
>>> camera = CameraModel(3345.0, 3345.0, 639.5, 359.5, (1280, 720), {"k1": -0.1, "k2": 0.0})
>>> x_mm, y_mm = StarTarget().tag_centre_mm
>>> bench = ExpectedBench(camera, Collimator(x_mm, y_mm, 255.0), half_angle_deg=12.0)
>>> poses = {"right": {"pan_deg": 3}, "left": {"pan_deg": -3, "tilt_deg": 2}, "down": {"tilt_deg": -2, "roll_deg": 90}}
>>> views = [predicted_view(bench, pose, name)[0] for name, pose in poses.items()]
>>> rng = np.random.default_rng(1)
>>> views = [replace(view, points_px=view.points_px + rng.normal(0.0, 0.02, (len(view), 2))) for view in views]
>>> result = calibrate(views)
>>> abs(result.values["fx"] - camera.fx) < result.U["fx"]
True
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # the names are public, so each is imported as itself
    from calib.calibration import Calibration as Calibration
    from calib.calibration import CalibrationOptions as CalibrationOptions
    from calib.engine import calibrate as calibrate
    from calib.errors import CalibrationError as CalibrationError
    from calib.events.event_image import make_images as make_images
    from calib.events.flicker import flicker_from_events as flicker_from_events
    from calib.events.flicker import flicker_from_triggers as flicker_from_triggers
    from calib.model.camera import CameraModel as CameraModel
    from calib.model.collimator import Collimator as Collimator
    from calib.model.passport import Passport as Passport
    from calib.stars.detect import detect_view as detect_view
    from calib.studies.planning import forecast as forecast
    from calib.studies.predicted_views import ExpectedBench as ExpectedBench
    from calib.studies.predicted_views import predicted_view as predicted_view
    from calib.target import StarTarget as StarTarget
    from calib.uncertainty.projection_uncertainty import projection_uncertainty as projection_uncertainty
    from calib.view import View as View

_MODULES = {
    "Calibration": "calib.calibration",
    "CalibrationError": "calib.errors",
    "CalibrationOptions": "calib.calibration",
    "CameraModel": "calib.model.camera",
    "Collimator": "calib.model.collimator",
    "ExpectedBench": "calib.studies.predicted_views",
    "Passport": "calib.model.passport",
    "StarTarget": "calib.target",
    "View": "calib.view",
    "calibrate": "calib.engine",
    "detect_view": "calib.stars.detect",
    "flicker_from_events": "calib.events.flicker",
    "flicker_from_triggers": "calib.events.flicker",
    "forecast": "calib.studies.planning",
    "make_images": "calib.events.event_image",
    "predicted_view": "calib.studies.predicted_views",
    "projection_uncertainty": "calib.uncertainty.projection_uncertainty",
}

__all__ = list(_MODULES)


def __getattr__(name: str) -> Any:
    """Load a name at its first use (PEP 562)."""
    if name not in _MODULES:
        raise AttributeError(f"module 'calib' has no attribute {name!r}")
    value = getattr(importlib.import_module(_MODULES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """Return the public names, also those that are not loaded yet."""
    return sorted(__all__)
