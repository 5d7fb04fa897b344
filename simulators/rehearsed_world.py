"""A world to rehearse in: where stars lie in a pose, at an hour of the night, and what goes wrong there.

For rehearsals on a virtual clock, in which a night passes in seconds: no pixels, no events, no devices. Star
centres come from the same optics as the simulated bench's, a little off as noise will have it; the camera warms
up and follows its room, and the lens with it. The same seed, pose and moment give the same stars.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from simulators.config import BenchConfig, bench_config
from simulators.errors import ConfigError
from simulators.optics.picture import pose_rotation, star_centres
from simulators.world.truth import Truth

Mishap = Literal["", "covered", "lost"]

_CLEARANCE_SQUARES = 1.0
_BORDER_PX = 6.0
_COVERED_STARS = 20
"""Stars that are left where something stands before the camera."""
_REFERENCE_C = 40.0
"""Camera temperature at which the lens is as ``camera`` says."""


@dataclass(frozen=True)
class Night:
    """How a night goes: section ``rehearsal`` of the simulation's configuration.

    Attributes
    ----------
    star_sigma_px
        Noise of a star's centre, each way, 1 sigma.
    room_c, room_c_per_h
        Temperature of the room at the begin, and how it changes.
    self_heating_c, warm_up_min
        How much warmer than the room the camera's sensor gets, and with which time constant after switching on.
    focal_ppm_per_c
        How the focal length follows the camera's temperature.
    covered_share, lost_share
        Share of the recordings in which something stands before the camera; that the camera does not complete.
    """

    star_sigma_px: float = 0.03
    room_c: float = 22.0
    room_c_per_h: float = 0.0
    self_heating_c: float = 18.0
    warm_up_min: float = 20.0
    focal_ppm_per_c: float = 0.0
    covered_share: float = 0.0
    lost_share: float = 0.0


@dataclass(frozen=True)
class RehearsedView:
    """What a recording would show.

    Attributes
    ----------
    ids
        (N,) int64, stars.
    points_px
        (N, 2) float64, their centres, noise included.
    sigma_px
        1 sigma of that noise, each way.
    temperature_c
        Of the camera.
    mishap
        What went wrong: "covered", "lost" (there are no stars then), or nothing.
    """

    ids: NDArray[np.int64]
    points_px: NDArray[np.float64]
    sigma_px: float
    temperature_c: float
    mishap: Mishap


class RehearsedWorld:
    """A simulated bench without its devices.

    Parameters
    ----------
    config
        The simulation's configuration; what it says of devices and pixels plays no part, but for serial numbers.
    seed
        Of everything random.

    Raises
    ------
    ConfigError
        Naming the key that is unknown or whose value cannot be.
    """

    def __init__(self, config: Mapping[str, Any], seed: int) -> None:
        self.night = _night(config.get("rehearsal", {}))
        self.bench: BenchConfig = bench_config(config)
        self._truth = self.bench.truth_for(seed)
        self._seed = seed

    def temperature_c(self, on_s: float) -> float:
        """Temperature of the camera, so long after it was switched on."""
        night = self.night
        warm = -math.expm1(-max(0.0, on_s) / (60.0 * night.warm_up_min)) if night.warm_up_min else 1.0
        return night.room_c + night.room_c_per_h * on_s / 3600.0 + night.self_heating_c * warm

    def truth(self, on_s: float) -> Truth:
        """Give the world as it is at that time: the lens follows the camera's temperature."""
        stretch = 1.0 + 1e-6 * self.night.focal_ppm_per_c * (self.temperature_c(on_s) - _REFERENCE_C)
        camera = self._truth.camera
        return replace(self._truth, camera=replace(camera, fx=camera.fx * stretch, fy=camera.fy * stretch))

    def record(self, angles_deg: Mapping[str, float], on_s: float, before: int) -> RehearsedView:
        """Look at the target.

        Parameters
        ----------
        angles_deg
            Of the axes.
        on_s
            Time since the camera was switched on, s.
        before
            Recordings made before by this bench: tells one from another at the same pose.
        """
        drawn = np.random.default_rng((self._seed, before, *_words(angles_deg), round(on_s * 1000)))
        mishap = self._mishap(float(drawn.random()))
        truth = self.truth(on_s)
        rotation = pose_rotation(angles_deg, truth.optics)
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
    """Turn angles into whole numbers that are not negative, as seeds must be."""
    return [round((angles_deg[name] + 360.0) * 1e6) for name in sorted(angles_deg)]


def _night(given: object) -> Night:
    """Read the section, each key checked."""
    if not isinstance(given, Mapping):
        raise ConfigError(f"A mapping is expected, not {given!r}.", where="rehearsal")
    known = {one.name for one in fields(Night)}
    for key, value in given.items():
        where = f"rehearsal.{key}"
        if key not in known:
            raise ConfigError("Unknown key.", where=where, remedy=f"Known are: {', '.join(sorted(known))}.")
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
            raise ConfigError(f"A finite number is expected, not {value!r}.", where=where)
        if value < 0 and key in {"star_sigma_px", "warm_up_min", "covered_share", "lost_share"}:
            raise ConfigError(f"{value!r} is negative.", where=where)
    night = Night(**{key: float(value) for key, value in given.items()})
    if night.covered_share + night.lost_share > 1:
        raise ConfigError("The shares exceed 1.", where="rehearsal.covered_share")
    return night
