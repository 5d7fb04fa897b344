"""The newest picture of a session with its figures. The module holds data only."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from bench.align.live_figures import LiveFigures


@dataclass(frozen=True)
class LivePicture:
    """The newest picture and its figures."""

    number: int = 0  # Counts the pictures, from 1; 0 before the first one
    # (H, W) uint8; white print is bright.
    image: NDArray[np.uint8] = field(default_factory=lambda: np.zeros((1, 1), np.uint8))
    jpeg: bytes = b""
    figures: LiveFigures = field(default_factory=LiveFigures)
    made_s: float = 0.0  # Time at which the picture was ready, s since 1970
    # record_ms, measure_ms: Duration of the recording and of the measurement, ms.
    record_ms: float = 0.0
    measure_ms: float = 0.0
