"""Calibrations that several tests of one worker need: each is made once."""

import hashlib
import pickle

from calib.engine import calibrate

_KEPT = {}


def kept_calibration(views, options):
    """Calibrate views that were not calibrated yet with these options."""
    key = hashlib.sha256(pickle.dumps((list(views), options))).digest()
    if key not in _KEPT:
        _KEPT[key] = calibrate(views, options)
    return _KEPT[key]
