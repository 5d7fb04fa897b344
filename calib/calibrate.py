"""From views to a calibrated camera: the engine's front door.

Knows the order of the work (closed form, refinement, covariance, summary); the mathematics stands in the
modules it calls.
"""

from __future__ import annotations

from calib.calibration import Calibration, CalibrationOptions, ViewSummary

__all__ = ["Calibration", "CalibrationOptions", "ViewSummary"]
