"""What a person can change at the camera by hand while the bench runs: its place in the mount, focus and aperture.

This module holds the state, and puts it into the truth; ``world`` keeps its past.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from simulators.world.lens_truth import LensTruth
from simulators.world.truth import Truth


@dataclass(frozen=True)
class CameraSetup:
    """How the camera stands in its mount, and how its lens is set.

    Attributes
    ----------
    shift_mm
        Displacement across the beam from where the camera was aligned, along the target's X and Y.
    turn_deg
        Turn in the mount: pan, tilt and roll.
    lens
        Focus and aperture.
    """

    shift_mm: tuple[float, float]
    turn_deg: tuple[float, float, float]
    lens: LensTruth


def setup_of(truth: Truth) -> CameraSetup:
    """Return the camera's setup in a truth.

    Parameters
    ----------
    truth
        All parameters.

    Returns
    -------
    CameraSetup
        Of its mount and lens.
    """
    return CameraSetup(truth.mount.shift_mm, truth.mount.turn_deg, truth.lens)


def with_setup(truth: Truth, setup: CameraSetup) -> Truth:
    """Return the truth with the camera set up in another way.

    Parameters
    ----------
    truth
        All parameters.
    setup
        Place in the mount, focus and aperture.

    Returns
    -------
    Truth
        The same object if the camera is set up so already.
    """
    if setup == setup_of(truth):
        return truth
    mount = replace(truth.mount, shift_mm=setup.shift_mm, turn_deg=setup.turn_deg)
    return replace(truth, mount=mount, lens=setup.lens)
