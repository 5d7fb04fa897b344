"""A world without devices: which stars a recording would show in a pose at a time, and what goes wrong.

It serves rehearsals on a virtual clock, in which a night passes in seconds: no pixels, no events, no devices. Star
centres come from the optics of the simulated bench, with noise added. The camera warms up and follows its room, and
the lens follows the camera. The same seed, pose and moment give the same stars; with backlash, the direction from which
each axis came matters too.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from simulators.config import BenchConfig, bench_config
from simulators.optics.lens_focus import truth_record
from simulators.optics.picture import star_centres, true_rotation
from simulators.world import drift
from simulators.world.gimbal import Gears
from simulators.world.truth import Truth

Mishap = Literal["", "covered", "lost"]

_CLEARANCE_SQUARES = 1.0  # A star at the disc's edge needs the squares around it
_BORDER_PX = 6.0  # A star is found only if some pixels around it are in the image
_COVERED_STARS = 20
"""Stars that remain visible if something covers the camera's view: fewer than a gate wants (40)."""


@dataclass(frozen=True)
class RehearsedView:
    """Content of one recording."""

    ids: NDArray[np.int64]  # (N,) int64, identities of the visible stars
    points_px: NDArray[np.float64]  # (N, 2) float64, star centres with noise
    sigma_px: float  # Noise of the centres in x and in y, 1 sigma
    temperature_c: float
    mishap: Mishap  # "covered", "lost" (there are no stars then), or empty


class RehearsedWorld:
    """A simulated bench without its devices (only serial numbers are used)."""

    def __init__(self, config: Mapping[str, Any], seed: int) -> None:
        self.bench: BenchConfig = bench_config(config)
        self.night = self.bench.night
        self._truth = self.bench.truth_for(seed)
        self._seed = seed
        self._gears = Gears(self._truth.gimbal)

    def temperature_c(self, on_s: float) -> float:
        """Return the temperature of the camera."""
        return drift.temperature_c(self.night, on_s)

    def truth(self, on_s: float) -> Truth:
        """Return the truth at a time: the lens follows the camera's temperature."""
        return drift.truth_at_temperature(self._truth, self.night, self.temperature_c(on_s))

    def truth_record(self, on_s: float) -> dict[str, Any]:
        """Return the truth at a time as ``truth.json`` holds it, with the focal lengths of the lens's focus."""
        return truth_record(self.truth(on_s))

    def record(self, angles_deg: Mapping[str, float], on_s: float, before: int) -> RehearsedView:
        """Simulate one recording of the target."""
        drawn = np.random.default_rng((self._seed, before, *_words(angles_deg), round(on_s * 1000)))
        mishap = self._mishap(float(drawn.random()))
        truth = self.truth(on_s)
        rotation = true_rotation(self._gears.load_angles_deg(angles_deg), truth)
        ids, points = star_centres(truth, rotation, clearance=_CLEARANCE_SQUARES, border_px=_BORDER_PX)
        if mishap == "lost":
            ids, points = ids[:0], points[:0]
        elif mishap == "covered":
            ids, points = ids[:_COVERED_STARS], points[:_COVERED_STARS]
        noisy = points + drawn.normal(0.0, self.night.star_sigma_px, points.shape)
        return RehearsedView(ids, noisy, self.night.star_sigma_px, self.temperature_c(on_s), mishap)

    def _mishap(self, lot: float) -> Mishap:
        if lot < self.night.lost_share:
            return "lost"
        return "covered" if lot < self.night.lost_share + self.night.covered_share else ""


def _words(angles_deg: Mapping[str, float]) -> list[int]:
    """Convert angles to non-negative whole numbers, as seeds must be."""
    return [round((angles_deg[name] + 360.0) * 1e6) for name in sorted(angles_deg)]
