"""The picture of the target behind the collimator, with the brightness that the lens gives it."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulators.optics import picture as optics
from simulators.optics.lens_focus import brightness
from simulators.world.truth import Truth


def picture(truth: Truth, angles_deg: Mapping[Any, float], *, subsamples: int = 4) -> NDArray[np.float32]:
    """Return each pixel's share of the light."""
    image = optics.render(truth, optics.true_rotation(angles_deg, truth), subsamples=subsamples)
    return np.asarray(image * np.float32(brightness(truth)))


def still_picture(truth: Truth, angles_deg: Mapping[Any, float]) -> NDArray[np.float32]:
    """Return the `picture` of a camera that stands still; the last two are kept and shared, so do not change it."""
    return _kept_picture(truth, tuple(sorted(angles_deg.items())))


@lru_cache(maxsize=2)
def _kept_picture(truth: Truth, angles_deg: tuple[tuple[str, float], ...]) -> NDArray[np.float32]:
    """Compute the picture of ``still_picture``."""
    return picture(truth, dict(angles_deg))
