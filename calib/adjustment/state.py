"""The shared parameters as one vector, the state of the compiled loops (`calib.adjustment.star_kernels`)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calib.adjustment.parameters import AdjustmentParameters
from calib.adjustment.star_kernels import CENTRE_AT, LENS_AT, SKEW_AT
from calib.model.camera import PINHOLE, SKEW, CameraModel
from calib.model.collimator import CENTRE, Collimator
from calib.model.lens import BROWN, FISHEYE

Array = NDArray[np.float64]

#: Places in the state of all parameters.
_PLACES = {
    **{name: at for at, name in enumerate(PINHOLE)},
    **{name: LENS_AT + at for family in (BROWN, FISHEYE) for at, name in enumerate(family)},
    SKEW: SKEW_AT,
    **{name: CENTRE_AT + at for at, name in enumerate(CENTRE)},
}


#: Coefficients and skew of a pinhole camera.
_NO_LENS = (0.0,) * (CENTRE_AT - LENS_AT)


def packed(parameters: AdjustmentParameters) -> Array:
    """Return the shared parameters as the state of `calib.adjustment.star_kernels`.

    Returns: (16,) float64 pinhole, coefficients of the lens's family, skew, centre.
    """
    camera, centre = parameters.camera, parameters.collimator
    state = [camera.fx, camera.fy, camera.cx, camera.cy, *_NO_LENS, centre.x, centre.y, centre.r]
    for name, value in camera.distortion.items():
        state[_PLACES[name]] = value
    return np.array(state)


def unpacked(parameters: AdjustmentParameters, state: Array) -> tuple[CameraModel, Collimator]:
    """Return camera and collimator with the values of a state: the inverse of `packed`.

    state: (16,) float64 from `packed`.
    """
    camera, collimator, values = parameters.camera, parameters.collimator, state.tolist()
    fx, fy, cx, cy = values[:LENS_AT]
    lens = {name: values[_PLACES[name]] for name in camera.distortion}
    x, y, r = values[CENTRE_AT:]
    return CameraModel(fx, fy, cx, cy, camera.image_size, lens), replace(collimator, x=x, y=y, r=r)


def state_places(names: Sequence[str]) -> NDArray[np.int64]:
    """Return the (G,) places of parameters in the state."""
    return np.array([_PLACES[name] for name in names], np.int64)
