"""The shared parameters as one vector, the state of the compiled loops (`calib.adjustment.star_kernels`)."""

from __future__ import annotations

from collections.abc import Sequence

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


def packed(parameters: AdjustmentParameters) -> Array:
    """Return the shared parameters as the state of `calib.adjustment.star_kernels`.

    Parameters
    ----------
    parameters
        Camera and collimator with T aberrations.

    Returns
    -------
    Array
        (16 + T,) float64 pinhole, coefficients of the lens's family, skew, centre, aberrations.
    """
    camera, collimator = parameters.camera, parameters.collimator
    family = FISHEYE if camera.is_fisheye else BROWN
    coefficients = [camera.distortion.get(name, 0.0) for name in family]
    lens = coefficients + [0.0] * (SKEW_AT - LENS_AT - len(family))
    return np.array([camera.fx, camera.fy, camera.cx, camera.cy, *lens, camera.skew, *collimator.values])


def unpacked(parameters: AdjustmentParameters, state: Array) -> tuple[CameraModel, Collimator]:
    """Return camera and collimator with the values of a state: the inverse of `packed`.

    Parameters
    ----------
    parameters
        Camera and collimator whose coefficients and aberrations are wanted.
    state
        (16 + T,) float64 from `packed`.

    Returns
    -------
    tuple of CameraModel and Collimator
        The same models with other values.
    """
    camera, collimator, values = parameters.camera, parameters.collimator, state.tolist()
    fx, fy, cx, cy = values[:LENS_AT]
    lens = {name: values[at] for name, at in zip(camera.distortion, _lens_places(camera), strict=True)}
    x, y, r, *aberrations = values[CENTRE_AT:]
    named = dict(zip(collimator.aberrations, aberrations, strict=True))
    return (
        CameraModel(fx, fy, cx, cy, camera.image_size, lens),
        Collimator(x, y, r, named, collimator.reference),
    )


def _lens_places(camera: CameraModel) -> list[int]:
    """Return where the coefficients of a camera's lens, and its skew, stand in the state."""
    return [_PLACES[name] for name in camera.distortion]


def state_places(
    parameters: AdjustmentParameters, names: Sequence[str], displacements: Array | None
) -> NDArray[np.int64]:
    """Return where parameters stand in the state.

    Parameters
    ----------
    parameters
        Camera and collimator.
    names
        Names of G shared parameters.
    displacements
        (N, 2, T) float64 displacements, mm; None if there are none.

    Returns
    -------
    NDArray of int64
        (G,) places; `calib.adjustment.star_kernels.NOWHERE` for a parameter that moves no star.
    """
    shown = parameters.collimator.aberrations if displacements is not None else ()
    aberrations = {name: ABERRATIONS_AT + t for t, name in enumerate(shown)}
    return np.array([_PLACES.get(name, aberrations.get(name, NOWHERE)) for name in names], np.int64)
