"""The shared parameters as one vector, the state of the compiled loops (`calib.adjustment.star_kernels`)."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from calib.adjustment.parameters import AdjustmentParameters
from calib.adjustment.star_kernels import ABERRATIONS_AT, CENTRE_AT, LENS_AT, NOWHERE, SKEW_AT
from calib.model.camera import PINHOLE, SKEW, CameraModel
from calib.model.collimator import CENTRE, Collimator
from calib.model.lens import BROWN, FISHEYE

Array = NDArray[np.float64]

#: Places in the state of all parameters but the aberrations.
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

    Returns: (16 + T,) float64 pinhole, coefficients of the lens's family, skew, centre, aberrations.
    """
    camera, centre = parameters.camera, parameters.collimator
    state = [camera.fx, camera.fy, camera.cx, camera.cy, *_NO_LENS, centre.x, centre.y, centre.r]
    for name, value in camera.distortion.items():
        state[_PLACES[name]] = value
    return np.array([*state, *centre.aberrations.values()])


def unpacked(parameters: AdjustmentParameters, state: Array) -> tuple[CameraModel, Collimator]:
    """Return camera and collimator with the values of a state: the inverse of `packed`.

    state: (16 + T,) float64 from `packed`.
    """
    camera, collimator, values = parameters.camera, parameters.collimator, state.tolist()
    fx, fy, cx, cy = values[:LENS_AT]
    lens = {name: values[_PLACES[name]] for name in camera.distortion}
    x, y, r, *aberrations = values[CENTRE_AT:]
    named = dict(zip(collimator.aberrations, aberrations, strict=True))
    return (
        CameraModel(fx, fy, cx, cy, camera.image_size, lens),
        Collimator(x, y, r, named, collimator.reference),
    )


def state_places(
    parameters: AdjustmentParameters, names: Sequence[str], displacements: Array | None
) -> NDArray[np.int64]:
    """Return where parameters stand in the state.

    displacements: (N, 2, T) float64 displacements, mm; None if there are none.
    Returns: (G,) places, not to be written to; `calib.adjustment.star_kernels.NOWHERE` for a parameter that
      moves no star.
    """
    shown = () if displacements is None else tuple(parameters.collimator.aberrations)
    return _places(tuple(names), shown)


@lru_cache(maxsize=256)
def _places(names: tuple[str, ...], shown: tuple[str, ...]) -> NDArray[np.int64]:
    """Return the places of parameters, of which some are aberrations that move stars."""
    aberrations = {name: ABERRATIONS_AT + t for t, name in enumerate(shown)}
    return np.array([_PLACES.get(name, aberrations.get(name, NOWHERE)) for name in names], np.int64)
