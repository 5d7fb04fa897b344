"""Event slices of a simulated camera without devices: a scene, a pose, a flickering light, and its events at once.

It serves comparisons of methods, which need thousands of recordings. Optics, pixels and readout are those of the
simulated bench; there are no drivers, files, triggers or times. The same section and seeds give the same events.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulators.config import bench_config
from simulators.optics import scene
from simulators.optics.lens_focus import truth_record
from simulators.pixels.sensor import Events, simulate
from simulators.world.gimbal import load_angles_deg
from simulators.world.truth import Truth
from simulators.world.world import LightState


@dataclass(frozen=True)
class VirtualCapture:
    """Events of a camera that stands still.

    Attributes
    ----------
    events
        Events in the order in which they are read.
    image_size
        Width and height of the sensor, px.
    light_hz
        Frequency of the light, Hz.
    first_edge_us
        Time of the first rising edge of the light, us.
    duration_us
        Length of the recording, us.
    """

    events: Events
    image_size: tuple[int, int]
    light_hz: float
    first_edge_us: float
    duration_us: float


class VirtualCamera:
    """A simulated camera in its scene.

    Parameters
    ----------
    section
        As the ``simulation`` section of a station file.
    seed
        Seed of the gimbal's errors, of the mounting if the section does not state it, and of the camera's pixels.

    Raises
    ------
    ConfigError
        If the section is not valid.
    """

    def __init__(self, section: Mapping[str, Any], seed: int) -> None:
        self._truth: Truth = bench_config(section).truth_for(seed)
        self._seed = seed
        self._sides: dict[str, float] = {}
        self._last: dict[str, float] = {}

    def truth(self) -> dict[str, Any]:
        """Return the true parameters by part, as the simulated bench writes them.

        Returns
        -------
        dict
            ``camera``, ``collimator`` and others.
        """
        return truth_record(self._truth)

    def board_corners_px(self) -> NDArray[np.float64]:
        """Return the true image points of the inner corners of the board on the screen, at zero angles.

        Returns
        -------
        (N, 2) float64
            Image points, px, row by row.
        """
        return scene.corners(self._truth, {})

    def capture(
        self, angles_deg: Mapping[str, float], *, seed: int, light_hz: float = 60.0, periods: int = 2
    ) -> VirtualCapture:
        """Turn the camera and record whole periods of the light.

        Parameters
        ----------
        angles_deg
            Readings of the axes, degrees; the loads stand behind the play of their gears.
        seed
            Seed of the noise of this recording and of its start phase.
        light_hz
            Frequency of the light, Hz.
        periods
            Number of whole periods.

        Returns
        -------
        VirtualCapture
            The events.
        """
        for axis, angle in angles_deg.items():
            moved = angle - self._last.get(axis, 0.0)
            self._sides[axis] = float(np.sign(moved)) if moved else self._sides.get(axis, 0.0)
        self._last = dict(angles_deg)
        picture = scene.picture(self._truth, load_angles_deg(angles_deg, self._sides, self._truth.gimbal))
        light = LightState(output=True, sync=True, frequency_hz=light_hz)
        phase = float(np.random.default_rng((seed, 1)).random())
        duration_us = (periods + 0.05) * light.period_us
        events = simulate(
            picture,
            light,
            duration_us,
            phase=phase,
            noise=self._truth.noise,
            camera_seed=self._seed,
            seed=seed,
        )
        size = (self._truth.camera.width, self._truth.camera.height)
        return VirtualCapture(events, size, light_hz, (1.0 - phase) * light.period_us, duration_us)
