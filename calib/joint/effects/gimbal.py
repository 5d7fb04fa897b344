"""The gimbal: unknowns of what its readings predict. They move no star."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.joint import amplitudes as amp
from calib.joint.effects.effect import Effect, RandomBlock, Row
from calib.model import result_parts as rows

ECCENTRICITY = tuple(
    f"eccentricity_{axis}_{part}" for axis in ("pan", "tilt", "roll") for part in ("sin", "cos")
)
#: Begin of the names of the smooth errors of an encoder.
ENCODER = "encoder"


class GimbalErrors(Effect):
    """How the gimbal stands and turns (`calib.joint.readings`)."""

    @property
    def names(self) -> tuple[str, ...]:
        return self.bench.gimbal

    def priors(self) -> Sequence[RandomBlock]:
        encoders = tuple(name for name in self.names if name.startswith(ENCODER))
        if not encoders:
            return ()
        row = Row(rows.READINGS, "B", "station: reading_sigma_deg")
        sizes = self.bench.reading_rad * np.eye(len(encoders))
        return [RandomBlock(row, encoders, ((amp.ENCODER, sizes),))]
